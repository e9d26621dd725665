"""Commands about creatures, and about the objectives that score them.

The docstrings of the methods are written by `make format` from the schemas (tools/client_docs.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from nmes.client.declaration import Vector, command
from nmes.client.replies import (
    CreatureSpawned,
    Driven,
    Fed,
    GenomeDocument,
    Heard,
    Life,
    ObjectiveSet,
    PartGrown,
    PartShed,
    Reward,
    Said,
    Senses,
)

__all__ = ["CreatureCommands"]


class CreatureCommands:
    """Commands about creatures and objectives."""

    @command
    def spawn_creature(
        self,
        genome: Mapping[str, Any],
        *,
        position: Vector | None = None,
        name: str | None = None,
        target: Vector | str | None = None,
        autonomous: bool | None = None,
        flaws: Mapping[str, Any] | None = None,
    ) -> type[CreatureSpawned]:
        """Makes the body of a genome live: its cubes and joints, all of them or none.

        The brain stays outside, where whoever runs it senses and drives; or the world runs it.

        Args:
            genome: The genome, as schemas/genome.json says.
            position: Where the origin of the genome's body comes to be, in m, each number within 1,000,000 m of the
                origin. A body stands on its own y = 0. Default: [0, 0, 0].
            name: Its name; a cube or joint of it is called NAME.id. Drawn from the seed if left out.
            target: What its sensors of a target are about: a point in m, each number within 1,000,000 m of the origin,
                or the name of a cube. The cube need not be there yet; as long as it is not, they read 0, as without a
                target.
            autonomous: Whether the world runs its brain itself: before each tick it senses and drives. Such a creature
                takes no drive. Default: False.
            flaws: How all its sensors and motors err, besides what its genome says: of each number the larger counts.

        Returns:
            CreatureSpawned: The creature is there.

        Raises:
            CommandFailed: The server refused it: `creature_exists`, `cube_exists`, `invalid`, `limit_reached`,
                `not_allowed`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return CreatureSpawned

    @command
    def drive(self, creature: str, controls: Vector, *, layout: int | None = None) -> type[Driven]:
        """Sets what the motors of a creature aim at and what its voices say, until it is driven again.

        What set_joint_param of each motor's target and say of each channel do, in one.

        Args:
            creature: The creature.
            controls: One number a motor, in their order, each from -1 to 1: the lower and the upper end of the motor's
                range; then one number a voice.
            layout: Only if its layout is still this one, as creature_changed or an answer told it, from 1 to 1,000,000;
                whichever it is if left out.

        Returns:
            Driven: The motors have their targets.

        Raises:
            CommandFailed: The server refused it: `creature_not_found`, `invalid`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Driven

    @command
    def get_genome(self, creature: str) -> type[GenomeDocument]:
        """Reads the genome of a creature: what it was made from, or born with.

        Args:
            creature: The creature.

        Returns:
            GenomeDocument: The genome of a creature.

        Raises:
            CommandFailed: The server refused it: `creature_not_found`, `invalid`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return GenomeDocument

    @command
    def say(
        self,
        channel: str,
        value: float | Vector | None = None,
        *,
        creature: str | None = None,
        cube_name: str | None = None,
    ) -> type[Said]:
        """Says numbers on a channel, where a cube or the root of a creature is.

        Who is in range hears them from the next tick on, until the cube says something else there, or is gone.

        Args:
            channel: The channel, one of the world's (config).
            value: What it says: a number from -1 to 1, or as many of them as the channel has. Left out: it falls silent
                there.
            creature: The creature whose root says it.
            cube_name: The cube that says it; without creature and cube_name the one that this connection spawned last.

        Returns:
            Said: It is said, and will be heard.

        Raises:
            CommandFailed: The server refused it: `creature_not_found`, `cube_not_found`, `invalid`, `not_allowed`,
                `nothing_owned`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Said

    @command
    def hear(self, channel: str, *, creature: str | None = None, cube_name: str | None = None) -> type[Heard]:
        """Tells which voices on a channel are heard where a cube or the root of a creature is, the nearest first.

        Neither hears itself.

        Args:
            channel: The channel, one of the world's (config).
            creature: The creature that hears, where its root is.
            cube_name: The cube that hears; without creature and cube_name the one that this connection spawned last.

        Returns:
            Heard: What is heard.

        Raises:
            CommandFailed: The server refused it: `creature_not_found`, `cube_not_found`, `invalid`, `not_allowed`,
                `nothing_owned`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Heard

    @command
    def get_life(self) -> type[Life]:
        """Reads the ecosystem of a world that has one: what there is to eat, and who lives.

        Returns:
            Life: The ecosystem.

        Raises:
            CommandFailed: The server refused it: `not_allowed`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Life

    @command
    def feed(self, position: Vector, *, energy: float | None = None) -> type[Fed]:
        """Puts food somewhere on the ground, in a world that has life.

        Args:
            position: Where, in m, each number within 1,000,000 m of the origin; its height counts for nothing.
            energy: What it feeds, in J, from 0 to 1,000,000,000; as what grows, if left out.

        Returns:
            Fed: The food is there.

        Raises:
            CommandFailed: The server refused it: `invalid`, `not_allowed`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Fed

    @command
    def sense(self, creature: str) -> type[Senses]:
        """Reads the sensors of a creature.

        Args:
            creature: The creature.

        Returns:
            Senses: What the sensors of a creature read.

        Raises:
            CommandFailed: The server refused it: `creature_not_found`, `invalid`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Senses

    @command
    def shed(self, creature: str, part: str, *, remove: bool | None = None) -> type[PartShed]:
        """Cuts a part off a creature, with all that hangs on its root through it alone.

        The joints to the rest are removed, and what is cut off is no part of it any more.

        Args:
            creature: The creature.
            part: The id of the cube in its genome; any but the root.
            remove: Whether the cubes are taken away; else they stay where they are, as cubes of the world. Default:
                False.

        Returns:
            PartShed: The part is cut off.

        Raises:
            CommandFailed: The server refused it: `creature_not_found`, `invalid`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return PartShed

    @command
    def grow(self, creature: str, part: str) -> type[PartGrown]:
        """Grows a part of a creature's body that is not there: one that is later, or that it has lost.

        It comes to be where the genome has it, seen from the part that it hangs on, and at rest there, with its joint
        and motor.

        Args:
            creature: The creature.
            part: The id of the cube in its genome. What it hangs on must be there, and there must be room.

        Returns:
            PartGrown: The creature has the part.

        Raises:
            CommandFailed: The server refused it: `creature_not_found`, `invalid`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return PartGrown

    @command
    def adopt(self, creature: str, part: str, cube_name: str) -> type[PartGrown]:
        """Makes a cube of the world a part of a creature's body that is not there, joined to it where it is now.

        What a lost part carried, by the body's own joints, comes along.

        Args:
            creature: The creature.
            part: The id of the cube in its genome. What it hangs on must be there.
            cube_name: The cube, which is no part of a creature.

        Returns:
            PartGrown: The creature has the part.

        Raises:
            CommandFailed: The server refused it: `creature_not_found`, `cube_not_found`, `invalid`, `not_allowed`,
                `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return PartGrown

    @command
    def set_objective(
        self,
        expression: str,
        *,
        name: str | None = None,
        cubes: Sequence[str] | None = None,
        creature: str | None = None,
        target: Vector | None = None,
    ) -> type[ObjectiveSet]:
        """Sets an objective of this connection: an expression over what cubes do from now on.

        docs/objectives.md tells what it may name. A reset of the world forgets it.

        Args:
            expression: The expression, at most 2,000 characters. What is wrong with one is refused as bad_expression,
                with its place.
            name: What it is called; an objective of that name is replaced. A connection may have 16. Default:
                'objective'.
            cubes: The body that it is about, 1 to 256 cubes; without these and a creature, the one cube that this
                connection spawned last.
            creature: The creature that it is about; the expression then knows its cubes by their ids. Not together with
                cubes.
            target: Where distance is measured from, in m, each number from -1,000,000 to 1,000,000; where the body is
                now if left out.

        Returns:
            ObjectiveSet: The objective counts from now on.

        Raises:
            CommandFailed: The server refused it: `bad_expression`, `creature_not_found`, `cube_not_found`, `invalid`,
                `limit_reached`, `not_allowed`, `nothing_owned`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return ObjectiveSet

    @command
    def compute_reward(
        self,
        *,
        objective: str | None = None,
        metric: Literal["distance", "displacement", "height", "speed", "uprightness", "energy"] | None = None,
        cube: str | None = None,
        target: Vector | None = None,
        axis: Vector | None = None,
    ) -> type[Reward]:
        """Asks what an objective of this connection is worth now, or a metric of a cube.

        Args:
            objective: Name of the objective; objective, as set_objective calls one that has no other name, if left out.
                Not together with a metric.
            metric: The metric: distance (m) from the target, or from where the cube was spawned; displacement (m) from
                there along the axis; height (m) above y = 0; speed (m/s); uprightness, the cosine of the angle between
                its own y axis and up; energy (J), what the motors of its joints have worked so far.
            cube: The cube of a metric; the one that this connection spawned last if left out.
            target: For the metric distance: where it is measured from, in m, each number from -1,000,000 to 1,000,000.
            axis: For the metric displacement: the direction in which it counts; its length does not matter, but each
                number is from -1,000 to 1,000 and one at least 0.000001 in size. Default: [1, 0, 0].

        Returns:
            Reward: What an objective or a metric is worth now.

        Raises:
            CommandFailed: The server refused it: `bad_expression`, `cube_not_found`, `invalid`, `not_allowed`,
                `nothing_owned`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Reward
