"""The world through its own door: commands in, replies, events and ticks out, over the reference engine."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from nmes import World, protocol
from nmes.backend.rotation import conjugate, euler_from_quaternion, multiply, quaternion_from_euler, rotate
from nmes.errors import BackendNotFound, RecordingError, RejectedMessage

Reply = dict[str, Any]


class Driver:
    """A world in lockstep with one client, and the events that it was sent."""

    def __init__(self, **config: Any) -> None:
        self.events: list[tuple[int, Reply]] = []
        self.world = World(
            {"mode": "lockstep", "backend": "mujoco", **config},
            emit=lambda client, event: self.events.append((client, protocol.decode(event))),
        )
        self.client = self.world.join()

    def __call__(self, type: str, **fields: Any) -> Reply:
        return self.world.execute(self.client, {"type": type, **fields})

    def ok(self, type: str, **fields: Any) -> Reply:
        reply = self(type, **fields)
        assert reply["type"] != "error", reply
        return reply

    def refused(self, code: str, type: str, **fields: Any) -> Reply:
        """The command is refused with this code and changes nothing."""
        before = (self.world.digest(), self.world.cubes(), self.world.joints(), self.world.mode, self.world.paused)
        reply = self(type, **fields)
        after = (self.world.digest(), self.world.cubes(), self.world.joints(), self.world.mode, self.world.paused)
        assert (reply["type"], reply["code"], reply["command"]) == ("error", code, type), reply
        assert before == after
        return reply

    def spawn(self, **fields: Any) -> str:
        return str(self.ok("spawn_cube", **fields)["spawned"])

    def joint(self, cube1: str, cube2: str, joint_type: str = "hinge", **fields: Any) -> str:
        reply = self.ok("create_joint", cube1=cube1, cube2=cube2, joint_type=joint_type, **fields)
        return str(reply["joint_name"])


@pytest.fixture
def drive() -> Driver:
    return Driver()


# -- replies ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("given_id", [0, "a", None, [1, {"b": None}], 1.5, True])
def test_a_reply_echoes_the_id_that_the_command_had(drive: Driver, given_id: Any) -> None:
    assert drive("ping", id=given_id) == {"type": "pong", "id": given_id}
    assert drive("despawn_cube", cube_name="none", id=given_id)["id"] == given_id
    assert drive("no_such_command", id=given_id)["id"] == given_id
    assert "id" not in drive("ping")


def test_every_reply_is_of_the_shape_that_its_schema_states(drive: Driver) -> None:
    a, b = drive.spawn(position=[0, 2, 0]), drive.spawn(position=[1.1, 2, 0])
    joint = drive.joint(a, b)
    sent: list[Reply] = [
        {"type": "get_cube_list"},
        {"type": "get_cube_info", "cube_name": a},
        {"type": "get_cube_state"},
        {"type": "get_joint_list"},
        {"type": "get_joint_info", "joint_name": joint},
        {"type": "set_joint_param", "joint_name": joint, "param_name": "damping", "value": 1},
        {"type": "apply_physics", "force": [1, 2, 3]},
        {"type": "apply_force", "force": [1, 2, 3]},
        {"type": "set_cube_state", "cube_name": a, "position": [0, 3, 0]},
        {"type": "freeze_cube", "cube_name": a, "freeze": True},
        {"type": "step", "ticks": 3},
        {"type": "get_cube_info", "cube_name": a, "sensors": True, "rays": [[0, -1, 0], [0, 1, 0]]},
        {"type": "get_world_state"},
        {"type": "get_world_state", "sensors": True},
        {"type": "get_camera", "width": 8, "height": 8},
        {"type": "get_world_info"},
        {"type": "get_planets"},
        {"type": "subscribe"},
        {"type": "unsubscribe"},
        {"type": "pause"},
        {"type": "resume"},
        {"type": "set_mode", "mode": "lockstep"},
        {"type": "batch", "commands": [{"type": "ping"}, {"type": "spawn_cube"}]},
        *(protocol.COMMANDS[kind].schema["examples"][0] for kind in ("spawn_creature", "drive", "sense")),
        {"type": "set_objective", "expression": "max.height"},
        {"type": "compute_reward"},
        {"type": "compute_reward", "metric": "speed"},
        {"type": "remove_joint", "joint_name": joint},
        {"type": "despawn_cube", "cube_name": a},
        {"type": "reset", "seed": 3},
        {"type": "ping"},
        {"type": "spawn_cube"},
    ]
    for command in sent:
        check_answer(command, drive.world.execute(drive.client, command))
    check_answer({"type": "create_bone"}, drive("create_bone", cube1="x", cube2="y"), "cube_not_found")


def check_answer(command: Reply, reply: Reply, code: str | None = None) -> None:
    """A command is answered by its own reply, as the schema says, or with this code."""
    protocol.validate_reply(reply)
    if code is None and reply.get("code") == "unsupported" and command["type"] == "get_camera":
        return  # no OpenGL works here
    expected = protocol.COMMANDS[command["type"]].reply if code is None else "error"
    assert (reply["type"], reply.get("code")) == (expected, code), (command, reply)
    for each in reply["results"] if reply["type"] == "batch_result" else ():
        assert each["type"] != "error", (command, each)


EXAMPLES = [sent for command in protocol.COMMANDS.values() for sent in command.schema["examples"]]
FIRST = {kind: command.schema["examples"][0] for kind, command in protocol.COMMANDS.items()}
NAMED = sorted({sent[field] for sent in EXAMPLES for field in ("cube", "cube1", "cube2") if field in sent})
REFUSED = {
    "spawn_cube": "cube_exists",
    "spawn_creature": "creature_exists",
    "give": "unsupported",
    "grow": "invalid",
    "adopt": "invalid",
}
"""Commands that cannot be executed where what their examples name is there, or nobody's, and the refusal's code."""


@pytest.mark.parametrize("command", EXAMPLES, ids=[sent["type"] for sent in EXAMPLES])
def test_the_examples_of_a_command_are_answered_by_its_own_reply(command: Reply) -> None:
    drive = Driver(channels={"alarm": {}}, life={})
    for number, name in enumerate(NAMED):
        drive.spawn(cube_name=name, position=[5 + 3 * number, 2, 0])
    for kind in ("spawn_cube", "spawn_creature", "set_objective"):
        check_answer(FIRST[kind], drive(**FIRST[kind]))
    if "joint_name" in command:  # a client does not choose it
        command = {**command, "joint_name": drive.joint(FIRST["spawn_cube"]["cube_name"], "torso")}
    check_answer(command, drive(**command), REFUSED.get(command["type"]))


# -- names and ownership ---------------------------------------------------------------------------------------------


def test_names_come_from_the_seed_and_are_never_used_twice() -> None:
    first, again, other = Driver(seed=7), Driver(seed=7), Driver(seed=8)
    names = [first.spawn() for _ in range(5)]
    assert names == [again.spawn() for _ in range(5)]
    assert not set(names) & {other.spawn() for _ in range(5)}
    for name in names:
        first.ok("despawn_cube", cube_name=name)
    assert first.spawn() not in names
    first.ok("reset")
    assert first.spawn() == names[0]
    first.ok("reset", seed=8)
    assert first.spawn() == Driver(seed=8).spawn()


def test_a_generated_name_avoids_names_chosen_by_clients(drive: Driver) -> None:
    first, second = drive.spawn(), drive.spawn()
    drive.ok("reset")
    assert drive.spawn(cube_name=second) == second
    assert drive.spawn() not in (first, second)


def test_a_base_is_frozen_and_says_so_in_its_name(drive: Driver) -> None:
    name = drive.spawn(cube_name="pole", is_base=True, position=[0, 4, 0])
    assert name == "pole_BASE"
    drive.ok("step", ticks=30)
    info = drive.ok("get_cube_info", cube_name="pole_BASE")
    assert info["frozen"] and info["position"] == [0, 4, 0] and info["linear_velocity"] == [0, 0, 0]
    drive.refused("cube_exists", "spawn_cube", cube_name="pole", is_base=True)
    drive.refused("invalid", "spawn_cube", cube_name="x" * 126, is_base=True)


def test_a_connection_owns_the_cube_that_it_spawned_last(drive: Driver) -> None:
    drive.refused("nothing_owned", "get_cube_state")
    first, second = drive.spawn(), drive.spawn(position=[3, 1, 0])
    assert drive.ok("get_cube_state")["cube_name"] == second
    stranger = drive.world.join()
    assert drive.world.execute(stranger, {"type": "get_cube_state"})["code"] == "nothing_owned"
    drive.world.leave(stranger)
    drive.ok("despawn_cube", cube_name=second)
    drive.refused("nothing_owned", "apply_force", force=[1, 0, 0])
    assert drive.world.cubes() == [first]


def test_cubes_are_listed_in_order_of_creation(drive: Driver) -> None:
    names = [drive.spawn(cube_name=name) for name in ("b", "c", "a")]
    assert drive.ok("get_cube_list")["cubes"] == names
    drive.ok("despawn_cube", cube_name="c")
    assert drive.ok("spawn_cube", cube_name="c")["cubes"] == ["b", "a", "c"]
    assert "cubes" not in drive.ok("spawn_cube", list=False)


def test_bones_belong_to_skeletons(drive: Driver) -> None:
    cubes = [drive.spawn(position=[1.1 * i, 3, 0]) for i in range(5)]
    bones = [
        drive.ok("create_bone", cube1=a, cube2=b, **({} if snake is None else {"snake_id": snake}))["bone_name"]
        for a, b, snake in zip(cubes, cubes[1:], ["spine", 7, "spine", None], strict=False)
    ]
    assert drive.ok("get_world_info")["skeletons"] == [
        {"snake_id": "spine", "bones": [bones[0], bones[2]]},
        {"snake_id": 7, "bones": [bones[1]]},
        {"snake_id": "skeleton", "bones": [bones[3]]},
    ]
    assert drive.ok("get_joint_info", joint_name=bones[0])["joint_type"] == "conetwist"
    drive.ok("set_joint_param", joint_name=bones[0], param_name="limit_lower", value=0.5)
    drive.ok("set_joint_param", joint_name=bones[0], param_name="limit_enabled", value=True)
    drive.refused("invalid", "set_joint_param", joint_name=bones[0], param_name="limit_upper", value=-0.5)
    drive.ok("remove_joint", joint_name=bones[1])
    assert [skeleton["snake_id"] for skeleton in drive.ok("get_world_info")["skeletons"]] == ["spine", "skeleton"]


# -- errors ----------------------------------------------------------------------------------------------------------


def test_impossible_commands_are_refused_and_change_nothing(drive: Driver) -> None:
    a, b, c = drive.spawn(cube_name="a"), drive.spawn(cube_name="b"), drive.spawn(cube_name="c")
    joint = drive.joint(a, b)
    drive.refused("cube_exists", "spawn_cube", cube_name="a")
    drive.refused("cube_not_found", "despawn_cube", cube_name="z")
    drive.refused("cube_not_found", "get_cube_info", cube_name="z")
    drive.refused("cube_not_found", "get_world_state", cubes=["a", "z"])
    drive.refused("joint_exists", "create_joint", cube1=b, cube2=a, joint_type="fixed", joint_name=joint)
    drive.refused("self_joint", "create_joint", cube1=a, cube2=a, joint_type="hinge")
    assert drive.refused("cube_not_found", "create_joint", cube1=a, cube2="z", joint_type="hinge")["field"] == "cube2"
    drive.refused("joint_not_found", "remove_joint", joint_name="z")
    drive.refused("joint_not_found", "get_joint_info", joint_name="z")
    assert (
        drive.refused("invalid", "create_joint", cube1=a, cube2=c, joint_type="hinge", axis=[0, 0, 0])["field"]
        == "axis"
    )
    drive.refused("invalid", "create_joint", cube1=a, cube2=c, joint_type="hinge", limits=[1, -1])
    drive.refused("unsupported", "create_joint", cube1=a, cube2=c, joint_type="pin", motor_target_velocity=1)
    drive.refused("invalid", "set_cube_state", cube_name=a, rotation=[0, 0, 0, 0])


def test_joint_parameters_are_checked(drive: Driver) -> None:
    joint = drive.joint(drive.spawn(), drive.spawn(position=[1.1, 1, 0]))

    def put(name: str, value: Any) -> Reply:
        return {"joint_name": joint, "param_name": name, "value": value}

    drive.refused("invalid", "set_joint_param", **put("motor_enabled", 1))
    drive.refused("invalid", "set_joint_param", **put("stiffness", True))
    drive.refused("invalid", "set_joint_param", **put("damping", -1))
    drive.refused("invalid", "set_joint_param", **put("no_such_parameter", 1))
    drive.ok("set_joint_param", **put("limit_upper", -1))
    drive.refused("invalid", "set_joint_param", **put("limit_enabled", True))
    drive.ok("set_joint_param", **put("motor_max_impulse", 0.5))
    drive.ok("set_joint_param", **put("motor_target_velocity", 2))
    params = drive.ok("get_joint_info", joint_name=joint)["params"]
    assert params["motor_enabled"] and params["motor_max_force"] == pytest.approx(0.5 * 240)
    drive.ok("set_joint_param", **put("motor_max_force", 24))
    drive.ok("set_joint_param", **put("target_position", 1))
    params = drive.ok("get_joint_info", joint_name=joint)["params"]
    assert (params["motor_max_impulse"], params["target_position"]) == (pytest.approx(0.1), 1.0)


def test_despawning_a_cube_removes_its_joints(drive: Driver) -> None:
    a, b, c = drive.spawn(), drive.spawn(position=[1.1, 1, 0]), drive.spawn(position=[2.2, 1, 0])
    first, second = drive.joint(a, b), drive.joint(b, c)
    drive.ok("step", ticks=5)
    assert drive.ok("despawn_cube", cube_name=b)["joints"] == [first, second]
    drive.ok("step", ticks=5)
    assert drive.ok("get_joint_list")["joints"] == []
    assert drive.ok("get_cube_info", cube_name=a)["joints"] == []
    drive.joint(a, c)


def test_limits_of_cubes_and_joints_hold_and_removal_makes_room() -> None:
    drive = Driver(limits={"cubes": 3, "joints": 1})
    names = [drive.spawn(position=[1.1 * i, 1, 0]) for i in range(3)]
    drive.refused("limit_reached", "spawn_cube")
    drive.joint(names[0], names[1])
    drive.refused("limit_reached", "create_joint", cube1=names[1], cube2=names[2], joint_type="hinge")
    drive.ok("despawn_cube", cube_name=names[0])
    drive.joint(names[1], names[2])
    drive.spawn()


@given(st.recursive(st.none() | st.booleans() | st.floats(allow_nan=False, allow_infinity=False) | st.text(), st.lists))
def test_an_invalid_value_of_any_field_neither_raises_nor_changes_the_world(value: Any) -> None:
    drive = Driver(backend="ballistic")
    name = drive.spawn(cube_name="a")
    before = drive.world.digest()
    for kind, command in protocol.COMMANDS.items():
        for field in command.schema.get("properties", {}):
            if field in ("type", "id") or kind in ("spawn_cube", "reset", "step", "batch"):
                continue
            reply = drive(kind, **{field: value})
            assert reply["type"] != "error" or reply["code"] != "internal"
    assert name in drive.world.cubes() and drive.world.fault is None
    if drive.world.cubes() == ["a"] and not isinstance(value, list):
        assert drive.world.digest() == before


def test_a_batch_whose_replies_are_too_long_is_cut_short() -> None:
    drive = Driver(backend="ballistic")
    drive.ok("batch", commands=[{"type": "spawn_cube"}] * 1000)
    parts = [{"type": "get_world_state", "id": n} for n in range(200)] + [{"type": "spawn_cube", "id": "x"}]
    results = drive.ok("batch", commands=parts)["results"]
    done = [result for result in results if result["type"] != "error"]
    size = len(protocol.encode(done[0]))
    assert len(done) == (8 << 20) // size + 1  # the one that goes over the limit is the last
    assert [result["id"] for result in results] == [*range(200), "x"]
    assert {result["code"] for result in results[len(done) :]} == {"limit_reached"}
    assert len(drive.world.cubes()) == 1000
    protocol.validate_reply({"type": "batch_result", "results": results})
    assert len(drive.ok("get_world_state")["cubes"]) == 1000  # alone it is answered


def test_a_batch_is_applied_in_order_and_a_failing_part_leaves_the_rest(drive: Driver) -> None:
    parts = [
        {"type": "spawn_cube", "cube_name": "a", "id": 1},
        {"type": "despawn_cube", "cube_name": "z", "id": 2},
        {"type": "spawn_cube", "cube_name": "b", "list": True},
        {"type": "step", "ticks": 2},
    ]
    results = drive.ok("batch", commands=parts, id="all")["results"]
    assert [result["type"] for result in results] == ["cube_list", "error", "cube_list", "stepped"]
    assert [result.get("id") for result in results] == [1, 2, None, None]
    assert "cubes" not in results[0] and results[2]["cubes"] == ["a", "b"]
    drive.refused("unknown_type", "batch", commands=[{"type": "spawn_cube"}, {"type": "nope"}])
    drive.refused("invalid", "batch", commands=[{"type": "step", "ticks": 5000}] * 3)
    assert drive.world.cubes() == ["a", "b"]


# -- time ------------------------------------------------------------------------------------------------------------


def test_step_is_refused_while_the_clock_ticks_the_world(drive: Driver) -> None:
    assert drive.ok("step", ticks=3) == {"type": "stepped", "frame": 3, "t": 3 / 60}
    drive.ok("set_mode", mode="realtime", rate=2)
    running = [drive.world.running]
    drive.refused("wrong_mode", "step")
    drive.ok("pause")
    running.append(drive.world.running)
    assert drive.ok("step")["frame"] == 4
    drive.ok("resume")
    running.append(drive.world.running)
    assert running == [True, False, True] and drive.world.rate == 2
    drive.world.tick()
    assert drive.world.frame == 5


def test_a_force_lasts_one_tick_and_an_impulse_acts_at_once() -> None:
    drive = Driver(gravity=[0, 0, 0])
    name = drive.spawn(mass=2, position=[0, 9, 0])
    drive.ok("apply_physics", force=[12, 0, 0])
    drive.ok("apply_physics", force=[0, 0, 24])
    drive.ok("step")
    assert drive.ok("get_cube_state")["linear_velocity"] == pytest.approx([0.1, 0, 0.2])
    drive.ok("step", ticks=9)
    assert drive.ok("get_cube_state")["linear_velocity"] == pytest.approx([0.1, 0, 0.2])
    before = drive.ok("get_cube_state")["position"]
    drive.ok("apply_physics", impulse=[0, 6, 0])
    drive.ok("step")
    state = drive.ok("get_cube_state")
    assert state["linear_velocity"][1] == pytest.approx(3) and state["position"][1] - before[1] == pytest.approx(3 / 60)
    assert name == state["cube_name"]


def test_a_force_at_a_point_turns_the_cube() -> None:
    drive = Driver(gravity=[0, 0, 0])
    drive.spawn(position=[0, 9, 0])
    drive.ok("apply_physics", impulse=[0, 1, 0], at=[0.5, 9, 0])
    drive.ok("step")
    state = drive.ok("get_cube_state")
    assert state["linear_velocity"] == pytest.approx([0, 1, 0])
    assert state["angular_velocity"] == pytest.approx([0, 0, 0.5 * 6])


def test_reset_restores_the_world_as_it_was_created(drive: Driver) -> None:
    def live() -> list[bytes]:
        a, b = drive.spawn(position=[0, 1, 0]), drive.spawn(position=[1.1, 1, 0])
        drive.joint(a, b, motor_target_velocity=3)
        drive.ok("step", ticks=20)
        return [drive.world.digest()]

    first = live()
    assert drive.ok("reset") == {"type": "world_reset", "frame": 0, "seed": 0}
    assert drive.world.cubes() == [] and drive.world.frame == 0
    drive.refused("nothing_owned", "get_cube_state")
    assert live() == first


# -- subscriptions ---------------------------------------------------------------------------------------------------


def test_events_come_only_to_subscribers_at_their_interval(drive: Driver) -> None:
    other = drive.world.join()
    drive.spawn()
    drive.ok("step", ticks=3)
    assert drive.events == []
    drive.ok("subscribe", events=["tick"], every=2)
    drive.ok("step", ticks=4)
    assert drive.events == [
        (drive.client, {"type": "tick", "t": 4 / 60, "frame": 4}),
        (drive.client, {"type": "tick", "t": 6 / 60, "frame": 6}),
    ]
    drive.ok("unsubscribe")
    drive.ok("step")
    drive.world.leave(other)
    assert len(drive.events) == 2


def test_a_state_event_holds_what_moved_past_the_thresholds(drive: Driver) -> None:
    drive = Driver(gravity=[0, 0, 0])
    still, slow, spinning = (
        drive.spawn(position=[0, 5, 0]),
        drive.spawn(position=[5, 5, 0], linear_velocity=[0.06, 0, 0]),
        drive.spawn(position=[9, 5, 0], angular_velocity=[0, 0.6, 0]),
    )
    drive.ok("subscribe", events=["state"], position_threshold=0.0025, rotation_threshold=0.015)
    drive.ok("step", ticks=4)
    moved = [[cube["cube_name"] for cube in event["cubes"]] for _, event in drive.events]
    # All at first; then 1 mm and 10 mrad a tick, sent when the sum passes 2.5 mm and 15 mrad.
    assert moved == [[still, slow, spinning], [spinning], [slow]]
    assert [event["frame"] for _, event in drive.events] == [1, 3, 4]
    drive.events.clear()
    drive.ok("despawn_cube", cube_name=still)
    late = drive.spawn(position=[-5, 5, 0])
    drive.ok("step")
    (_, event), *_ = drive.events
    assert event["removed"] == [still] and late in [cube["cube_name"] for cube in event["cubes"]]
    for _, event in drive.events:
        protocol.validate_event(event)


@example(cubes=[([0, 0, 0], '",'), ([0, 0, 0], ":")])
@given(
    st.lists(
        st.tuples(
            st.one_of(
                st.sampled_from([[math.pi / 2, 0.3, 0], [-math.pi / 2, 0, 0], [0, 0, 0], [0, math.pi, 0]]),
                st.lists(st.floats(-4, 4), min_size=3, max_size=3),
            ),
            st.text('a",<\\:{}[]é\U0001f9ca', min_size=1, max_size=5),
        ),
        min_size=1,
        max_size=4,
        unique_by=lambda cube: cube[1],
    )
)
def test_a_state_event_equals_the_world_state(cubes: list[tuple[list[float], str]]) -> None:
    drive = Driver(backend="ballistic")
    events: list[bytes] = []
    drive.world.emit = lambda client, event: events.append(event)
    for i, (rotation, name) in enumerate(cubes):
        spin = [0.1 * i, -1.0 / 3.0, 0.0]
        drive.ok("spawn_cube", cube_name=name, position=[2 * i, 9, 1e-7], rotation=rotation, angular_velocity=spin)
    drive.ok("subscribe", events=["state"])
    drive.ok("step")
    state = drive.ok("get_world_state")["cubes"]
    (event,) = events
    assert event == protocol.encode({"type": "state", "t": 1 / 60, "frame": 1, "cubes": state, "removed": []})
    drive.world.close()


def test_subscribers_are_told_when_the_world_closes(drive: Driver) -> None:
    drive.ok("subscribe", events=["tick"])
    drive.world.close()
    assert drive.events == [(drive.client, {"type": "world_closed"})]


# -- faults ----------------------------------------------------------------------------------------------------------


def test_a_diverged_engine_faults_the_world_until_reset(drive: Driver) -> None:
    name = drive.spawn(position=[0, 5, 0])
    drive.ok("subscribe", events=["tick"])
    drive.ok("step", ticks=2)
    drive.events.clear()
    drive.ok("apply_physics", force=[1e14, 0, 0])
    assert drive("step")["code"] == "world_faulted"
    assert drive.world.frame == 2 and not drive.world.running
    (_, event), *more = drive.events
    assert (event["type"], event["code"], event["frame"]) == ("world_fault", "diverged", 2) and not more
    assert name in event["message"]
    assert drive("get_cube_list")["code"] == "world_faulted"
    assert drive("spawn_cube")["code"] == "world_faulted"
    assert drive("ping")["type"] == "pong"
    assert drive("get_world_info")["fault"]["code"] == "diverged"
    drive.world.tick()
    assert drive.world.frame == 2
    drive.ok("reset")
    assert drive.spawn() == name and drive.ok("step")["frame"] == 1


class Full:
    """A journal on a disk that fills up after so many records."""

    def __init__(self, room: int) -> None:
        self.room = room

    def _keep(self, *args: Any) -> None:
        self.room -= 1
        if self.room < 0:
            raise RecordingError("recording_failed", "no space left")

    joined = left = received = replied = ticked = lived = keyframe = hibernated = faulted = _keep


@pytest.mark.parametrize("room", range(8))
def test_a_world_whose_recording_fails_stops(room: int) -> None:
    drive = Driver(backend="ballistic", keyframes=1 / 60)
    drive.ok("subscribe", events=["tick"])
    drive.world.journal = Full(room)
    replies = [drive("spawn_cube"), drive("step"), drive("get_cube_list")]
    assert drive.world.fault is not None and drive.world.fault.code == "recording_failed"
    assert replies[-1]["code"] == "world_faulted"
    assert drive("reset")["code"] == "world_faulted"
    assert [event["type"] for _, event in drive.events].count("world_fault") == 1


def test_an_invalid_config_is_refused_with_the_reason() -> None:
    with pytest.raises(BackendNotFound, match="did you mean 'mujoco'"):
        World({"backend": "mujoko"})
    with pytest.raises(RejectedMessage, match="tick_rate") as error:
        World({"tick_rate": 0})
    assert error.value.path == "tick_rate"
    with pytest.raises(RejectedMessage):
        World({"tick_raet": 60})


# -- rotations -------------------------------------------------------------------------------------------------------

angles = st.floats(-math.pi, math.pi)


@given(angles, angles, angles)
def test_euler_angles_and_quaternions_are_the_same_rotation(x: float, y: float, z: float) -> None:
    q = quaternion_from_euler(x, y, z)
    again = quaternion_from_euler(*euler_from_quaternion(q))
    assert abs(sum(a * b for a, b in zip(q, again, strict=True))) == pytest.approx(1, abs=1e-9)
    # Godot's order: the turn about Z acts first, then X, then Y.
    one = rotate(q, (0.3, -0.4, 0.5))
    by_hand = (0.3, -0.4, 0.5)
    for axis, angle in ((2, z), (0, x), (1, y)):
        turn = [0.0, 0.0, 0.0]
        turn[axis] = angle
        by_hand = rotate(quaternion_from_euler(*turn), by_hand)
    assert one == pytest.approx(by_hand, abs=1e-9)
    assert rotate(conjugate(q), one) == pytest.approx((0.3, -0.4, 0.5), abs=1e-9)
    assert multiply(q, conjugate(q)) == pytest.approx((0, 0, 0, 1), abs=1e-9)


# -- what a host is told ---------------------------------------------------------------------------------------------


def test_a_command_that_takes_long_is_known_by_its_cost_and_one_that_does_not_costs_nothing(drive: Driver) -> None:
    names = [drive.spawn(position=[2 * i, 2, 0]) for i in range(100)]
    cost = drive.world.cost
    for kind in ("ping", "apply_physics", "get_cube_state", "drive", "sense", "step", "despawn_cube", "create_joint"):
        assert cost({"type": kind}) == 0.0
    assert cost({"type": "get_world_state", "cubes": names[:10]}) * 10 == pytest.approx(
        cost({"type": "get_world_state"})
    )
    assert cost({"type": "get_world_state", "sensors": True}) > 2 * cost({"type": "get_world_state"}) > 0
    for kind in ("reset", "spawn_creature", "get_camera"):
        assert cost({"type": kind}) > 0.005
    inner = [{"type": "get_world_state"}] * 20 + [{"type": "ping"}]
    assert cost({"type": "batch", "commands": inner}) > 20 * cost(inner[0])


def test_what_an_engine_has_yet_to_take_up_is_known_until_the_next_tick_or_snapshot(drive: Driver) -> None:
    world = drive.world
    assert world.rebuild_cost == 0.0
    a, b = drive.spawn(), drive.spawn(position=[2, 2, 0])
    assert world.rebuild_cost > 0.0
    world.tick()
    assert world.rebuild_cost == 0.0
    joint = drive.joint(a, b)
    before = world.rebuild_cost
    assert before > 0.0
    world.snapshot()
    assert world.rebuild_cost == 0.0
    drive.ok("set_joint_param", joint_name=joint, param_name="motor_target_velocity", value=1.0)  # a motor comes
    assert world.rebuild_cost == before
    world.tick()
    drive.ok("set_joint_param", joint_name=joint, param_name="motor_target_velocity", value=2.0)
    assert world.rebuild_cost == 0.0
    drive.ok("set_cube_state", cube_name=a, position=[0, 5, 0])
    assert world.rebuild_cost == before
    drive.ok("reset")
    assert world.rebuild_cost == 0.0
