"""Servers that are wrong about commands. See `defects`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from pytest import MonkeyPatch

from defects import Answer, JsonObject, around, defect
from nmes.backend import JointSpec
from nmes.backend.rotation import multiply, quaternion_from_euler
from nmes.world import World, joint_params
from nmes.world import entities as entities_module
from nmes.world.clients import Client
from nmes.world.entities import Cube, Entities, Joint
from nmes.world.fields import FieldReader

Quaternion = tuple[float, float, float, float]


def _rotations(patch: MonkeyPatch, read: Callable[[list[float]], list[float] | Quaternion]) -> None:
    """Has rotations in commands read as `read` says."""
    rotation = FieldReader.rotation
    patch.setattr(FieldReader, "rotation", lambda reader, value: rotation(reader, list(read(value))))


# -- commands ---------------------------------------------------------------------------------------------------------


@defect("5.8:z", "5.8:all", backend="mujoco")
def quaternions_with_w_first(patch: MonkeyPatch) -> None:
    """It takes the first of a quaternion's four numbers for w."""
    _rotations(patch, lambda value: value if len(value) == 3 else [*value[1:], value[0]])


@defect("5.7:all", "5.7:large")
def euler_angles_in_another_order(patch: MonkeyPatch) -> None:
    """It applies Euler angles in the order X, Y, Z."""

    def read(value: list[float]) -> list[float] | Quaternion:
        if len(value) == 4:
            return value
        x, y, z = (quaternion_from_euler(*(v if i == k else 0.0 for k, v in enumerate(value))) for i in range(3))
        return multiply(multiply(x, y), z)

    _rotations(patch, read)


@defect("5.4:edges", "13.5:flat")
def half_edges(patch: MonkeyPatch) -> None:
    """It takes the edges of a cube for the halves of them."""

    def double(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        if isinstance(command.get("size"), list):
            command = {**command, "size": [2 * edge for edge in command["size"]]}
        return answer(world, client, command)

    around(patch, "spawn_cube", double)


@defect("5.5")
def another_default(patch: MonkeyPatch) -> None:
    """It makes cubes of 2 kg where no mass is given."""
    around(patch, "spawn_cube", lambda answer, world, client, command: answer(world, client, {"mass": 2.0, **command}))


@defect("5.3")
def the_list_always(patch: MonkeyPatch) -> None:
    """It lists all cubes after a spawn, though told not to."""
    around(patch, "spawn_cube", lambda answer, world, client, command: answer(world, client, {**command, "list": True}))


@defect("5.11")
def despawn_leaves_joints(patch: MonkeyPatch) -> None:
    """It goes on telling the joints of a despawned cube in its neighbour's info."""
    cut = Entities.cut

    def keep(entities: Entities, joint: Joint) -> None:
        cut(entities, joint)
        joint.cube1.joints[joint.name] = joint.cube2.joints[joint.name] = None

    def despawn(entities: Entities, cube: Cube) -> list[str]:
        gone = [name for name in cube.joints if name in entities.joints]
        for name in gone:
            keep(entities, entities.joints[name])
        cube.joints.clear()
        return whole(entities, cube) or gone

    whole = Entities.despawn
    patch.setattr(Entities, "despawn", despawn)


@defect("5.16")
def removed_joints_listed(patch: MonkeyPatch) -> None:
    """It goes on listing joints that are gone."""
    joints: dict[str, JsonObject] = {}

    def keep(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        joints.update((joint["joint_name"], joint) for joint in reply["joints"])
        return {**reply, "joints": list(joints.values())}

    around(patch, "get_joint_list", keep)


@defect("5.11")
def despawn_tells_no_joints(patch: MonkeyPatch) -> None:
    """It does not say which joints went with a cube."""
    around(
        patch, "despawn_cube", lambda answer, world, client, command: {**answer(world, client, command), "joints": []}
    )


@defect("5.13:fixed", "5.13:hinge", backend="mujoco")
def anchors_in_the_first_cube(patch: MonkeyPatch) -> None:
    """It puts a joint into its first cube where no position is given."""

    def put(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        cube = world.entities.cubes.get(command["cube1"])
        if cube is not None and "position" not in command:
            command = {**command, "position": list(world.simulation.body_state(cube.body).position)}
        return answer(world, client, command)

    around(patch, "create_joint", put)


@defect("5.15:hinge-x", "13.29", "13.30", backend="mujoco")
def joints_with_the_wrong_axis(patch: MonkeyPatch) -> None:
    """It gives every joint the axis z."""
    patch.setattr(FieldReader, "axis", lambda reader, kind, value: (0.0, 0.0, 1.0))
    patch.setattr(entities_module, "JointSpec", lambda *fields: replace(JointSpec(*fields), axis=(0.0, 0.0, 1.0)))


@defect("5.18:damping", "5.18:limit_upper", backend="mujoco")
def parameters_forgotten(patch: MonkeyPatch) -> None:
    """It repeats a parameter of a joint, and does not set it."""

    def forget(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        joint = world.entities.joint(command["joint_name"])
        before = joint.params
        reply = answer(world, client, command)
        joint.params = before
        return reply

    around(patch, "set_joint_param", forget)


@defect("5.19", backend="mujoco")
def motors_stay_off(patch: MonkeyPatch) -> None:
    """It does not switch a motor on that gets a velocity."""
    adjust = joint_params.adjust

    def off(kind: str, params: Any, changes: Any, engine_step: float, path: str) -> joint_params.Params:
        adjusted = adjust(kind, params, changes, engine_step, path)
        if "motor_enabled" not in changes:
            adjusted["motor_enabled"] = params["motor_enabled"]
        return adjusted

    patch.setattr(joint_params, "adjust", off)


@defect("5.17")
def removed_joints_stay_in_cubes(patch: MonkeyPatch) -> None:
    """It goes on naming a removed joint in its cubes' info."""
    cut = Entities.cut

    def keep(entities: Entities, joint: Joint) -> None:
        cut(entities, joint)
        joint.cube1.joints[joint.name] = joint.cube2.joints[joint.name] = None

    def remove(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        with MonkeyPatch.context() as inner:
            inner.setattr(Entities, "cut", keep)
            return answer(world, client, command)

    around(patch, "remove_joint", remove)


@defect("5.47")
def a_state_forgets_the_rest(patch: MonkeyPatch) -> None:
    """It stops a cube that is only put somewhere else."""
    around(
        patch,
        "set_cube_state",
        lambda answer, world, client, command: answer(
            world, client, {"linear_velocity": [0, 0, 0], "angular_velocity": [0, 0, 0], **command}
        ),
    )


@defect("5.24", "13.18", "13.19")
def frozen_for_ever(patch: MonkeyPatch) -> None:
    """It freezes cubes and never lets them go."""
    freeze = Entities.freeze
    patch.setattr(Entities, "freeze", lambda entities, cube, frozen: freeze(entities, cube, frozen or cube.frozen))


@defect("5.26")
def a_world_without_velocities(patch: MonkeyPatch) -> None:
    """It leaves the velocities out of world_state."""

    def leave_out(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        return {**reply, "cubes": [{k: v for k, v in cube.items() if "velocity" not in k} for cube in reply["cubes"]]}

    around(patch, "get_world_state", leave_out)


@defect("5.34")
def a_batch_stops_at_an_error(patch: MonkeyPatch) -> None:
    """It leaves the rest of a batch undone when one of its commands fails."""

    def stop(answer: Answer, world: World, client: Client, batch: JsonObject) -> JsonObject:
        results: list[JsonObject] = []
        for command in batch["commands"]:
            results += answer(world, client, {**batch, "commands": [command]})["results"]
            if results[-1]["type"] == "error":
                break
        return {"type": "batch_result", "results": results}

    around(patch, "batch", stop)


@defect("5.34")
def a_batch_is_undone(patch: MonkeyPatch) -> None:
    """It undoes a batch of which a command fails."""

    def undo(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        before = world.snapshot()
        reply = answer(world, client, command)
        if any(result["type"] == "error" for result in reply["results"]):
            world.restore(before)
        return reply

    around(patch, "batch", undo)


@defect("5.32")
def a_batch_without_ids(patch: MonkeyPatch) -> None:
    """It loses the ids of a batch's commands."""

    def lose(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        results = answer(world, client, command)["results"]
        return {"type": "batch_result", "results": [{k: v for k, v in r.items() if k != "id"} for r in results]}

    around(patch, "batch", lose)


@defect("5.52:opaque", "5.52:with-opacity", "3.9:set_color")
def colours_that_are_only_said(patch: MonkeyPatch) -> None:
    """It says that a cube has another colour, and leaves it as it is."""

    def lie(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        name = world.entities.cube(command["cube_name"]).name
        return {"type": "color_set", "cube_name": name, "color": [*command["color"], 1.0][:4]}

    around(patch, "set_color", lie)


@defect("5.48", backend="mujoco")
def parameters_that_are_only_said(patch: MonkeyPatch) -> None:
    """It says that it sets several parameters of a joint, and sets none."""

    def lie(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        name = world.entities.joint(command["joint_name"]).name
        return {"type": "joint_params_set", "joint_name": name, "params": command["params"]}

    around(patch, "set_joint_params", lie)


@defect("5.49")
def joints_of_a_cube_newest_first(patch: MonkeyPatch) -> None:
    """It lists the joints of a cube from the newest to the oldest."""

    def turn(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        return {**reply, "joints": reply["joints"][::-1]}

    around(patch, "get_joints_for_cube", turn)


@defect("5.50")
def chains_without_links(patch: MonkeyPatch) -> None:
    """It joins nothing where chains are to be linked."""
    around(patch, "link_cube_chains", lambda *_: {"type": "cubes_linked", "joints": []})


@defect("5.51")
def bodies_linked_across_any_gap(patch: MonkeyPatch) -> None:
    """It joins the cubes of a body however far apart they are."""

    def reach(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        return answer(world, client, {**command, "gap": 1000.0})

    around(patch, "link_body_cubes", reach)
