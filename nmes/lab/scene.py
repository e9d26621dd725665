"""What a page draws: a scene, which says who is there, where food is, and frames, which say where they are.

Hides how a world is read in one go. Neither changes the world nor is recorded.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from nmes.backend.rotation import conjugate, rotate
from nmes.schemas.documents import JsonObject, write_json
from nmes.world import World
from nmes.world.fields import FieldReader
from nmes.world.scenery import scene_spec

__all__ = ["FORCES", "food_text", "force_text", "frame_bytes", "mind_text", "scene_text"]

_HEAD: Final = struct.Struct("<II")
_MOST: Final = 4000  # contacts that are told
_UNITS: Final = 1000  # units of a brain that are told
_DRIVEN: Final = frozenset({"hinge", "slide"})  # joints that may have motors
_RECENT: Final = 0.1  # s of the world: how long a push, which lasts a tick, is told
_FINEST: Final = 129  # heights along each side of a landscape that are told


def scene_text(world: World, number: int) -> str:
    """Returns who is in a world, as the text frame of that number."""
    names = world.cubes()
    places = {name: place for place, name in enumerate(names)}
    owners: dict[str, str] = {}
    creatures = []
    for name in world.creatures():
        creature = world.creature(name)
        owners |= dict.fromkeys((str(cube) for cube in creature.cubes.values()), name)
        creatures.append({"name": name, "genome": creature.genome.name, "target": creature.target})
    cubes = []
    for name in names:
        size, color, shape = world.cube_shape(name)
        cube = world.entities.cube(name)
        one = {"name": name, "size": size, "color": color, "shape": shape, "creature": owners.get(name)}
        cubes.append({**one, "frozen": cube.frozen, "mass": cube.mass})
    scene = {
        "type": "scene",
        "scene": number,
        "world": world.config["name"],
        "frame": world.frame,
        "dims": world.backend.dims,
        "tick_rate": world.config["tick_rate"],
        "cubes": cubes,
        "joints": _joints(world, places),
        "creatures": creatures,
        "scenery": _scenery(world),
    }
    return write_json(scene).decode()


def _joints(world: World, places: dict[str, int]) -> list[JsonObject]:
    """Returns the joints, each with where it is on its first cube; none of a world that has stopped by a fault."""
    states, joints = world.poses()[1], []
    for info in world.joint_infos() if world.fault is None else ():
        a, b = places[info["cube1"]], places[info["cube2"]]
        position, turn = states[a, :3].tolist(), conjugate(tuple(states[a, 3:7].tolist()))
        x, y, z = (one - other for one, other in zip(info["anchor"], position, strict=True))
        joint = {"name": info["joint_name"], "kind": info["joint_type"], "a": a, "b": b}
        joints.append({**joint, "anchor": rotate(turn, (x, y, z)), "axis": rotate(turn, tuple(info["axis"]))})
    return joints


def _scenery(world: World) -> JsonObject:
    """Returns the parts of the scene that never move."""
    spec = scene_spec(world.config, world.seed)
    boxes = [
        {"size": box.size, "position": box.position, "quaternion": box.quaternion, "shape": box.shape}
        for box in spec.boxes
    ]
    scenery: dict[str, Any] = {"ground": spec.ground, "boxes": boxes, "landscape": None}
    scenery["planets"] = [{"position": planet.position, "radius": planet.radius} for planet in spec.planets]
    if spec.medium is not None:
        scenery["medium"] = {"density": spec.medium.density, "level": spec.medium.level}
    if spec.heightfield is not None:
        heights = spec.heightfield.heights
        rows, columns = (np.linspace(0, count - 1, min(count, _FINEST)).round().astype(int) for count in heights.shape)
        scenery["landscape"] = {"size": spec.heightfield.size, "heights": heights[np.ix_(rows, columns)].tolist()}
    return scenery


def food_text(world: World) -> str | None:
    """Returns where the food of an ecosystem is, as a text frame: equal texts, equal food; None in any other world."""
    if world.life is None:
        return None
    return write_json({"type": "food", "food": world.entities.food.round(4).tolist()}).decode()


def frame_bytes(world: World, number: int, frame: int) -> bytes:
    """Returns where the cubes of a world are: its binary frame, as of that scene and that frame of the world."""
    return _HEAD.pack(number, frame & 0xFFFFFFFF) + world.entities.states()[:, :7].astype("<f4").tobytes()


def _contacts(world: World, number: int) -> str:
    """Returns where cubes touch, and with what force (N), as a text frame; of very many contacts the strongest."""
    bodies = {body: place for place, body in enumerate(world.entities.body_names)}
    simulation = world.simulation
    contacts = [
        [bodies[body], -1 if contact.other is None else bodies.get(contact.other, -1)]
        + [round(value, 4) for value in (*contact.position, *contact.normal, contact.force)]
        for body in bodies
        for contact in simulation.contacts(body)
    ]
    if len(contacts) > _MOST:
        contacts = sorted(contacts, key=lambda contact: -contact[-1])[:_MOST]
    return _text("contacts", world, number, contacts)


def _motors(world: World, number: int) -> str:
    """Returns the efforts of motors (N m, of slides N), by the places of their joints in the scene, as a text frame."""
    driven = [
        (place, joint.number) for place, joint in enumerate(world.entities.joints.values()) if joint.kind in _DRIVEN
    ]
    efforts = world.simulation.joint_readings(tuple(joint for _, joint in driven))[:, 2].tolist()
    motors = [[place, round(effort, 4)] for (place, _), effort in zip(driven, efforts, strict=True) if effort]
    return _text("motors", world, number, motors)


def _pushes(world: World, number: int) -> str:
    """Returns the latest pushes of clients, by the places of cubes in the scene, as a text frame.

    Each row has where a cube was pushed, the force (N) and the torque (N m); an impulse counts as what gives as much
    in one tick.
    """
    places = {name: place for place, name in enumerate(world.cubes())}
    rate, pushes, states = world.config["tick_rate"], world.pushes, world.entities.states()
    recent = 0 <= world.frame - pushes.frame <= max(1, _RECENT * rate)
    rows = []
    for name, command in pushes.commands.items() if recent else ():
        if name in places:
            push = _push(world.entities.fields, command, rate)
            at = world.entities.fields.position(command["at"]) if "at" in command else states[places[name], :3].tolist()
            rows.append([places[name], *(round(value, 4) for value in (*at, *push))])
    return _text("pushes", world, number, rows)


def _push(fields: FieldReader, command: JsonObject, rate: float) -> list[float]:
    """Returns force and torque of an `apply_physics` command; of its impulses what gives as much in one tick."""

    def acting(read: Callable[[Any], Sequence[float]], lasting: str, sudden: str) -> list[float]:
        one, other = (read(command[field]) if field in command else (0.0, 0.0, 0.0) for field in (lasting, sudden))
        return [force + rate * impulse for force, impulse in zip(one, other, strict=True)]

    return [*acting(fields.position, "force", "impulse"), *acting(fields.turn, "torque", "angular_impulse")]


_FORCES: Final[Mapping[str, Callable[[World, int], str]]] = {
    "contacts": _contacts,
    "motors": _motors,
    "pushes": _pushes,
}
FORCES: Final = tuple(_FORCES)
"""The kinds of forces that are told to those who ask for them."""
_MANY: Final = 2000  # cubes of a world of which none of these is told any more


def force_text(kind: str, world: World, number: int) -> str | None:
    """Returns the forces of a kind in a world as a text frame; None where it has very many cubes, or has stopped."""
    if len(world.entities.cubes) > _MANY or world.fault is not None:
        return None
    return _FORCES[kind](world, number)


def mind_text(world: World, number: int, name: str) -> str | None:
    """Returns the activity of a creature's brain as a text frame; None where there is no such creature.

    `units` are those of a brain with a memory that the world runs, `controls` what it was driven with last.
    """
    if name not in world.creatures():
        return None
    creature = world.creature(name)
    units = [] if creature.mind is None else creature.mind.activity()[:_UNITS].tolist()
    controls = [] if creature.controls is None else creature.controls[:_UNITS].tolist()
    told = {"type": "mind", "scene": number, "frame": world.frame, "creature": name, "own": creature.mind is not None}
    return write_json({**told, "units": units, "controls": controls}).decode()


def _text(kind: str, world: World, number: int, rows: list[list[float]]) -> str:
    return write_json({"type": kind, "scene": number, "frame": world.frame, kind: rows}).decode()
