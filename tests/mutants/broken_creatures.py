"""Servers that are wrong about rewards or creatures. See `defects`."""

from __future__ import annotations

from pytest import MonkeyPatch

from defects import Answer, JsonObject, around, defect
from nmes.errors import NmesError
from nmes.world import World
from nmes.world.channels import Channels
from nmes.world.clients import Client


@defect("19.13:height")
def heights_above_the_start(patch: MonkeyPatch) -> None:
    """It measures height from where a cube was spawned."""

    def lower(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        if reply.get("metric") == "height":
            reply["value"] -= world.entities.cube(reply["cube_name"]).origin[1]
        return reply

    around(patch, "compute_reward", lower)


@defect("19.13:displacement-along-an-axis")
def displacements_without_sign(patch: MonkeyPatch) -> None:
    """It tells how far a cube is along an axis, forwards or backwards."""

    def size(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        return {**reply, "value": abs(reply["value"])}

    around(patch, "compute_reward", size)


@defect("19.4")
def objectives_of_all(patch: MonkeyPatch) -> None:
    """It shares the objectives of one connection with all."""

    def share(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        for other in world._clients.values():
            other.objectives = client.objectives
        return reply

    around(patch, "set_objective", share)


@defect("19.2:cut-off", "19.2:unknown-quantity")
def any_expression(patch: MonkeyPatch) -> None:
    """It takes expressions that cannot be used, and says nothing."""

    def take(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        try:
            return answer(world, client, command)
        except NmesError:
            return answer(world, client, {**command, "expression": "height"})

    around(patch, "set_objective", take)


@defect("18.1", backend="mujoco")
def creatures_that_are_not_there(patch: MonkeyPatch) -> None:
    """It tells names of a creature's cubes that no cube has."""

    def rename(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        return {**reply, "cubes": {part: f"{name}_0" for part, name in reply["cubes"].items()}}

    around(patch, "spawn_creature", rename)


@defect("18.4:an-unknown-cube", backend="mujoco")
def half_creatures(patch: MonkeyPatch) -> None:
    """It leaves the first cube of a creature that it cannot make."""

    def leave(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        try:
            return answer(world, client, command)
        except NmesError:
            part = command["genome"]["body"]["cubes"][0]["id"]
            if world.entities.cubes.get(f"{command['name']}.{part}") is None:
                world.entities.spawn({"type": "spawn_cube", "cube_name": f"{command['name']}.{part}"})
            raise

    around(patch, "spawn_creature", leave)


@defect("18.8:high", "18.8:low", "18.9", backend="mujoco")
def creatures_driven_backwards(patch: MonkeyPatch) -> None:
    """It takes a creature's controls with the wrong sign."""

    def mirror(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        return answer(world, client, {**command, "controls": [-control for control in command["controls"]]})

    around(patch, "drive", mirror)


@defect("18.33", backend="mujoco")
def creatures_that_are_never_driven(patch: MonkeyPatch) -> None:
    """It lets creatures develop from their birth."""

    def begin(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        development = world.creature(reply["creature"]).development
        if development is not None:
            development.begun = True
        return reply

    around(patch, "spawn_creature", begin)


@defect("18.33", backend="mujoco")
def genomes_without_rules(patch: MonkeyPatch) -> None:
    """It drops the rules of development of a genome."""

    def forget(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        genome = {name: value for name, value in command["genome"].items() if name != "development"}
        return answer(world, client, {**command, "genome": genome})

    around(patch, "spawn_creature", forget)


CHANNELS = {"channels": {"alarm": {"range": 8, "fades": True}, "map": {"size": 3}}}


@defect("18.16", config=CHANNELS)
def the_farthest_first(patch: MonkeyPatch) -> None:
    """It tells the voices that are heard with the farthest first."""

    def turn(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        return {**reply, "voices": reply["voices"][::-1]}

    around(patch, "hear", turn)


@defect("18.17", config=CHANNELS)
def heard_at_once(patch: MonkeyPatch) -> None:
    """It lets be heard at once what is said."""
    say = Channels.say

    def loud(channels: Channels, body: int, name: str, values: tuple[float, ...] | None) -> None:
        say(channels, body, name, values)
        channels.tick()

    patch.setattr(Channels, "say", loud)


@defect("18.18")
def channels_that_are_not_there(patch: MonkeyPatch) -> None:
    """It lets cubes speak and hear on channels that the world has not."""

    def say(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        if command["channel"] in world.channels.channels:
            return answer(world, client, command)
        return {"type": "said", "channel": command["channel"], "cube_name": command["cube_name"]}

    around(patch, "say", say)


@defect("18.7", backend="mujoco")
def senses_too_many(patch: MonkeyPatch) -> None:
    """It tells one value more than a creature has sensors."""

    def more(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        return {**reply, "values": [*reply["values"], 0.0]}

    around(patch, "sense", more)
