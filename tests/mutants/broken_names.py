"""Servers that are wrong about fields, errors, names, ownership, several clients or capabilities. See `defects`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pytest import MonkeyPatch

from defects import Answer, JsonObject, around, defect
from nmes import protocol
from nmes.errors import RejectedMessage, WorldError
from nmes.protocol import messages, session
from nmes.schemas.documents import CompiledSchema
from nmes.world import World, joint_params
from nmes.world.clients import Client
from nmes.world.commands import general
from nmes.world.entities import Entities

# -- fields and errors ------------------------------------------------------------------------------------------------


def _before_checks(patch: MonkeyPatch, mend: Callable[[JsonObject], JsonObject]) -> None:
    """Has commands changed before they are looked at."""
    check = messages._check

    def lenient(command: JsonObject, path: str = "") -> RejectedMessage | None:
        mended = dict(mend(command))
        command.clear()
        command.update(mended)
        return check(command, path)

    patch.setattr(messages, "_check", lenient)


@defect("4.9", "2.18")
def unknown_fields_refused(patch: MonkeyPatch) -> None:
    """It refuses commands, auth too, with fields that it does not know."""
    find, checked = messages.find_error, messages._check

    def unknown(schema: CompiledSchema, message: JsonObject) -> RejectedMessage | None:
        names = sorted(set(message) - set(schema.schema["properties"]) - {"id"})
        return RejectedMessage("invalid", f"{names[0]}: there is no such field", names[0]) if names else None

    def check(command: JsonObject, path: str = "") -> RejectedMessage | None:
        return checked(command, path) or unknown(protocol.COMMANDS[command["type"]], command)

    # Only what the server reads: the suite reads replies in this process too.
    patch.setattr(messages, "_check", check)
    patch.setattr(session, "find_error", lambda schema, message: find(schema, message) or unknown(schema, message))


@defect("4.11")
def types_in_any_case(patch: MonkeyPatch) -> None:
    """It takes PING for ping."""
    _before_checks(
        patch,
        lambda command: (
            {**command, "type": command["type"].lower()} if isinstance(command.get("type"), str) else command
        ),
    )


@defect("6.1:spawn_cube.mass", "4.10:text")
def text_for_numbers(patch: MonkeyPatch) -> None:
    """It takes anything but a number for a mass of 1 kg."""

    def mend(command: JsonObject) -> JsonObject:
        mass = command.get("mass", 1.0)
        return command if type(mass) in (int, float) else {**command, "mass": 1.0}

    _before_checks(patch, mend)


@defect("6.1:spawn_cube.position", "6.1:apply_physics.force")
def a_little_beyond_the_bounds(patch: MonkeyPatch) -> None:
    """It takes numbers of vectors that are a little beyond their bounds for the bounds."""

    def mend(command: JsonObject) -> JsonObject:
        near = {name: command[name] for name in ("position", "force") if isinstance(command.get(name), list)}
        for name, values in near.items():
            bound = {"position": 1e6, "force": 1e15}[name]
            near[name] = [
                max(-bound, min(bound, value)) if type(value) is float and abs(value) < 2 * bound else value
                for value in values
            ]
        return {**command, **near}

    _before_checks(patch, mend)


@defect("6.1:set_joint_param.param_name", backend="mujoco")
def any_parameter(patch: MonkeyPatch) -> None:
    """It says that it sets parameters that there are not."""

    def mend(command: JsonObject) -> JsonObject:
        known = command.get("param_name") in joint_params.CAPABILITY
        return (
            command if command.get("type") != "set_joint_param" or known else {"type": "ping", "id": command.get("id")}
        )

    _before_checks(patch, mend)


def _errors(patch: MonkeyPatch, change: Callable[[JsonObject], JsonObject]) -> None:
    """Has errors told otherwise."""
    error_reply = protocol.error_reply
    for module in (protocol, session):
        patch.setattr(module, "error_reply", lambda error, kind=None: change(error_reply(error, kind)))


@defect("7.1:despawn_cube", "7.3:set_joint_param", only_strict=True, backend="mujoco")
def errors_without_command(patch: MonkeyPatch) -> None:
    """It does not say in an error which command it is about."""
    _errors(patch, lambda reply: {k: v for k, v in reply.items() if k != "command"})


@defect("7.1:despawn_cube", "7.1:get_cube_info", "7.4:cube2")
def one_code_for_all(patch: MonkeyPatch) -> None:
    """It says `invalid` where a cube is not found."""
    _errors(patch, lambda reply: {**reply, "code": "invalid"} if reply["code"] == "cube_not_found" else reply)


@defect("7.1:get_cube_info")
def codes_of_its_own(patch: MonkeyPatch) -> None:
    """It tells errors by codes that the protocol does not have."""
    _errors(patch, lambda reply: {**reply, "code": "E404"} if reply["code"] == "cube_not_found" else reply)


@defect("7.7:other-order")
def joined_once(patch: MonkeyPatch) -> None:
    """It makes no second joint of a pair when the other cube is named first."""

    def once(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        for joint in world.entities.joints.values():
            if (joint.cube2.name, joint.cube1.name) == (command["cube1"], command["cube2"]):
                return {"type": "joint_created", "joint_name": joint.name}
        return answer(world, client, command)

    around(patch, "create_joint", once)


@defect("7.18")
def joints_of_one_name(patch: MonkeyPatch) -> None:
    """It puts a number behind the name of a joint without being asked to."""

    def numbered(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        return answer(world, client, {**command, "number_if_taken": True})

    around(patch, "create_joint", numbered)


@defect("7.17", backend="mujoco")
def limits_upside_down(patch: MonkeyPatch) -> None:
    """It takes limits of which the lower is above the upper."""
    adjust = joint_params.adjust

    def sort(kind: str, params: Any, changes: Any, engine_step: float, path: str) -> joint_params.Params:
        if changes.get("limit_lower", 0) > changes.get("limit_upper", float("inf")):
            changes = {**changes, "limit_lower": changes["limit_upper"], "limit_upper": changes["limit_lower"]}
        return adjust(kind, params, changes, engine_step, path)

    patch.setattr(joint_params, "adjust", sort)


@defect("7.14")
def a_refused_spawn_disowns(patch: MonkeyPatch) -> None:
    """It forgets what a connection owns when it refuses to spawn."""

    def disown(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        client.owned = None
        return answer(world, client, command)

    around(patch, "spawn_cube", disown)


@defect("7.5")
def a_cube_of_that_name_again(patch: MonkeyPatch) -> None:
    """It replaces a cube by another one of the same name."""

    def replace_it(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        cube = world.entities.cubes.get(command.get("cube_name", "") + ("_BASE" if command.get("is_base") else ""))
        if cube is not None:
            world.entities.despawn(cube)
        return answer(world, client, command)

    around(patch, "spawn_cube", replace_it)


@defect("7.6")
def a_cube_joined_to_itself(patch: MonkeyPatch) -> None:
    """It says `invalid` where a cube is to be joined to itself."""
    _errors(patch, lambda reply: {**reply, "code": "invalid"} if reply["code"] == "self_joint" else reply)


@defect("7.9:apply_physics")
def nothing_owned_is_not_found(patch: MonkeyPatch) -> None:
    """It says `cube_not_found` where a connection owns nothing."""
    _errors(patch, lambda reply: {**reply, "code": "cube_not_found"} if reply["code"] == "nothing_owned" else reply)


@defect("6.6", only_strict=True)
def fields_without_their_place(patch: MonkeyPatch) -> None:
    """It names the field of an error, and not the number in it."""
    _errors(patch, lambda reply: {**reply, "field": reply["field"].split("/")[0]} if "field" in reply else reply)


# -- names and ownership ----------------------------------------------------------------------------------------------


@defect("8.2")
def names_used_again(patch: MonkeyPatch) -> None:
    """It gives the name of a despawned cube to the next one without a name."""
    patch.setattr(Entities, "draw", lambda entities, prefix, count: f"{prefix}_{_lowest(entities, prefix)}_00000000")


def _lowest(entities: Entities, prefix: str) -> int:
    taken = {*entities.cubes, *entities.joints}
    return next(n for n in range(1, 1 << 20) if f"{prefix}_{n}_00000000" not in taken)


@defect("8.7", "3.17")
def the_first_cube_owned(patch: MonkeyPatch) -> None:
    """It lets a connection own the first cube that it spawned, not the last."""

    def first(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        owned = client.owned
        reply = answer(world, client, command)
        client.owned = owned or client.owned
        return reply

    around(patch, "spawn_cube", first)


@defect("8.8", "8.13")
def the_last_cube_of_all_owned(patch: MonkeyPatch) -> None:
    """It lets all own the cube that was spawned last, whoever did it."""

    def last(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        names = world.cubes()
        client.owned = names[-1] if names else None
        return answer(world, client, command)

    for kind in ("apply_physics", "apply_force", "get_cube_state"):
        around(patch, kind, last)


@defect("8.9")
def an_older_cube_owned_again(patch: MonkeyPatch) -> None:
    """It lets a connection whose cube is gone own the one that it spawned before."""
    spawned: dict[int, list[str]] = {}

    def remember(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        spawned.setdefault(client.number, []).append(reply["spawned"])
        return reply

    def older(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        there = [name for name in spawned.get(client.number, []) if world.entities.cubes.get(name) is not None]
        client.owned = there[-1] if there else None
        return answer(world, client, command)

    around(patch, "spawn_cube", remember)
    around(patch, "apply_physics", older)


@defect("8.12")
def cubes_go_with_their_connection(patch: MonkeyPatch) -> None:
    """It despawns the cube of a connection that goes."""
    leave = World.leave

    def take_along(world: World, client: int) -> None:
        owned = world._clients[client].owned
        cube = None if owned is None else world.entities.cubes.get(owned)
        if cube is not None:
            world.entities.despawn(cube)
        leave(world, client)

    patch.setattr(World, "leave", take_along)


@defect("8.4", "8.6")
def bases_without_suffix(patch: MonkeyPatch) -> None:
    """It calls a base as it was told, without _BASE."""

    def plain(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        if not command.get("is_base"):
            return answer(world, client, command)
        reply = answer(world, client, {**command, "is_base": False})
        world.entities.freeze(world.entities.cube(reply["spawned"]), True)
        return reply

    around(patch, "spawn_cube", plain)


@defect("8.5", "13.17")
def bases_that_move(patch: MonkeyPatch) -> None:
    """It does not freeze a base."""

    def let_go(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        if command.get("is_base"):
            world.entities.freeze(world.entities.cube(reply["spawned"]), False)
        return reply

    around(patch, "spawn_cube", let_go)


@defect("8.19")
def names_without_case(patch: MonkeyPatch) -> None:
    """It takes names that differ only by case for one."""
    _before_checks(
        patch,
        lambda command: {k: v.lower() if k == "cube_name" and isinstance(v, str) else v for k, v in command.items()},
    )


@defect("8.17:space", "8.17:tab")
def names_with_white_space(patch: MonkeyPatch) -> None:
    """It replaces white space in names."""
    _before_checks(
        patch,
        lambda command: {
            k: "_".join(v.split()) if k == "cube_name" and isinstance(v, str) else v for k, v in command.items()
        },
    )


@defect("8.14")
def cubes_in_order_of_names(patch: MonkeyPatch) -> None:
    """It lists cubes in the order of their names."""
    around(
        patch,
        "get_cube_list",
        lambda answer, world, client, command: {"type": "cube_list", "cubes": sorted(world.cubes())},
    )


@defect("8.20")
def one_name_for_all_joints(patch: MonkeyPatch) -> None:
    """It gives joints the name of their first cube."""

    def name(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        return {**answer(world, client, command), "joint_name": f"joint_of_{command['cube1']}"}

    around(patch, "create_joint", name)


@defect("9.1")
def a_world_for_each(patch: MonkeyPatch) -> None:
    """It shows each client only the cubes that it spawned itself."""
    spawned: dict[int, list[str]] = {}

    def remember(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        spawned.setdefault(client.number, []).append(reply["spawned"])
        return reply

    def own(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        mine = spawned.get(client.number, [])
        return {"type": "cube_list", "cubes": [name for name in world.cubes() if name in mine]}

    around(patch, "spawn_cube", remember)
    around(patch, "get_cube_list", own)


# -- capabilities -----------------------------------------------------------------------------------------------------


def _refuse(code: str) -> Callable[[Answer, World, Client, JsonObject], JsonObject]:
    def refuse(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        raise WorldError(code, "this server has no such thing")

    return refuse


@defect("16.1:batch")
def claimed_and_lacking(patch: MonkeyPatch) -> None:
    """It claims batch, and does not have it."""
    around(patch, "batch", _refuse("unsupported"))


@defect("16.2:set_joint_param")
def required_and_lacking(patch: MonkeyPatch) -> None:
    """It does not have set_joint_param, which all must have."""
    _before_checks(
        patch, lambda command: {**command, "type": "?"} if command.get("type") == "set_joint_param" else command
    )


@defect("16.3:hinge", only_strict=True)
def joints_that_it_does_not_claim(patch: MonkeyPatch) -> None:
    """It makes a fixed joint where it has none of the kind that was asked for."""
    around(
        patch,
        "create_joint",
        lambda answer, world, client, command: answer(world, client, {**command, "joint_type": "fixed"}),
    )


@defect("16.4", only_strict=True)
def claims_that_are_none(patch: MonkeyPatch) -> None:
    """It claims to have a ping, which all must have, as something special."""
    capabilities = general.capabilities
    patch.setattr(general, "capabilities", lambda *args: [*capabilities(*args), "ping"])


@defect("16.5:stiffness")
def parameters_of_joints_that_have_none(patch: MonkeyPatch) -> None:
    """It says that it sets the stiffness of a fixed joint."""

    def pretend(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        return {"type": "joint_param_set", **{key: command[key] for key in ("joint_name", "param_name", "value")}}

    around(patch, "set_joint_param", pretend)


@defect("12.8", config={"limits": {"cubes": 200}})
def more_cubes_than_the_limit(patch: MonkeyPatch) -> None:
    """It tells a limit of cubes and does not hold to it."""
    patch.setattr(Entities, "require_room", lambda entities, cubes=0, joints=0: None)


@defect("17.1:0")
def what_is_spawned_owned_by_all(patch: MonkeyPatch) -> None:
    """It lets everybody own what anybody spawns."""

    def share(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        reply = answer(world, client, command)
        for other in world._clients.values():
            other.owned = reply["spawned"]
        return reply

    around(patch, "spawn_cube", share)
