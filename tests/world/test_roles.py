"""Roles: who may do what in a world, and on whose things."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest

from creatures import snake
from layout import ROOT
from nmes import World, protocol
from nmes.errors import RejectedMessage, WorldError
from nmes.playback import replay
from nmes.playback.export import messages, write_jsonl
from nmes.playback.log import Log
from nmes.playback.log_replay import replay_log
from nmes.playback.restore import world_at
from nmes.recording import Recorder, Recording
from nmes.world.commands import COMMANDS, RIGHTS
from recordings import Edit, Line, divergence

Reply = dict[str, Any]

ROLES: dict[str, Any] = {
    "player": {},
    "viewer": {},
    "referee": {},
    "hermit": {"own": ["look", "build", "act", "give"]},  # to whom others do not exist
    "driver": {"own": ["spawn_creature", "drive"], "all": ["look"]},
}


class Play:
    """A world with roles, and those who play in it, by name."""

    def __init__(self, backend: str = "mujoco", **config: Any) -> None:
        self.world = World({"mode": "lockstep", "backend": backend, "roles": ROLES, **config})
        self.clients = {"owner": self.world.join()}

    def join(self, name: str, role: str = "player", player: int | None = None) -> int:
        """Lets somebody in; returns the number of the player."""
        self.clients[name] = self.world.join(role, player)
        return int(self.world.welcome(self.clients[name])["player"])

    def __call__(self, who: str, type: str, **fields: Any) -> Reply:
        reply = self.world.execute(self.clients[who], {"type": type, **fields})
        protocol.validate_reply(reply)
        return reply

    def ok(self, who: str, type: str, **fields: Any) -> Reply:
        reply = self(who, type, **fields)
        assert reply["type"] != "error", reply
        return reply

    def refused(self, who: str, type: str, **fields: Any) -> str:
        """The command is refused as one that is not allowed, and changes nothing; returns the message."""
        before = state(self.world)
        reply = self(who, type, **fields)
        assert (reply["type"], reply.get("code"), reply.get("command")) == ("error", "not_allowed", type), reply
        assert state(self.world) == before
        return str(reply["message"])


def state(world: World) -> tuple[Any, ...]:
    """Returns all of a world that a command may change, its snapshots left out: these are events."""
    entities = world.entities
    ownership = [(cube.player, cube.color) for cube in entities.cubes.values()]
    return world.digest(), entities.assembly(), ownership, world.mode, world.paused, world.ticks, world.creatures()


def furnished() -> Play:
    """A world in which each of two hermits has two cubes with a hinge between them, one alone, and a creature."""
    nobody = {"population": {"start": 0}, "food": {"start": 0, "rate": 0}, "cost": "0"}
    play = Play(channels={"talk": {}}, life=nobody)
    play.join("mine", "hermit")
    play.join("theirs", "hermit")
    for place, who in enumerate(("mine", "theirs")):
        for number, name in enumerate(("a", "b", "c")):
            play.ok(who, "spawn_cube", cube_name=f"{who}-{name}", position=[20.0 * place + 1.2 * number, 3, 0])
        ends = {"cube1": f"{who}-a", "cube2": f"{who}-b"}
        play.ok(who, "create_joint", joint_name=f"{who}-j", joint_type="hinge", **ends)
        play.ok(
            who,
            "spawn_creature",
            genome={**snake(), "later": ["c3"]},
            name=f"{who}-pet",
            position=[20.0 * place, 0.5, 8],
        )
        play.ok(who, "set_objective", expression="displacement.x", cubes=[f"{who}-a"], name="mine")
    play.ok("owner", "spawn_cube", cube_name="nobody")
    play.world.entities.cubes["nobody"].player = None
    return play


def about(who: str) -> dict[str, list[Reply]]:
    """Returns commands about what is somebody's, by type; those about the world as a whole are `WHOLE`."""
    a, b, c, pet = f"{who}-a", f"{who}-b", f"{who}-c", f"{who}-pet"
    joint = {"joint_name": f"{who}-j"}
    return {
        "despawn_cube": [{"cube_name": c}, {"cube_name": a}],
        "create_joint": [{"joint_type": "hinge", "cube1": a, "cube2": c}],
        "create_bone": [{"cube1": b, "cube2": c}],
        "remove_joint": [joint],
        "link_body_cubes": [{"prefix": who}],
        "link_cube_chains": [{"chains": [[a, c]]}],
        "apply_physics": [{"cube_name": a, "force": [1, 0, 0]}],
        "apply_force": [{"cube_name": a, "force": [1, 0, 0]}],
        "set_color": [{"cube_name": a, "color": [1, 0, 0]}],
        "set_cube_state": [{"cube_name": c, "position": [0, 9, 0]}, {"cube_name": a, "linear_velocity": [1, 0, 0]}],
        "freeze_cube": [{"cube_name": a, "freeze": True}],
        "set_joint_param": [{**joint, "param_name": "damping", "value": 1}],
        "set_joint_params": [{**joint, "params": {"damping": 2}, "notes": {"x": 1}}],
        "drive": [{"creature": pet, "controls": [0.5] * 3}],
        "give": [{"cube_name": a, "player": 1}, {"creature": pet, "player": 1}],
        "grow": [{"creature": pet, "part": "c3"}],
        "adopt": [{"creature": pet, "part": "c3", "cube_name": c}],
        "get_cube_info": [{"cube_name": a}],
        "get_cube_state": [{"cube_name": a}],
        "get_camera": [{"cube_name": a, "width": 8, "height": 8}],
        "get_joint_info": [joint],
        "get_joints_for_cube": [{"cube_name": a}],
        "get_world_state": [{"cubes": [a]}],
        "sense": [{"creature": pet}],
        "shed": [{"creature": pet, "part": "c2"}],
        "get_genome": [{"creature": pet}],
        "say": [{"cube_name": a, "channel": "talk", "value": 0.5}, {"creature": pet, "channel": "talk", "value": 0.5}],
        "hear": [{"cube_name": a, "channel": "talk"}, {"creature": pet, "channel": "talk"}],
        "set_objective": [
            {"expression": "displacement.x", "cubes": [a], "name": "new"},
            {"expression": "displacement.x", "creature": pet},
        ],
        "compute_reward": [{"metric": "height", "cube": a}],
    }


WHOLE: dict[str, Reply] = {
    "get_cube_list": {},
    "get_joint_list": {},
    "get_world_state": {},
    "get_life": {},
    "subscribe": {"events": ["state"]},
    "step": {},
    "pause": {},
    "resume": {},
    "set_mode": {"mode": "fast"},
    "reset": {},
}
FREE: dict[str, Reply] = {
    "ping": {},
    "unsubscribe": {},
    "get_world_info": {},
    "get_planets": {},
    "batch": {"commands": [{"type": "ping"}]},
}
ONLY_NEW: dict[str, Reply] = {
    "spawn_cube": {"position": [50, 2, 0]},
    "spawn_creature": {"genome": snake()},
    "feed": {"position": [0, 0, 0]},
}


def test_every_command_says_what_it_touches() -> None:
    assert set(RIGHTS) == set(COMMANDS) == {*about("mine"), *WHOLE, *FREE, *ONLY_NEW}
    assert {right.kind for right in RIGHTS.values()} == {"look", "build", "act", "give", "time", "reset", None}
    assert {kind for kind, right in RIGHTS.items() if right.kind is None} == set(FREE)


@pytest.mark.parametrize("kind", about("mine"))
def test_what_a_command_touches_must_belong_to_who_sends_it(kind: str) -> None:
    for own, others in zip(about("mine")[kind], about("theirs")[kind], strict=True):
        play = furnished()
        message = play.refused("mine", kind, **others)
        assert message.startswith(f"the role 'hermit' may {kind} only what is its own, and the cube 'theirs-")
        assert message.endswith("belongs to player 3")
        allowed = (None, "unsupported") if kind == "get_camera" else (None,)  # where no OpenGL works
        assert play("mine", kind, **own).get("code") in allowed
        assert play("owner", kind, **others).get("code") in allowed


@pytest.mark.parametrize("kind", WHOLE)
def test_what_is_about_the_world_as_a_whole_is_nobodys_own(kind: str) -> None:
    play = furnished()
    message = play.refused("mine", kind, **WHOLE[kind])
    assert "about all that is in the world" in message or message.endswith(f"may not {kind}")
    play.ok("owner", kind, **WHOLE[kind])


@pytest.mark.parametrize("kind", [*FREE, *ONLY_NEW])
def test_some_commands_touch_nothing_that_is_anybodys(kind: str) -> None:
    play = furnished()
    play.ok("mine", kind, **{**FREE, **ONLY_NEW}[kind])
    play.join("nosy", "viewer")
    if kind in ONLY_NEW:
        assert play.refused("nosy", kind, **ONLY_NEW[kind]) == f"the role 'viewer' may not {kind}"
    else:
        play.ok("nosy", kind, **FREE[kind])


def test_a_command_that_names_several_things_needs_all_of_them() -> None:
    play = furnished()
    mixed: dict[str, Reply] = {
        "create_joint": {"joint_type": "hinge", "cube1": "mine-a", "cube2": "theirs-a"},
        "create_bone": {"cube1": "theirs-a", "cube2": "mine-a"},
        "link_cube_chains": {"chains": [["mine-a", "mine-c"], ["mine-b", "nobody"]]},
        "get_world_state": {"cubes": ["mine-a", "theirs-c"]},
        "set_objective": {"expression": 'cube("theirs-a").height', "cubes": ["mine-a"]},
    }
    for kind, fields in mixed.items():
        play.refused("mine", kind, **fields)
    assert "belongs to nobody" in play.refused("mine", "despawn_cube", cube_name="nobody")


def test_what_hangs_on_anothers_cube_by_a_joint_that_somebody_else_made_is_not_moved_nor_cut() -> None:
    play = furnished()
    play.ok("owner", "create_joint", cube1="mine-c", cube2="theirs-c", joint_name="tie", joint_type="hinge")
    play.refused("mine", "set_cube_state", cube_name="mine-c", position=[0, 5, 0])
    play.refused("mine", "despawn_cube", cube_name="mine-c")
    play.refused("mine", "remove_joint", joint_name="tie")
    play.refused("mine", "set_joint_params", joint_name="tie", params={"damping": 1})
    play.refused("mine", "give", cube_name="mine-c", player=3)
    play.ok("mine", "apply_physics", cube_name="mine-c", force=[1, 0, 0])  # a pull at the joint is physics


def test_a_part_that_hangs_on_anothers_cube_is_cut_off_and_not_taken_away() -> None:
    play = furnished()
    play.ok("mine", "grow", creature="mine-pet", part="c3")
    play.ok("owner", "create_joint", cube1="mine-pet.c2", cube2="theirs-c", joint_name="tie", joint_type="hinge")
    play.refused("mine", "despawn_cube", cube_name="mine-pet.c2")
    for part in ("c2", "c1"):
        play.refused("mine", "shed", creature="mine-pet", part=part, remove=True)
    play.ok("mine", "shed", creature="mine-pet", part="c3", remove=True)  # it carries no joint of another
    play.ok("mine", "shed", creature="mine-pet", part="c2")
    assert "tie" in play.world.joints()


def test_senses_of_a_target_and_objectives_do_not_look_at_what_may_not_be_looked_at() -> None:
    play = furnished()
    play.ok("mine", "spawn_creature", genome=snake(), name="spy", position=[0, 0.5, 16], target="theirs-a")
    play.refused("mine", "sense", creature="spy")
    play.ok("mine", "compute_reward", objective="mine")
    play.ok("mine", "give", cube_name="mine-a", player=3)
    play.refused("mine", "compute_reward", objective="mine")
    assert "cubes" not in play.ok("mine", "spawn_cube")  # the list of all cubes
    assert len(play.ok("owner", "spawn_cube")["cubes"]) == len(play.world.cubes())


def test_bones_of_others_are_not_told_to_who_may_not_look_at_them() -> None:
    play = furnished()
    play.ok("theirs", "create_bone", cube1="theirs-b", cube2="theirs-c", joint_name="bone", snake_id="s")
    skeletons = {who: play.ok(who, "get_world_info")["skeletons"] for who in play.clients}
    assert skeletons == {who: [] if who == "mine" else [{"snake_id": "s", "bones": ["bone"]}] for who in play.clients}


MAY = {  # shipped and own roles: what of others, and of the world, they may do
    "owner": {"look", "build", "act", "give", "time", "reset"},
    "player": {"look"},
    "viewer": {"look"},
    "referee": {"look", "time", "reset"},
    "driver": {"look"},
}


@pytest.mark.parametrize("role", MAY)
def test_what_the_shipped_roles_may_do_to_others_things(role: str) -> None:
    samples: dict[str, tuple[str, Reply]] = {
        "look": ("get_cube_list", {}),
        "build": ("despawn_cube", {"cube_name": "theirs-c"}),
        "act": ("apply_physics", {"cube_name": "theirs-a", "force": [0, 1, 0]}),
        "give": ("give", {"cube_name": "theirs-a", "player": 1}),
        "time": ("step", {}),
        "reset": ("reset", {}),
    }
    for kind, (command, fields) in samples.items():
        play = furnished()
        play.join("one", role)
        if kind in MAY[role]:
            play.ok("one", command, **fields)
        else:
            play.refused("one", command, **fields)


def test_a_role_may_name_single_commands() -> None:
    play = Play()
    play.join("driver", "driver")
    play.ok("driver", "spawn_creature", genome=snake(), name="pet")
    play.ok("driver", "drive", creature="pet", controls=[0.1, 0.2, 0.3])
    play.ok("driver", "get_cube_info", cube_name=play.world.cubes()[0])
    assert play.refused("driver", "spawn_cube") == "the role 'driver' may not spawn_cube"
    play.refused("driver", "apply_physics", cube_name=play.world.cubes()[0], force=[1, 0, 0])


def test_parts_of_a_batch_are_judged_one_by_one() -> None:
    play = furnished()
    parts = [
        {"type": "apply_physics", "cube_name": "mine-a", "force": [1, 0, 0]},
        {"type": "despawn_cube", "cube_name": "theirs-a"},
        {"type": "spawn_cube", "cube_name": "late"},
        {"type": "step"},
    ]
    results = play.ok("mine", "batch", commands=parts)["results"]
    assert [result.get("code") for result in results] == [None, "not_allowed", None, "not_allowed"]
    assert {"theirs-a", "late"} <= set(play.world.cubes()) and play.world.frame == 0


# -- ownership -------------------------------------------------------------------------------------------------------


def test_what_is_given_is_anothers_with_all_that_hangs_on_it() -> None:
    play = furnished()
    assert play.ok("mine", "give", cube_name="mine-b", player=3) == {
        "type": "given",
        "player": 3,
        "cubes": ["mine-b", "mine-a"],
    }
    play.refused("mine", "remove_joint", joint_name="mine-j")
    play.refused("mine", "get_cube_info", cube_name="mine-a")
    assert play.ok("theirs", "get_cube_info", cube_name="mine-a")["player"] == 3
    play.ok("theirs", "remove_joint", joint_name="mine-j")
    pet = play.ok("mine", "give", creature="mine-pet", player=3)["cubes"]
    assert pet == list(play.world.creature("mine-pet").cubes.values())
    play.refused("mine", "drive", creature="mine-pet", controls=[0] * 3)
    play.ok("theirs", "drive", creature="mine-pet", controls=[0] * 3)


def test_a_gift_must_be_one_thing_that_is_there_and_its_player_have_come() -> None:
    play = furnished()
    gifts: list[tuple[Reply, str, str]] = [
        ({"player": 2}, "invalid", "cube_name"),
        ({"player": 2, "cube_name": "mine-a", "creature": "mine-pet"}, "invalid", "cube_name"),
        ({"player": 2, "cube_name": "gone"}, "cube_not_found", "cube_name"),
        ({"player": 2, "creature": "gone"}, "creature_not_found", "creature"),
        ({"player": 4, "cube_name": "mine-a"}, "player_not_found", "player"),
        ({"player": 0, "cube_name": "mine-a"}, "invalid", "player"),
    ]
    for fields, code, field in gifts:
        reply = play("mine", "give", **fields)
        assert (reply.get("code"), reply.get("field")) == (code, field), reply
    assert play.ok("mine", "get_cube_info", cube_name="mine-a")["player"] == 2


def test_things_stay_the_players_who_leaves_and_comes_back() -> None:
    play = furnished()
    play.world.leave(play.clients["mine"])
    play.refused("theirs", "despawn_cube", cube_name="mine-c")
    assert play.join("mine", "hermit", player=2) == 2
    play.ok("mine", "despawn_cube", cube_name="mine-c")
    assert play.join("again", "hermit", player=2) == 2  # and from two connections at once
    play.ok("again", "remove_joint", joint_name="mine-j")
    assert play.join("new", "hermit") == 4


def test_a_reset_takes_things_and_leaves_players() -> None:
    play = furnished()
    play.ok("owner", "reset")
    play.ok("mine", "spawn_cube", cube_name="mine-a")
    assert play.ok("mine", "get_cube_info", cube_name="mine-a")["player"] == 2
    play.refused("theirs", "get_cube_info", cube_name="mine-a")
    assert play.join("new") == 4


def test_driving_within_this_process_is_judged_too() -> None:
    play = furnished()
    with pytest.raises(WorldError, match="belongs to player 3") as error:
        play.world.drive(play.clients["mine"], "theirs-pet", np.zeros(3))
    assert error.value.code == "not_allowed"
    play.world.drive(play.clients["theirs"], "theirs-pet", np.full(3, 0.5))


def test_only_who_is_allowed_lifts_a_fault() -> None:
    play = furnished()
    play.world._stop("engine_failed", "for the test")
    assert play("mine", "reset")["code"] == "not_allowed"
    play.ok("owner", "reset")


def test_a_world_without_roles_knows_no_owners() -> None:
    world = World({"backend": "ballistic", "mode": "lockstep"})
    one, two = world.join(), world.join()
    assert {"role", "player"}.isdisjoint(world.welcome(one))
    world.execute(one, {"type": "spawn_cube", "cube_name": "a"})
    assert "player" not in world.execute(two, {"type": "get_cube_info", "cube_name": "a"})
    reply = world.execute(one, {"type": "give", "cube_name": "a", "player": 1})
    assert (reply["code"], "no roles" in reply["message"]) == ("unsupported", True)
    told = world.execute(one, {"type": "get_world_info"})["capabilities"]
    assert {"give", "roles"}.isdisjoint(told)
    assert {"give", "roles"} <= set(Play("ballistic").ok("owner", "get_world_info")["capabilities"])
    with pytest.raises(WorldError, match="there is no role 'player' in this world, which has none"):
        world.join("player")
    with pytest.raises(WorldError, match="no player 1"):
        world.join(player=1)
    assert world.join() == 3


def test_who_joins_must_have_a_role_and_a_number_that_there_are() -> None:
    play = Play("ballistic")
    for role, player, code in [
        ("king", None, "role_not_found"),
        ("player", 3, "player_not_found"),
        ("player", 0, "player_not_found"),
    ]:
        with pytest.raises(WorldError) as error:
            play.world.join(role, player)
        assert error.value.code == code
    assert play.world.clients() == [1] and play.join("first") == 2
    assert play.world.welcome(play.clients["owner"])["role"] == "owner"


@pytest.mark.parametrize(
    ("roles", "path"),
    [
        ({}, "roles"),
        ({"Player": {}}, "roles"),
        ({"king": {}}, "roles/king"),
        ({"king": {"own": ["look", "fly"]}}, "roles/king/own/1"),
        ({"king": {"own": ["step"]}}, "roles/king/own/0"),
        ({"king": {"own": ["time"]}}, "roles/king/own/0"),
        ({"king": {"own": ["get_cube_list"]}}, "roles/king/own/0"),
        ({"king": {"all": ["reset", "resett"]}}, "roles/king/all/1"),
        ({"king": {"all": "look"}}, "roles/king/all"),
        ({"king": {"some": []}}, "roles/king/some"),
        ({"owner": {"all": ["look"]}}, "roles/owner"),
        ({f"r{number}": {"all": ["look"]} for number in range(17)}, "roles"),
    ],
)
def test_roles_that_mean_nothing_are_refused(roles: Any, path: str) -> None:
    with pytest.raises(RejectedMessage) as error:
        World({"backend": "ballistic", "roles": roles})
    assert (error.value.code, error.value.path) == ("invalid", path), error.value
    assert error.value.message.endswith("did you mean reset?") == ("resett" in str(roles))


# -- histories -------------------------------------------------------------------------------------------------------


def history(play: Play) -> None:
    """Two players who try each other's things, one who comes back, a gift, a viewer."""
    for name in ("one", "two"):
        play.join(name)
        play.ok(name, "spawn_cube", cube_name=name, position=[3 * len(play.clients), 2, 0], list=False)
    play.join("viewer", "viewer")
    play("one", "despawn_cube", cube_name="two")
    play("viewer", "step")
    play.ok("owner", "step", ticks=70)
    play.ok("one", "give", cube_name="one", player=3)
    play.world.leave(play.clients["two"])
    play.ok("owner", "step", ticks=70)
    play.join("two", player=3)
    play("one", "apply_physics", cube_name="one", force=[9, 0, 0])
    play("two", "apply_physics", cube_name="one", force=[9, 0, 0])
    play.ok("owner", "step", ticks=5)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("roles") / "roles.mcap"
    play = Play("ballistic", keyframes=1)
    world = World({**play.world.config})
    play.world, play.clients = world, {}
    recorder = world.journal = Recorder(path, world)
    play.clients["owner"] = world.join()
    history(play)
    recorder.close()
    return path


def test_a_history_with_roles_replays_alike_from_the_beginning_and_from_keyframes(
    recording: Path, tmp_path: Path
) -> None:
    assert replay(recording).verdict == "reproduced"
    assert replay(recording, first=100).verdict == "reproduced"
    world = world_at(Recording(recording), 130)
    one = next(client for client in world.clients() if world.welcome(client)["player"] == 2)
    assert world.execute(one, {"type": "despawn_cube", "cube_name": "one"})["code"] == "not_allowed"
    table = tmp_path / "roles.jsonl"
    with table.open("w") as file:
        write_jsonl(messages(Recording(recording)), file)
    assert replay_log(Log(table)).verdict == "reproduced"


def joined_as(change: Mapping[str, Any]) -> Edit:
    """Returns an edit by which the first player joined as something else."""

    def edit(lines: list[Line]) -> list[Line]:
        return [line._replace(data=changed(line.data)) if line.topic == "clients" else line for line in lines]

    def changed(data: bytes) -> bytes:
        about = orjson.loads(data)
        return orjson.dumps({**about, **change}) if about.get("player") == 2 else data

    return edit


@pytest.mark.parametrize("change", [{"role": "viewer"}, {"role": "king"}, {"player": 9}, {"player": 1}])
def test_a_recording_in_which_a_role_was_edited_diverges(
    recording: Path, tmp_path: Path, change: Mapping[str, Any]
) -> None:
    divergence(recording, tmp_path, joined_as(change))


def test_a_snapshot_holds_who_plays_and_whose_things_are() -> None:
    play = Play("ballistic")
    history(play)
    copy = World(play.world.config)
    copy.restore(play.world.snapshot())
    assert copy.snapshot() == play.world.snapshot()
    for world in (play.world, copy):
        assert world.execute(play.clients["one"], {"type": "despawn_cube", "cube_name": "one"})["code"] == "not_allowed"
        assert world.execute(play.clients["two"], {"type": "get_cube_info", "cube_name": "one"})["player"] == 3
        assert world.welcome(world.join("player"))["player"] == 5


FORGERIES: list[Callable[[Reply], Any]] = [
    lambda roles: roles["clients"][0].update(role="king"),
    lambda roles: roles["clients"][0].update(player=9),
    lambda roles: roles["clients"].pop(),
    lambda roles: roles["cubes"].append(1),
    lambda roles: roles["cubes"].pop(),
    lambda roles: roles["cubes"].__setitem__(0, 9),
    lambda roles: roles["cubes"].__setitem__(0, 0),
    lambda roles: roles.update(players=1),
    lambda roles: roles.clear(),
]


@pytest.mark.parametrize("number", range(len(FORGERIES)))
def test_a_forged_snapshot_of_a_world_with_roles_is_refused(number: int) -> None:
    play = Play("ballistic")
    history(play)
    line, _, engine = play.world.snapshot().partition(b"\n")
    snapshot = orjson.loads(line)
    FORGERIES[number](snapshot["roles"])
    with pytest.raises(WorldError) as error:
        play.world.restore(orjson.dumps(snapshot) + b"\n" + engine)
    assert error.value.code == "bad_snapshot"


def test_roles_are_neither_left_out_of_a_snapshot_nor_put_into_one() -> None:
    for roles in (ROLES, None):
        config = {"backend": "ballistic", "mode": "lockstep", **({} if roles is None else {"roles": roles})}
        world = World(config)
        world.join()
        line, _, engine = world.snapshot().partition(b"\n")
        snapshot = orjson.loads(line)
        if roles is None:
            snapshot["roles"] = {"players": 0, "clients": [], "cubes": []}
        else:
            del snapshot["roles"]
        with pytest.raises(WorldError) as error:
            world.restore(orjson.dumps(snapshot) + b"\n" + engine)
        assert error.value.code == "bad_snapshot"


# -- the page --------------------------------------------------------------------------------------------------------


def test_the_page_says_of_every_command_which_kind_it_is() -> None:
    page = (ROOT / "docs" / "hosting.md").read_text().split("## Roles\n")[1].split("\n## ")[0]
    told: dict[str | None, set[str]] = {}
    kind = ""
    for first, commands in re.findall(r"^\| (`\w+` )?\| (`\w+`.*?) \| (?:what|the|nothing)", page, flags=re.MULTILINE):
        kind = first.strip("` ") or kind
        told.setdefault(kind, set()).update(re.findall(r"`(get_\w+|[a-z]+_\w+|\w+)`", commands))
    told["look"] -= {"state", "life", "creatures"}  # what `subscribe` names
    told[None] = set(FREE)
    assert told == {
        right.kind: {name for name in RIGHTS if RIGHTS[name].kind == right.kind} for right in RIGHTS.values()
    }
