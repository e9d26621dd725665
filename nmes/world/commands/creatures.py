"""The commands about creatures: they are made from genomes, driven and sensed as a whole."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from nmes import protocol
from nmes.errors import DocumentError, WorldError
from nmes.genome import Genome
from nmes.schemas.documents import JsonObject
from nmes.world import growth
from nmes.world.clients import Client
from nmes.world.rights import Right, Touched, nothing
from nmes.world.structure import connected_cubes, joined_cubes

if TYPE_CHECKING:
    from nmes.world.world import World

__all__ = ["COMMANDS", "RIGHTS"]

_PROBLEM_LENGTH = 300  # characters of each problem of a bad genome that a reply names


def spawn_creature(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Makes a creature from a genome."""
    try:
        genome = Genome(command["genome"])
    except DocumentError as error:
        raise _bad_genome(error) from error
    x, y, z = command.get("position", protocol.COMMANDS["spawn_creature"].defaults["position"])
    target = command.get("target")
    if target is not None and not isinstance(target, str):
        target = world.entities.fields.position(target)
    asked = world.entities.fields.position((x, y, z))
    position = world.all_creatures.place(genome.body, asked)
    alone = bool(command.get("autonomous"))
    flaws = command.get("flaws")
    creature = world.all_creatures.spawn(genome, position, command.get("name"), target, autonomous=alone, flaws=flaws)
    for name in creature.cubes.values():
        world.entities.cube(name).player = client.player
    voices = [voice.id for voice in creature.body.voices]
    reply: JsonObject = {
        "type": "creature_spawned",
        "creature": creature.name,
        "cubes": creature.cubes,
        "joints": creature.joints,
        "motors": [motor.id for motor in creature.motors],
        **({"voices": voices} if voices else {}),
        "sensors": [sensor.id for sensor in creature.sensors],
    }
    return reply if position == asked else {**reply, "moved_to": position}


def _bad_genome(error: DocumentError) -> WorldError:
    problems = "\n".join(line[:_PROBLEM_LENGTH] for line in error.lines)
    return WorldError("invalid", f"genome: {problems}", f"genome/{error.problems[0][0]}".rstrip("/"))


def drive(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Sets the targets of all motors of a creature, and what its voices say."""
    creature, controls = world.creature(command["creature"]), command["controls"]
    if command.get("layout", creature.layout) != creature.layout:
        what = f"{creature.name!r} has changed: its layout is {creature.layout} now, and no more {command['layout']}"
        raise WorldError("layout_changed", what, "layout")
    if creature.mind is not None:
        raise WorldError("invalid", f"creature: {creature.name!r} is driven by its own brain", "creature")
    motors, outputs = len(creature.motors), len(creature.body.outputs)
    if len(controls) != outputs:
        expected = "1 number, for its motor" if motors == 1 else f"{motors} numbers, one a motor"
        if outputs > motors:
            expected = (
                f"{outputs} numbers, one for each of its {motors} motors and then of its {outputs - motors} voices"
            )
        message = f"controls: {creature.name!r} takes {expected}, got {len(controls)}"
        raise WorldError("invalid", message, "controls")
    creature.drive(np.array(controls, float))
    return {"type": "driven", "creature": creature.name, **creature.changed}


def sense(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Reads all sensors of a creature."""
    creature = world.creature(command["creature"])
    return {"type": "senses", "creature": creature.name, "values": creature.sense(), **creature.changed}


def shed(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Cuts a part off a creature, and all that hangs on it alone."""
    creature = world.creature(command["creature"])
    cut = creature.shed(command["part"])
    if command.get("remove"):
        for cube in cut:
            world.entities.despawn(cube)
    names = [cube.name for cube in cut]
    creature = world.creature(creature.name)
    return {"type": "part_shed", "creature": creature.name, "layout": creature.layout, "cubes": names}


def grow(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Grows a part of a creature's body that is not there."""
    creature = world.creature(command["creature"])
    cube = growth.grow(world.entities, creature, command["part"])
    return _gained(world, creature.name, command["part"], cube.name)


def adopt(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Makes a cube of the world a part of a creature's body that is not there."""
    creature, cube = world.creature(command["creature"]), world.entities.cube(command["cube_name"])
    owner = next((name for name in world.creatures() if cube.body in world.creature(name).bodies), None)
    if owner is not None:
        raise WorldError("invalid", f"cube_name: {cube.name!r} is a part of {owner!r}", "cube_name")
    growth.adopt(world.entities, creature, command["part"], cube, world.all_creatures.is_part)
    return _gained(world, creature.name, command["part"], cube.name)


def _gained(world: World, name: str, part: str, cube: str) -> JsonObject:
    """Returns the reply to a creature that has gained a part, and has it told of."""
    creature = world.creature(name)
    world.all_creatures.note_growth(creature)
    return {"type": "part_grown", "creature": name, "part": part, "cube": cube, "layout": creature.layout}


def get_genome(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Tells the genome of a creature."""
    creature = world.creature(command["creature"])
    return {"type": "genome", "creature": creature.name, "genome": creature.genome.document}


COMMANDS = {
    "get_genome": get_genome,
    "spawn_creature": spawn_creature,
    "drive": drive,
    "sense": sense,
    "shed": shed,
    "grow": grow,
    "adopt": adopt,
}


def _cubes_of(world: World, client: Client, command: JsonObject) -> Touched:
    return [world.entities.cube(name) for name in world.creature(command["creature"]).cubes.values()]


def _with_target(world: World, client: Client, command: JsonObject) -> Touched:
    """The creature, and the cube that its sensors of a target are about."""
    creature, cubes = world.creature(command["creature"]), world.entities.cubes
    names = [*creature.cubes.values(), *([creature.target] if isinstance(creature.target, str) else [])]
    return [cubes[name] for name in names if name in cubes]


def _with_adopted(world: World, client: Client, command: JsonObject) -> Touched:
    """The creature, and all that joints connect with the cube: it may come along."""
    adopted = connected_cubes(world.entities.cube(command["cube_name"]), world.entities.joints)
    return [*(_cubes_of(world, client, command) or ()), *adopted]


def _with_lost(world: World, client: Client, command: JsonObject) -> Touched:
    """The creature, and what is joined to those cubes of it that are taken away."""
    cubes = [*(_cubes_of(world, client, command) or ())]
    limb = world.creature(command["creature"]).limb(command["part"]) if command.get("remove") else ()
    return cubes + [other for cube in limb for other in joined_cubes(cube, world.entities.joints)]


RIGHTS = {
    "spawn_creature": Right("build", nothing),
    "drive": Right("act", _cubes_of),
    "sense": Right("look", _with_target),
    "shed": Right("build", _with_lost),
    "grow": Right("build", _cubes_of),
    "adopt": Right("build", _with_adopted),
    "get_genome": Right("look", _cubes_of),
}
