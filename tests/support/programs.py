"""Random programs of commands and ticks, the same for the same number.

A program is drawn without looking at the world, then played: each draw picks among what is there at that moment. So
two worlds that behave the same get the same commands, and the first difference shows in a reply or a digest.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

from nmes import World

Command = dict[str, Any]
Draw = tuple[str, list[float]]

KINDS = {
    "spawn": 10,
    "despawn": 2,
    "join": 8,
    "cut": 3,
    "param": 5,
    "push": 8,
    "move": 2,
    "freeze": 3,
    "tick": 20,
    "query": 6,
    "reset": 0.2,
}
JOINT_TYPES = ["fixed", "hinge", "slide", "pin", "hinge", "conetwist"]
PARAMS: list[tuple[str, Callable[[float], float | bool]]] = [
    ("motor_target_velocity", lambda u: 6 * u - 3),
    ("target_position", lambda u: 2 * u - 1),
    ("motor_enabled", lambda u: u < 0.5),
    ("stiffness", lambda u: 20 * u),
    ("damping", lambda u: 2 * u),
    ("motor_max_force", lambda u: 20 * u),
]


def draw(number: int, length: int) -> list[Draw]:
    """Draws a program of `length` steps; the number is the seed."""
    source = random.Random(number)
    kinds = source.choices(list(KINDS), list(KINDS.values()), k=length)
    return [(kind, [source.random() for _ in range(12)]) for kind in kinds]


def commands(world: World, step: Draw, queries: bool = True) -> list[Command]:
    """Returns the commands that one draw means in a world."""
    kind, u = step
    cubes, joints = world.cubes(), world.joints()

    def pick(choices: list[Any], by: float) -> Any:
        return choices[int(by * len(choices))]

    if kind == "spawn":
        return [
            {
                "type": "spawn_cube",
                "position": [4 * u[0] - 2, 4 * u[1] + 0.5, 4 * u[2] - 2],
                "rotation": [u[3] - 0.5, u[4] - 0.5, u[5] - 0.5],
                "size": [0.3 + u[6], 0.3 + u[7], 0.3 + u[8]],
                "mass": 0.2 + 3 * u[9],
                "is_base": u[10] < 0.15,
                "linear_velocity": [u[0] - 0.5, 0, u[3] - 0.5],
                "restitution": 0.5 * u[11],
            }
        ]
    if kind == "tick":
        return [{"type": "step", "ticks": 1 + int(12 * u[0])}]
    if kind == "reset":
        return [{"type": "reset"}]
    if not cubes:
        return []
    cube = pick(cubes, u[0])
    if kind == "despawn":
        return [{"type": "despawn_cube", "cube_name": cube}]
    if kind == "join":
        command: Command = {
            "type": "create_joint",
            "cube1": cube,
            "cube2": pick(cubes, u[1]),
            "joint_type": pick(JOINT_TYPES, u[2]),
            "axis": [u[3] - 0.5, u[4] - 0.5, u[5] + 0.1],
        }
        if command["joint_type"] == "conetwist" and u[6] < 0.6:
            command["limits"] = [0.2 + u[7], u[8]]
        return [command]
    if kind == "push":
        command = {
            "type": "apply_physics",
            "cube_name": cube,
            "force": [20 * u[1] - 10, 20 * u[2], 20 * u[3] - 10],
        }
        if u[8] < 0.4:
            command["impulse"] = [u[4] - 0.5, u[5], u[6] - 0.5]
        if u[7] < 0.3:
            command["at"] = [u[1], u[2], u[3]]
        return [command]
    if kind == "move":
        if u[7] < 0.5:
            position = [4 * u[1] - 2, 4 * u[2] + 0.5, 4 * u[3] - 2]
            return [{"type": "set_cube_state", "cube_name": cube, "position": position, "rotation": u[4:7]}]
        return [{"type": "set_cube_state", "cube_name": cube, "linear_velocity": u[1:4]}]
    if kind == "freeze":
        return [{"type": "freeze_cube", "cube_name": cube, "freeze": u[1] < 0.5}]
    if kind == "query":
        if not queries:
            return []
        return [
            *({"type": "get_cube_info", "cube_name": name} for name in cubes),
            *({"type": "get_joint_info", "joint_name": name} for name in joints),
            {"type": "get_world_state"},
        ]
    if not joints:
        return []
    joint = pick(joints, u[0])
    if kind == "cut":
        return [{"type": "remove_joint", "joint_name": joint}]
    name, value = pick(PARAMS, u[2])
    return [{"type": "set_joint_param", "joint_name": joint, "param_name": name, "value": value(u[1])}]


def play(world: World, program: list[Draw], queries: bool = True) -> tuple[list[dict[str, Any]], list[bytes]]:
    """Plays a program in a world in lockstep; returns all replies, and the digest after each command."""
    client = world.join()
    replies, digests = [], []
    for step in program:
        for command in commands(world, step, queries):
            replies.append(world.execute(client, command))
        digests.append(world.digest())
    return replies, digests
