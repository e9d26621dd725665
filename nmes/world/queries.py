"""Read-only questions about a world between its inputs: time, cubes, joints, creatures, poses, contacts, energy.

The half of `World` that changes nothing; it is never used alone.

Invariant: queries never change what happens later.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import blake2b
from typing import Any

from nmes import protocol
from nmes.backend import Array, Backend, Contact, Simulation, Track, Vector
from nmes.backend.rotation import total
from nmes.backend.shapes import Shape
from nmes.errors import WorldError
from nmes.objective.trajectory import Flags, touches
from nmes.schemas.documents import JsonObject
from nmes.world import readings
from nmes.world.channels import Channels
from nmes.world.clients import Clients
from nmes.world.costs import command_cost, rebuild_cost, telling_cost
from nmes.world.creature import Creature
from nmes.world.creatures import Creatures
from nmes.world.entities import Entities
from nmes.world.life import Life
from nmes.world.roles import Role
from nmes.world.state import Barrier, Fault

__all__ = ["WorldQueries"]


class WorldQueries:
    """The state of a world and the questions about it.

    Attributes:
        config: The complete world config.
        backend: The engine.
        seed: What names and drawn scenery follow from.
        frame: Ticks since the last reset.
        mode: `lockstep`, `realtime` or `fast`.
        rate: How many times faster than the clock `realtime` runs.
        paused: Whether the clock of `realtime` and `fast` is stopped.
        barrier: Set where the ticks of lockstep wait for several clients.
        fault: Why the world has stopped; None while it goes on.
        entities: Its cubes and joints.
        all_creatures: Its creatures.
        roles: What those who are in it may do, by name; empty: everybody may do everything.
        channels: What is said and heard in it.
    """

    config: JsonObject
    backend: Backend
    seed: int
    frame: int
    mode: str
    rate: float
    paused: bool
    barrier: Barrier | None
    fault: Fault | None
    entities: Entities
    all_creatures: Creatures
    roles: Mapping[str, Role]
    channels: Channels
    life: Life | None
    _clients: Clients
    _tick_rate: int
    _past: int  # ticks before the last reset
    _hibernated: bytes | None
    _built: int  # the entities' edits that the engine has taken up

    @property
    def time(self) -> float:
        """Simulation time since the last reset, s."""
        return self.frame / self._tick_rate

    @property
    def ticks(self) -> int:
        """How many ticks there were, over all resets."""
        return self._past + self.frame

    @property
    def untouched(self) -> bool:
        """Whether nothing has happened here: nobody came, and it never ticked."""
        return not (self.ticks or self._clients.ever)

    @property
    def running(self) -> bool:
        """Whether the world ticks by itself now: not in lockstep, not paused, not faulted, not asleep."""
        return self.mode != "lockstep" and not self.paused and self.fault is None and not self.asleep

    @property
    def asleep(self) -> bool:
        """Whether the world hibernates: it was saved, and its engine let go."""
        return self._hibernated is not None

    @property
    def idle(self) -> bool:
        """Whether nothing is lost where the world hibernates now: nobody is in it, and nothing moves.

        Nothing moves where time stands still, or where all cubes are frozen or sleep, no creature is run by the world
        or develops, and there is no ecosystem. A faulted world is not idle, nor one whose engine has no snapshots.
        """
        if self.asleep or self._clients or self.fault is not None or "snapshot" not in self.backend.capabilities:
            return False
        if not self.running:
            return True
        if self.life is not None or self.all_creatures.busy:
            return False
        sleeping = self.simulation.sleeping
        return all(cube.frozen or sleeping(cube.body) for cube in self.entities.cubes.values())

    @property
    def structure_version(self) -> int:
        """A number that increases whenever a cube or a joint comes or goes, or a cube is frozen or let go."""
        return self.entities.version

    @property
    def simulation(self) -> Simulation:
        """The running scene, for benchmarks and tests; whoever edits it breaks the world's promises."""
        return self.entities.simulation

    def cost(self, command: Mapping[str, Any]) -> float:
        """Returns about how long (s) a valid command takes, its ticks left out: a guess for hosts, and cheap.

        A command that takes under half a millisecond, as most do, may be 0.
        """
        return command_cost(self.entities, command)

    @property
    def rebuild_cost(self) -> float:
        """About how much longer (s) the next tick or snapshot takes because cubes or joints were edited; else 0."""
        return 0.0 if self.entities.edits == self._built else rebuild_cost(self.entities)

    def telling_cost(self, ticks: float) -> float:
        """Returns about how much longer (s) the next of so many ticks takes since subscribers are told of it."""
        return telling_cost(self.entities, self._clients.heard(self.frame, ticks))

    def digest(self) -> bytes:
        """Returns the hash of all that decides the future, 16 bytes.

        That is the engine's digest, with what brains here remember, what is said and heard, and who lives how, where
        there is any of these.
        """
        digest, more = self.simulation.digest(), self.all_creatures.memory() + self.channels.packed()
        if self.life is not None:
            more += self.life.digest()
        return blake2b(digest + more, digest_size=16).digest() if more else digest

    def cubes(self) -> list[str]:
        """Returns the cubes' names in order of creation."""
        return list(self.entities.cubes)

    def joints(self) -> list[str]:
        """Returns the joints' names in order of creation."""
        return list(self.entities.joints)

    def clients(self) -> list[int]:
        """Returns the numbers of the clients that are in, in the order in which they came."""
        return list(self._clients)

    def may(self, client: int, kind: str) -> bool:
        """Whether a client may do a command of this type, of those that are about the world as a whole."""
        role = self._clients[client].role
        return role is None or role.allows(kind, None, None)

    def require_player(self, player: int) -> None:
        """Raises `player_not_found` unless a player of that number has ever come."""
        if not 1 <= player <= self._clients.players:
            message = f"there is no player {player}; {self._clients.players} have come so far"
            raise WorldError("player_not_found", message, "player")

    def creatures(self) -> list[str]:
        """Returns the creatures' names in order of creation."""
        return self.all_creatures.names()

    def creature(self, name: str) -> Creature:
        """Returns a creature, whose `sense` may be called at any time; to drive it is an input, see `World.drive`.

        Raises:
            WorldError: `creature_not_found`.
        """
        return self.all_creatures.find(name)

    def poses(self) -> tuple[list[str], Array]:
        """Returns the cubes' names and a new array (n, 13) of their states.

        A row holds a position (m), a quaternion (x, y, z, w), a linear (m/s) and an angular velocity (rad/s).
        """
        return self.cubes(), self.entities.states()

    def track(self, cubes: Sequence[str], joints: Sequence[str], motors: Sequence[str], rows: int) -> Track:
        """Returns a Track that records up to `rows` ticks of cubes' states, joints' positions and motors' powers.

        Raises:
            WorldError: `cube_not_found`, `joint_not_found`.
        """
        entities = self.entities
        bodies = [entities.cube(name).body for name in cubes]
        moved, driven = ([entities.joint(name).number for name in names] for names in (joints, motors))
        return entities.simulation.track(bodies, moved, driven, rows)

    def touches(self, cubes: Sequence[str], body: int) -> Flags:
        """Returns whether each cube touches anything now, and anything outside the first `body` cubes: array (n, 2).

        Raises:
            WorldError: `cube_not_found`.
        """
        entities = self.entities
        return touches(entities.simulation, [entities.cube(name).body for name in cubes], body)

    def cube_shape(self, name: str) -> tuple[Vector, tuple[float, float, float, float], Shape]:
        """Returns a cube's edge lengths (m), colour (RGBA, 0 to 1) and shape.

        Raises:
            WorldError: `cube_not_found`.
        """
        cube = self.entities.cube(name)
        return cube.size, cube.color, cube.shape

    def joint_infos(self) -> list[JsonObject]:
        """Returns every joint's state and parameters, as `get_joint_info` answers, in order of creation."""
        return [readings.joint_info(self.entities, joint) for joint in self.entities.joints.values()]

    def contacts(self) -> list[Contact]:
        """Returns the contacts of all cubes in the last step; two cubes that touch each other have one each."""
        simulation = self.simulation
        return [contact for cube in self.entities.cubes.values() for contact in simulation.contacts(cube.body)]

    def motor_work(self) -> float:
        """Returns the work that the motors of all present joints have done so far, J."""
        meter = self.entities.meter
        return total(meter.watts(joint) or 0.0 for joint in meter.numbers) / self._tick_rate

    def welcome(self, client: int) -> JsonObject:
        """Returns the `auth_success` message for a client that has joined."""
        role, player = self._clients[client].role, self._clients[client].player
        return {
            "type": "auth_success",
            "protocol": protocol.PROTOCOL_VERSION,
            "client": client,
            "world": self.config["name"],
            "backend": self.backend.name,
            "dims": self.backend.dims,
            "timestep": 1.0 / self._tick_rate,
            "tick_rate": self._tick_rate,
            "mode": self.mode,
            **({} if role is None else {"role": role.name, "player": player}),
        }
