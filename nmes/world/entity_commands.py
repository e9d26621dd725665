"""The commands about what is in a world: its cubes, joints and creatures.

It hides how their fields are read, and how replies are made of what `entities` and `creature` do. It knows nothing of
time, modes, faults and recordings: those are the World's, which asks it.

Invariant: a command that raises WorldError has changed nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from nmes import protocol
from nmes.errors import DocumentError, WorldError
from nmes.genome import Genome
from nmes.world.clients import Client
from nmes.world.creature import Creatures
from nmes.world.entities import Cube, Entities, identity

__all__ = ["Inhabitants"]

JsonObject = dict[str, Any]

_PROBLEMS, _SAID = 20, 300  # of a bad genome a reply tells so many, each in so many characters at most


class Inhabitants:
    """What is in a world, as clients command and see it."""

    def __init__(self, entities: Entities, creatures: Creatures) -> None:
        self._entities, self._creatures = entities, creatures

    def cube_or_own(self, client: Client, command: JsonObject) -> Cube:
        """Returns the cube that a command names, or else the one that its client spawned last.

        Raises:
            WorldError: `cube_not_found`, `nothing_owned`.
        """
        name = command.get("cube_name")
        if name is not None:
            return self._entities.cube(name)
        if client.owned is None:
            raise WorldError("nothing_owned", "no cube_name given, and this connection has spawned no cube")
        cube = self._entities.find(client.owned)
        if cube is None:
            raise WorldError("nothing_owned", f"the cube of this connection, {client.owned!r}, is gone")
        return cube

    # -- cubes --------------------------------------------------------------------------------------------------------

    def _spawn_cube(self, client: Client, c: JsonObject) -> JsonObject:
        cube = self._entities.spawn(c)
        client.owned = cube.name
        reply: JsonObject = {"type": "cube_list", "spawned": cube.name}
        if c.get("list", True):
            reply["cubes"] = self._entities.names()
        return reply

    def _despawn_cube(self, client: Client, c: JsonObject) -> JsonObject:
        cube = self._entities.cube(c["cube_name"])
        return {"type": "cube_despawned", "cube_name": cube.name, "joints": self._entities.despawn(cube)}

    def _apply_physics(self, client: Client, c: JsonObject) -> JsonObject:
        cube = self.cube_or_own(client, c)
        self._entities.apply(cube, c)
        return {"type": "physics_applied", "cube_name": cube.name}

    def _set_cube_state(self, client: Client, c: JsonObject) -> JsonObject:
        cube = self._entities.cube(c["cube_name"])
        self._entities.move(cube, c)
        return {"type": "cube_state_set", "cube_name": cube.name}

    def _freeze_cube(self, client: Client, c: JsonObject) -> JsonObject:
        cube = self._entities.cube(c["cube_name"])
        self._entities.freeze(cube, c["freeze"])
        return {"type": "cube_frozen", "cube_name": cube.name, "freeze": cube.frozen}

    def _get_cube_list(self, client: Client, c: JsonObject) -> JsonObject:
        return {"type": "cube_list", "cubes": self._entities.names()}

    def _get_cube_state(self, client: Client, c: JsonObject) -> JsonObject:
        return {"type": "cube_state", **self._entities.cube_state(self.cube_or_own(client, c))}

    def _get_cube_info(self, client: Client, c: JsonObject) -> JsonObject:
        entities = self._entities
        cube = entities.cube(c["cube_name"])
        reply = {"type": "cube_info", **entities.cube_info(cube)}
        if c.get("sensors"):
            reply.update(entities.inertial([cube])[0])
        if "rays" in c:
            default = protocol.COMMANDS["get_cube_info"].defaults
            reply["ranges"] = entities.ranges(cube, c["rays"], float(c.get("max_range", default["max_range"])))
        return reply

    def _get_camera(self, client: Client, c: JsonObject) -> JsonObject:
        return {"type": "camera_image", **self._entities.camera(self.cube_or_own(client, c), c)}

    # -- joints -------------------------------------------------------------------------------------------------------

    def _create_joint(self, client: Client, c: JsonObject) -> JsonObject:
        return {"type": "joint_created", "joint_name": self._entities.connect(c, c["joint_type"], "joint")}

    def _create_bone(self, client: Client, c: JsonObject) -> JsonObject:
        skeleton = c.get("snake_id", protocol.COMMANDS["create_bone"].defaults["snake_id"])
        return {"type": "bone_created", "bone_name": self._entities.connect(c, "conetwist", "bone", skeleton)}

    def _remove_joint(self, client: Client, c: JsonObject) -> JsonObject:
        joint = self._entities.joint(c["joint_name"])
        self._entities.cut(joint)
        return {"type": "joint_removed", "joint_name": joint.name}

    def _set_joint_param(self, client: Client, c: JsonObject) -> JsonObject:
        joint, name, value = self._entities.joint(c["joint_name"]), c["param_name"], c["value"]
        self._entities.set_param(joint, name, value)
        return {"type": "joint_param_set", "joint_name": joint.name, "param_name": name, "value": value}

    def _get_joint_list(self, client: Client, c: JsonObject) -> JsonObject:
        return {"type": "joint_list", "joints": [identity(joint) for joint in self._entities.joints()]}

    def _get_joint_info(self, client: Client, c: JsonObject) -> JsonObject:
        return {"type": "joint_info", **self._entities.joint_info(self._entities.joint(c["joint_name"]))}

    # -- creatures ----------------------------------------------------------------------------------------------------

    def _spawn_creature(self, client: Client, c: JsonObject) -> JsonObject:
        try:
            genome = Genome(c["genome"])
        except DocumentError as error:
            said = [f"{path}: {words}"[:_SAID] for path, words in error.problems[:_PROBLEMS]]
            more = [f"and {len(error.problems) - _PROBLEMS} more"] if len(error.problems) > _PROBLEMS else []
            where = f"genome/{error.problems[0][0]}".rstrip("/")
            raise WorldError("invalid", "genome: " + "\n".join(said + more), where) from error
        x, y, z = c.get("position", protocol.COMMANDS["spawn_creature"].defaults["position"])
        target = c.get("target")
        if target is not None and not isinstance(target, str):
            target = (float(target[0]), float(target[1]), float(target[2]))
        creature = self._creatures.spawn(genome, (float(x), float(y), float(z)), c.get("name"), target)
        return {
            "type": "creature_spawned",
            "creature": creature.name,
            "cubes": creature.cubes,
            "joints": creature.joints,
            "motors": [motor.id for motor in creature.motors],
            "sensors": [sensor.id for sensor in creature.sensors],
        }

    def _drive(self, client: Client, c: JsonObject) -> JsonObject:
        creature, controls = self._creatures.find(c["creature"]), c["controls"]
        if len(controls) != len(creature.motors):
            motors = len(creature.motors)
            many = "1 number, for its motor" if motors == 1 else f"{motors} numbers, one a motor"
            said = f"controls: {creature.name!r} takes {many}, got {len(controls)}"
            raise WorldError("invalid", said, "controls")
        creature.drive(np.array(controls, float))
        return {"type": "driven", "creature": creature.name}

    def _sense(self, client: Client, c: JsonObject) -> JsonObject:
        creature = self._creatures.find(c["creature"])
        return {"type": "senses", "creature": creature.name, "values": creature.sense()}

    def _get_planets(self, client: Client, c: JsonObject) -> JsonObject:
        return {"type": "planets", "planets": self._entities.planets()}

    COMMANDS: ClassVar[dict[str, Callable[[Inhabitants, Client, JsonObject], JsonObject]]] = {
        "spawn_cube": _spawn_cube,
        "despawn_cube": _despawn_cube,
        "create_joint": _create_joint,
        "create_bone": _create_bone,
        "remove_joint": _remove_joint,
        "set_joint_param": _set_joint_param,
        "get_joint_list": _get_joint_list,
        "get_joint_info": _get_joint_info,
        "apply_physics": _apply_physics,
        "apply_force": _apply_physics,
        "set_cube_state": _set_cube_state,
        "freeze_cube": _freeze_cube,
        "get_cube_list": _get_cube_list,
        "get_cube_info": _get_cube_info,
        "get_cube_state": _get_cube_state,
        "get_camera": _get_camera,
        "spawn_creature": _spawn_creature,
        "drive": _drive,
        "sense": _sense,
        "get_planets": _get_planets,
    }
