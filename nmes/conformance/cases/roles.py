"""Roles: who may do what, to whose things, and how a player comes back.

The cases enter as `player` and `viewer`, with the one password that opens every role; a world in which one of them is
missing, or means something else, is asked nothing of it.
"""

from __future__ import annotations

from typing import Any

from nmes.conformance.case import Category, Finding, Row, Unimplemented
from nmes.conformance.trial import Trial
from nmes.conformance.wire import Message, Wire, clip

ROLES = Category(20, "roles")
case, table = ROLES.case, ROLES.table

NEEDS = ("roles", "get_world_info")


def enter(t: Trial, role: str = "player", **fields: Any) -> tuple[Wire, Message]:
    """Returns a connection in a role, and the server's `auth_success`."""
    roles = t.ask(t.join(), {"type": "get_world_info"}, "world_info")["config"].get("roles", {})
    if roles.get(role) != {}:
        raise Unimplemented(f"the world has no role {role!r} in the sense of the protocol")
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password, "role": role, **fields})
    welcome = wire.hear(what="auth_success")
    if welcome["type"] != "auth_success":
        raise Finding("auth_success", clip(welcome))
    t.equal(welcome["role"], role, "the role")
    return wire, welcome


def refused_entry(t: Trial, codes: str, **fields: Any) -> None:
    """Makes sure that an `auth` is refused with a code."""
    wire = t.connect()
    wire.say({"type": "auth", "password": t.target.password, **fields})
    t.error(wire.hear(what="an error"), codes)


@case(1, "3.10.1", needs=NEEDS)
def a_connection_has_a_role_and_is_a_players(t: Trial) -> None:
    """In a world with roles auth_success tells role, player and token, and each newcomer is another player."""
    first, second = enter(t)[1], enter(t)[1]
    t.true(first["player"] != second["player"], "another player", second)
    t.true(first["token"] != second["token"], "another token", second)


@case(2, "4.error.role_not_found", needs=NEEDS)
def a_role_that_there_is_not(t: Trial) -> None:
    """A role that the world does not have gets role_not_found."""
    refused_entry(t, "role_not_found", role="no-such-role")


def looks(t: Trial, wire: Wire, name: str) -> list[Any]:
    """Returns the fields of a cube that a command could have changed."""
    info = t.info(wire, name)
    return [info[field] for field in ("position", "color", "frozen", "player")]


OTHERS: dict[str, dict[str, Any]] = {
    "despawn_cube": {},
    "apply_physics": {"impulse": [1, 0, 0]},
    "apply_force": {"force": [1, 0, 0]},
    "set_color": {"color": [1, 0, 0]},
    "set_cube_state": {"position": [0, 9, 0]},
    "freeze_cube": {"freeze": False},
    "give": {"player": 1},
}


@table(3, "3.10.3", [Row(kind, kind, (kind,), f"4.{kind}") for kind in OTHERS], needs=NEEDS)
def what_is_anothers_is_left_alone(t: Trial, kind: str) -> None:
    """A player gets not_allowed for a command to a cube that is another's, and nothing changes."""
    one, two = enter(t)[0], enter(t)[0]
    name = t.base(one)
    before = looks(t, one, name)
    t.refused(two, {"type": kind, "cube_name": name, **OTHERS[kind]}, "not_allowed")
    t.equal(looks(t, one, name), before, "the cube as it was")


@case(4, "3.10.2", needs=("joint.fixed", *NEEDS))
def joints_belong_to_whom_both_cubes_belong(t: Trial) -> None:
    """A joint needs two cubes that are the player's own, and is nobody else's to remove or to set."""
    one, two = enter(t)[0], enter(t)[0]
    mine, other, theirs = t.base(one), t.base(one, position=t.at(1.5)), t.base(two, position=t.at(3))
    t.refused(two, {"type": "create_joint", "cube1": mine, "cube2": theirs, "joint_type": "fixed"}, "not_allowed")
    joint = t.join_cubes(one, mine, other)
    t.refused(two, {"type": "remove_joint", "joint_name": joint}, "not_allowed")
    params = {"param_name": "damping", "value": 1}
    t.refused(two, {"type": "set_joint_param", "joint_name": joint, **params}, "not_allowed")
    t.equal(t.info(one, mine)["joints"], [joint], "joints")
    t.ask(one, {"type": "remove_joint", "joint_name": joint}, "joint_removed")


@table(
    5, "3.10.3", [Row(kind, kind, (kind,), f"4.{kind}") for kind in ("step", "pause", "set_mode", "reset")], needs=NEEDS
)
def time_is_not_a_players(t: Trial, kind: str) -> None:
    """A player gets not_allowed for a command about time, and for reset."""
    fields = {"mode": t.probe.mode} if kind == "set_mode" else {}
    t.refused(enter(t)[0], {"type": kind, **fields}, "not_allowed")


@case(6, "3.10.3", needs=NEEDS)
def a_viewer_looks(t: Trial) -> None:
    """A viewer sees what is others', and changes nothing."""
    player, viewer = enter(t)[0], enter(t, "viewer")[0]
    name = t.base(player)
    t.true(name in t.cubes(viewer), f"{name} in the viewer's list", name)
    t.equal(t.info(viewer, name)["cube_name"], name, "the cube that the viewer sees")
    t.refused(viewer, {"type": "despawn_cube", "cube_name": name}, "not_allowed")
    spawn = {"type": "spawn_cube", "cube_name": t.name(), "position": t.at(4), "list": False}
    t.refused(viewer, spawn, "not_allowed")


@case(7, "3.10.4", needs=("batch", *NEEDS))
def parts_of_a_batch_are_judged_one_by_one(t: Trial) -> None:
    """Of a batch, what a player may not do is refused, and the rest is done."""
    one, two = enter(t)[0], enter(t)[0]
    theirs, mine = t.base(one), t.base(two, position=t.at(1.5))
    parts = [{"type": "despawn_cube", "cube_name": name} for name in (theirs, mine)]
    results = t.ask(two, {"type": "batch", "commands": parts}, "batch_result")["results"]
    t.equal(
        [result.get("code", result["type"]) for result in results], ["not_allowed", "cube_despawned"], "the results"
    )
    t.true(theirs in t.cubes(one), f"{theirs} in the list", theirs)


@case(8, "3.10.5", needs=NEEDS)
def a_token_brings_a_player_back(t: Trial) -> None:
    """With the token of an earlier connection, what was spawned there is one's own again."""
    first, welcome = enter(t)
    name = t.base(first)
    first.hang_up()
    again, back = enter(t, token=welcome["token"])
    t.equal(back["player"], welcome["player"], "the player")
    t.ask(again, {"type": "despawn_cube", "cube_name": name}, "cube_despawned")


@case(9, "3.10.5", needs=NEEDS)
def a_token_is_good_for_its_player_alone(t: Trial) -> None:
    """A token that nobody was told, or that was told in another role, gets auth_failed."""
    token = enter(t)[1]["token"]
    last = "0" if token[-1] != "0" else "1"
    for wrong in (token[:-1] + last, token + last, "x"):
        refused_entry(t, "auth_failed", role="player", token=wrong)
    enter(t, "viewer")
    refused_entry(t, "auth_failed", role="viewer", token=token)


@case(10, "3.10.6", needs=("give", *NEEDS))
def what_is_given_is_anothers(t: Trial) -> None:
    """A cube that is given, with what is joined to it, is the other's, and no longer the giver's."""
    (one, _), (two, welcome) = enter(t), enter(t)
    names = [t.base(one), t.base(one, position=t.at(1.5))]
    if t.probe.claims("joint.fixed"):
        t.join_cubes(one, *names)
    else:
        del names[1:]
    reply = t.ask(one, {"type": "give", "cube_name": names[0], "player": welcome["player"]}, "given")
    t.equal(sorted(reply["cubes"]), sorted(names), "what was given")
    for name in names:
        t.refused(one, {"type": "despawn_cube", "cube_name": name}, "not_allowed")
        t.equal(t.info(two, name)["player"], welcome["player"], "the player whose it is")
        t.ask(two, {"type": "despawn_cube", "cube_name": name}, "cube_despawned")


@case(11, "4.error.player_not_found", needs=("give", *NEEDS))
def nobody_to_give_to(t: Trial) -> None:
    """A cube is not given to a player who has never come: player_not_found, with field player."""
    wire, _ = enter(t)
    name = t.base(wire)
    t.refused(wire, {"type": "give", "cube_name": name, "player": 9007199254740991}, "player_not_found", "player")
    t.ask(wire, {"type": "despawn_cube", "cube_name": name}, "cube_despawned")


@case(12, "3.10.1", needs=NEEDS)
def who_rules_the_world_may_do_everything(t: Trial) -> None:
    """Who enters with the host's password and names no role may do to others' things what he likes."""
    name = t.base(enter(t)[0])
    t.ask(t.join(), {"type": "despawn_cube", "cube_name": name}, "cube_despawned")
