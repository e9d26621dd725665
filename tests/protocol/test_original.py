"""What the words of the original server do here: bytes into a raw session, its requests into a world."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nmes.protocol import DELIMITER, REDACTED, Session, encode, original, parse
from nmes.world import World

Message = dict[str, Any]


class RawClient:
    """A client of a world that has logged in with the bare password."""

    def __init__(self, **config: Any) -> None:
        self.world = World({"backend": "mujoco", "mode": "lockstep", "gravity": [0, 0, 0], **config})
        self.number = self.world.join()
        self.session = Session()
        self.session.receive(b"open sesame" + DELIMITER)
        self.session.accept({})
        self.recorded: list[Message] = []

    def send(self, kind: str, **fields: Any) -> bytes:
        """Returns what the server answers, delimiter included; nothing where it is silent."""
        (frame,) = self.session.receive(json.dumps({"type": kind, **fields}).encode() + DELIMITER)
        assert isinstance(frame, bytes)
        request = self.session.parse(frame)
        self.recorded.append(json.loads(request.raw))
        return self.session.reply(request, self.world.handle(self.number, request))

    def ask(self, kind: str, **fields: Any) -> Message:
        """Returns the one answer."""
        answer, rest = self.send(kind, **fields).split(DELIMITER)
        assert rest == b""
        message = json.loads(answer)
        assert isinstance(message, dict)
        return message

    def spawn(self, name: str, *position: float, **fields: Any) -> None:
        assert self.send("spawn_cube", cube_name=name, position=position, **fields) == b""

    def velocity(self, name: str) -> list[float]:
        velocity: list[float] = self.ask("get_cube_state", cube_name=name)["linear_velocity"]
        return velocity


@pytest.fixture
def raw() -> Iterator[RawClient]:
    client = RawClient()
    yield client
    client.world.close()


# -- forces -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "field"),
    [("apply_force", "force"), ("apply_physics", "impulse"), ("apply_physics", "central_impulse")],
)
def test_a_force_of_the_original_changes_the_velocity_at_once_by_force_by_mass(
    raw: RawClient, kind: str, field: str
) -> None:
    raw.spawn("heavy", 0, 10, 0, mass=4.0)
    raw.spawn("mine", 5, 10, 0)
    assert raw.send(kind, **{field: [0, 2, 0]}) == b""
    assert raw.send(kind, cube_name="heavy", **{field: [2, 0, 0]}) == b""
    raw.world.tick()
    assert raw.velocity("mine") == pytest.approx([0, 2, 0], abs=1e-9)
    assert raw.velocity("heavy") == pytest.approx([0.5, 0, 0], abs=1e-9)
    raw.world.tick()
    assert raw.velocity("mine") == pytest.approx([0, 2, 0], abs=1e-9)


def test_a_force_in_a_batch_of_the_original_means_the_same(raw: RawClient) -> None:
    raw.spawn("mine", 5, 10, 0)
    assert raw.ask("batch", commands=[{"type": "apply_force", "force": [3, 0, 0]}])["results"][0]["type"] != "error"
    raw.world.tick()
    assert raw.velocity("mine") == pytest.approx([3, 0, 0], abs=1e-9)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text('{}[]\\"<a'),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text('{}\\"a', max_size=3), inner, max_size=3),
    max_leaves=6,
)


@given(st.lists(st.tuples(st.booleans(), JSON), min_size=1, max_size=5), JSON)
def test_of_a_batch_what_the_original_told_alike_is_told_as_it_is(results: list[tuple[bool, Any]], number: Any) -> None:
    told = {"type": "batch_result", "results": [], "id": number}
    before, after = (
        encode({**told, "results": list(_results(results, name))}) for name in ("apply_physics", "apply_force")
    )
    commands = [{"type": "apply_force", "force": [0, 1, 0]}] * len(results)
    request = parse(json.dumps({"type": "batch", "commands": commands}).encode(), translate=original.command)
    assert original.answer(request, before) == after


def _results(results: list[tuple[bool, Any]], command: str) -> Iterator[Message]:
    for refused, value in results:
        error = {"type": "error", "code": "invalid", "message": "no", "command": command}
        yield {**error, "id": value} if refused else {"type": "physics_applied", "id": value, "x": {"type": "error"}}


def test_a_force_of_the_json_dialect_acts_throughout_one_tick() -> None:
    world = World({"backend": "mujoco", "mode": "lockstep", "gravity": [0, 0, 0]})
    client = world.join()
    world.execute(client, {"type": "spawn_cube", "cube_name": "a", "position": [0, 10, 0]})
    world.execute(client, {"type": "apply_force", "force": [60, 0, 0]})
    world.tick()
    state = world.execute(client, {"type": "get_cube_state"})
    assert state["linear_velocity"] == pytest.approx([1, 0, 0], abs=1e-6)


def test_what_is_recorded_is_the_command_in_our_words(raw: RawClient) -> None:
    raw.spawn("a", 0, 10, 0)
    raw.send("apply_force", cube_name="a", force=[1, 0, 0], id=7)
    raw.send("get_cube_list")
    assert raw.recorded[-2:] == [
        {"type": "apply_physics", "cube_name": "a", "impulse": [1, 0, 0], "id": 7},
        {"type": "get_cube_list"},
    ]


# -- joints -----------------------------------------------------------------------------------------------------------


def pair(raw: RawClient) -> None:
    """Spawns `a`, which stays where it is, and `b` beside it."""
    raw.spawn("a", 0, 10, 0)
    raw.spawn("b", 1.1, 10, 0)
    raw.send("freeze_cube", cube_name="a", freeze=True)


def params(raw: RawClient, joint: str) -> Message:
    found: Message = raw.ask("get_joint_info", joint_name=joint)["params"]
    return found


@pytest.mark.parametrize("kind", ["pin", "hinge", "slider", "conetwist", "fixed"])
def test_a_joint_without_a_name_is_called_after_its_type_and_cubes(raw: RawClient, kind: str) -> None:
    pair(raw)
    answers = [raw.ask("create_joint", cube1="a", cube2="b", joint_type=kind)["joint_name"] for _ in range(3)]
    assert answers == [f"joint_{kind}_a_b", f"joint_{kind}_a_b_2", f"joint_{kind}_a_b_3"]
    assert raw.ask("get_joints_for_cube", cube_name="a") == {
        "type": "joints_for_cube",
        "cube_name": "a",
        "joints": answers,
    }
    raw.world.tick()
    assert raw.world.fault is None


def test_the_name_that_a_client_gives_is_the_joint_s_and_commands_find_it(raw: RawClient) -> None:
    pair(raw)
    mine = {"cube1": "a", "cube2": "b", "joint_type": "hinge", "joint_name": "hip"}
    assert raw.ask("create_joint", **mine)["joint_name"] == "hip"
    assert raw.ask("create_joint", **mine)["joint_name"] == "hip_2"
    for name in ("hip", "hip_2"):  # what a client says of its name is about the first, which both cubes still have
        answer = raw.ask("set_joint_param", joint_name=name, param_name="motor_target_velocity", value=1.5)
        assert answer["type"] == "joint_param_set" and answer["joint_name"] == name
    for _ in range(30):
        raw.world.tick()
    assert raw.ask("get_cube_state", cube_name="b")["rotation"][2] > 0.3


def test_names_that_would_be_too_long_are_drawn(raw: RawClient) -> None:
    one, two = "a" * 60, "b" * 60
    raw.spawn(one, 0, 10, 0)
    raw.spawn(two, 1.1, 10, 0)
    name = raw.ask("create_joint", cube1=one, cube2=two, joint_type="hinge")["joint_name"]
    assert name.startswith("joint_1_")


def test_a_name_may_be_used_again_when_its_joint_is_gone(raw: RawClient) -> None:
    pair(raw)
    mine = {"cube1": "a", "cube2": "b", "joint_type": "hinge", "joint_name": "hip"}
    raw.ask("create_joint", **mine)
    raw.send("despawn_cube", cube_name="b")
    raw.spawn("b", 1.1, 10, 0)
    assert raw.ask("create_joint", **mine)["joint_name"] == "hip"


def test_motors_given_at_creation_turn_their_hinge(raw: RawClient) -> None:
    pair(raw)
    motor = {"motor_enable": 1.0, "motor_target_velocity": 2.0, "motor_max_impulse": 100.0}
    raw.ask("create_joint", cube1="a", cube2="b", joint_type="hinge", joint_params=motor)
    for _ in range(30):
        raw.world.tick()
    assert raw.ask("get_joint_info", joint_name="joint_hinge_a_b")["velocity"] == pytest.approx(2.0, abs=0.01)
    told = params(raw, "joint_hinge_a_b")
    assert {name: told[name] for name in motor} == motor
    raw.ask("set_joint_param", joint_name="joint_hinge_a_b", param_name="motor_enable", value=0.0)
    assert params(raw, "joint_hinge_a_b")["motor_enable"] == 0.0


def test_a_motor_gives_its_largest_impulse_in_each_sixtieth_of_a_second(raw: RawClient) -> None:
    pair(raw)
    for kind in ("hinge", "slider"):
        raw.ask("create_joint", cube1="a", cube2="b", joint_type=kind)
        assert params(raw, f"joint_{kind}_a_b")["motor_max_impulse"] == 1.0
    command = {"joint_name": "joint_slider_a_b", "param_name": "motor_max_impulse", "value": 0.25}
    assert raw.ask("set_joint_param", **command) == {"type": "joint_param_set", **command}
    assert params(raw, "joint_slider_a_b")["motor_max_impulse"] == 0.25
    assert [joint["params"]["motor_max_force"] for joint in raw.world.joint_infos()] == [60.0, 15.0]  # N m and N


def test_a_motor_that_is_switched_off_at_creation_does_not_turn(raw: RawClient) -> None:
    pair(raw)
    motor = {"motor_target_velocity": 2.0, "motor_max_impulse": 100.0, "motor_enable": 0.0}
    raw.ask("create_joint", cube1="a", cube2="b", joint_type="hinge", joint_params=motor)
    raw.world.tick()
    assert raw.ask("get_joint_info", joint_name="joint_hinge_a_b")["velocity"] == 0.0


def driven(raw: RawClient, joint: str) -> float:
    """Where a joint is after its second cube was pushed and turned for a while."""
    for _ in range(120):
        raw.send("apply_physics", cube_name="b", force=[9, 0, 0], torque=[0, 0, 9])
        raw.world.tick()
    return float(raw.ask("get_joint_info", joint_name=joint)["position"])


def test_a_hinge_has_the_original_s_limits_once_they_are_switched_on(raw: RawClient) -> None:
    pair(raw)
    raw.ask("create_joint", cube1="a", cube2="b", joint_type="hinge")
    assert driven(raw, "joint_hinge_a_b") > 3.0
    pair_of_limits = params(raw, "joint_hinge_a_b")
    assert pair_of_limits["limit_lower"] == pytest.approx(-math.pi / 2)
    assert pair_of_limits["limit_upper"] == pytest.approx(math.pi / 2)
    raw.send("despawn_cube", cube_name="b")
    raw.spawn("b", 1.1, 10, 0)
    raw.ask("create_joint", cube1="a", cube2="b", joint_type="hinge", joint_params={"limit_enable": 1.0})
    assert driven(raw, "joint_hinge_a_b") == pytest.approx(math.pi / 2, abs=0.05)


def test_a_slider_has_limits_of_one_metre_unless_it_is_given_others(raw: RawClient) -> None:
    pair(raw)
    raw.ask("create_joint", cube1="a", cube2="b", joint_type="slider")
    assert driven(raw, "joint_slider_a_b") == pytest.approx(1.0, abs=0.05)
    for value in (2.0, 0.5):
        command = {"joint_name": "joint_slider_a_b", "param_name": "linear_limit_upper", "value": value}
        assert raw.ask("set_joint_param", **command) == {"type": "joint_param_set", **command}
    assert driven(raw, "joint_slider_a_b") == pytest.approx(0.5, abs=0.05)
    assert params(raw, "joint_slider_a_b")["linear_limit_upper"] == 0.5


@pytest.mark.parametrize("given", [None, 0.3])
@pytest.mark.parametrize("kind", ["create_joint", "create_bone"])
def test_cones_and_bones_swing_no_further_than_their_span(raw: RawClient, kind: str, given: float | None) -> None:
    pair(raw)
    how = {"joint_type": "conetwist"} if kind == "create_joint" else {"snake_id": 1}
    more = {} if given is None else {"joint_params": {"swing_span": given}}
    answer = raw.ask(kind, cube1="a", cube2="b", **how, **more)
    joint = answer["joint_name" if kind == "create_joint" else "bone_name"]
    assert params(raw, joint) == {
        "swing_span": pytest.approx(given or math.pi / 4),
        "twist_span": pytest.approx(math.pi),
    }
    for _ in range(180):
        raw.send("apply_physics", cube_name="b", torque=[0, 0, 5])
        raw.world.tick()
    assert raw.ask("get_cube_state", cube_name="b")["rotation"][2] == pytest.approx(given or math.pi / 4, abs=0.05)


def test_what_has_no_effect_is_kept_and_told_back_and_logged_once(raw: RawClient) -> None:
    pair(raw)
    soft = {"bias": 0.3, "limit_softness": 0.9, "limit_upper": 1.0}
    raw.ask("create_joint", cube1="a", cube2="b", joint_type="hinge", joint_params=soft)
    command = {"joint_name": "joint_hinge_a_b", "param_name": "limit_relaxation", "value": 0.5}
    assert raw.ask("set_joint_param", **command) == {"type": "joint_param_set", **command}
    told = params(raw, "joint_hinge_a_b")
    assert {**told, **soft, "limit_relaxation": 0.5} == told
    snapshot = raw.world.snapshot()
    again = World(raw.world.config)
    again.restore(snapshot)
    assert again.joint_infos() == raw.world.joint_infos()
    raw.ask("create_joint", cube1="a", cube2="b", joint_type="pin", joint_params={"damping": 0.5, "impulse_clamp": 2})
    assert params(raw, "joint_pin_a_b") == {"damping": 0.5, "impulse_clamp": 2.0}
    again.close()


def test_several_parameters_are_set_at_once_or_none(raw: RawClient) -> None:
    pair(raw)
    raw.ask("create_joint", cube1="a", cube2="b", joint_type="hinge", joint_name="hip")
    given = {"limit_enable": 1, "limit_lower": -0.2, "limit_upper": 0.4, "softness": 0.1}
    answer = raw.ask("set_joint_params", joint_name="hip", params=given)
    assert answer == {"type": "joint_param_set", "joint_name": "hip", "params": given}
    before = params(raw, "hip")
    assert {**before, **given} == before
    refused = raw.ask("set_joint_params", joint_name="hip", params={"limit_lower": 2.0, "bias": 9.0})
    assert (refused["type"], refused["code"], refused["command"]) == ("error", "invalid", "set_joint_params")
    assert params(raw, "hip") == before


def test_a_joint_with_a_bad_parameter_is_not_made(raw: RawClient) -> None:
    pair(raw)
    bad = {"cube1": "a", "cube2": "b", "joint_type": "hinge", "joint_params": {"motor_max_impulse": -1.0}}
    refused = raw.ask("create_joint", **bad)
    assert (refused["code"], refused["field"], refused["command"]) == (
        "invalid",
        "joint_params/motor_max_impulse",
        "create_joint",
    )
    assert raw.ask("get_joint_list")["joints"] == []


# -- many joints at once, colours -------------------------------------------------------------------------------------


def test_a_chain_that_is_linked_moves_as_one(raw: RawClient) -> None:
    names = [f"link_{n}" for n in range(5)]
    for n, name in enumerate(names):
        raw.spawn(name, 1.1 * n, 10, 0)
    answer = raw.send("link_cube_chains", chains=[names[:3], names[2:]], joint_type="fixed", joint_params={})
    assert answer.count(DELIMITER) == 1
    assert raw.world.joints() == [f"joint_fixed_{one}_{two}" for one, two in itertools.pairwise(names)]
    raw.send("apply_force", cube_name=names[0], force=[0, 5, 0])
    for _ in range(60):
        raw.world.tick()
    places = raw.world.poses()[1][:, :3]
    assert np.linalg.norm(np.diff(places, axis=0), axis=1) == pytest.approx(np.full(4, 1.1), abs=0.01)
    assert places[:, 1].mean() > 10.5


def test_links_have_the_original_s_defaults(raw: RawClient) -> None:
    pair(raw)
    raw.send("link_cube_chains", chains=[["a", "b"]], joint_type="slider", joint_params={"softness": 0.5})
    assert params(raw, "joint_slider_a_b")["linear_limit_upper"] == 1.0
    assert params(raw, "joint_slider_a_b")["softness"] == 0.5


def test_the_cubes_of_a_body_that_touch_or_nearly_touch_are_linked_once(raw: RawClient) -> None:
    for x in range(3):
        for y in range(2):
            raw.spawn(f"body_{x}{y}", 1.1 * x, 10 + y, 0)
    raw.spawn("body_far", 3.6, 10, 0)
    raw.spawn("other", 0, 9, 0)
    for expected in (7, 0):
        assert raw.send("link_body_cubes", prefix="body_", joint_type="fixed").count(DELIMITER) == 1
        assert len(raw.world.joints()) == 7, expected
    assert raw.ask("get_joints_for_cube", cube_name="body_00")["joints"] == [
        "joint_fixed_body_00_body_01",
        "joint_fixed_body_00_body_10",
    ]
    assert raw.ask("get_joints_for_cube", cube_name="body_far")["joints"] == []


@pytest.mark.parametrize(
    ("text", "color"),
    [("#FFFF00", (1, 1, 0, 1)), ("00ff0080", (0, 1, 0, 128 / 255)), ("#0000fF", (0, 0, 1, 1))],
)
def test_a_colour_is_set_silently(raw: RawClient, text: str, color: tuple[float, ...]) -> None:
    raw.spawn("a", 0, 10, 0)
    assert raw.send("set_color", cube_name="a", hex=text) == b""
    assert raw.ask("get_cube_info", cube_name="a")["color"] == pytest.approx(color)
    assert raw.send("set_color", cube_name="a", hex="yellow") == b""
    assert raw.ask("get_cube_info", cube_name="a")["color"] == pytest.approx(color)
    assert raw.recorded[-2]["hex"] == "yellow"


# -- planets, replays -------------------------------------------------------------------------------------------------


def test_planets_are_told_by_name(raw: RawClient) -> None:
    client = RawClient(scene={"type": "planets"})
    ours = client.world.execute(client.number, {"type": "get_planets"})["planets"]
    assert client.ask("get_planets") == {planet["Name"]: [planet] for planet in ours} != {}
    assert raw.ask("get_planets") == {}
    client.world.close()


# -- what is not understood -------------------------------------------------------------------------------------------


def test_what_does_nothing_is_logged_once_a_session(raw: RawClient) -> None:
    def said(kind: str, **fields: Any) -> list[str]:
        request = raw.session.parse(json.dumps({"type": kind, **fields}).encode())
        return raw.session.without_effect(request)

    joint = {"cube1": "a", "cube2": "b", "joint_type": "hinge", "colour": 1, "joint_params": {"bias": 0.3, "speed": 2}}
    assert said("create_joint", **joint) == [
        "create_joint: colour is not understood",
        "create_joint: joint_params/speed is not understood",
        "create_joint: bias is kept and told back, and has no effect",
    ]
    assert said("create_joint", **joint) == []
    assert said("apply_force", force=[0, 1, 0], strength=2) == ["apply_force: strength is not understood"]
    assert said("apply_force", force=[0, 1, 0]) == []
    assert sum(len(said("ping", **{f"field_{n}": n})) for n in range(1000)) < 300


def test_a_reply_of_the_raw_dialect_tells_of_no_field(raw: RawClient) -> None:
    raw.spawn("a", 0, 10, 0, colour="red")
    assert raw.ask("get_cube_list", order="name") == {"type": "cube_list", "cubes": ["a"]}


def test_a_push_that_names_nothing_that_acts_is_recorded_as_an_error(raw: RawClient) -> None:
    raw.spawn("a", 0, 10, 0)
    for kind, fields in (("apply_physics", {"forze": [0, 1, 0]}), ("apply_force", {}), ("apply_force", {"power": 3})):
        (frame,) = raw.session.receive(json.dumps({"type": kind, **fields}).encode() + DELIMITER)
        assert isinstance(frame, bytes)
        reply = json.loads(raw.world.handle(raw.number, raw.session.parse(frame)))
        assert (reply["type"], reply["code"]) == ("error", "invalid"), kind
        assert "impulse" in reply["message"]
    assert raw.send("apply_force") == b""


@pytest.mark.parametrize("password", ["pa<ss", "pässword", 'qu"ote', "tab\tbed"])
def test_a_password_in_a_frame_that_is_translated_and_refused_is_not_kept(password: str) -> None:
    session = Session()
    session.receive(password.encode() + DELIMITER)
    session.accept({})
    for ascii_only in (True, False):
        frame = json.dumps({"type": "apply_force", "force": password}, ensure_ascii=ascii_only).encode()
        request = session.redacted(session.parse(frame))
        assert request.raw == REDACTED
        assert request.error is not None and password not in request.error.message


@pytest.mark.parametrize("kind", ["spawn_cube", "despawn_cube", "freeze_cube"])
def test_silence_after_a_refused_command_does_not_hang_on_the_password(kind: str) -> None:
    answers = []
    for password in (b"cube", b"type", b"open sesame"):
        session = Session()
        session.receive(password + DELIMITER)
        session.accept({})
        request = session.redacted(session.parse(json.dumps({"type": kind, "cube_name": 7}).encode()))
        assert request.error is not None and request.command is None
        answers.append(session.reply(request, b'{"type":"error"}'))
    assert answers == [b""] * 3


@pytest.mark.parametrize(
    "said",
    [
        {"type": "create_joint", "cube1": "a", "cube2": "b", "joint_type": "hinge", "id": list(range(99_995))},
        {"type": "set_joint_param", "joint_name": "j", "param_name": "bias", "value": "DEEP"},
        {"type": "apply_force", "force": "<"},
        {"type": "create_bone", "cube1": "a", "cube2": 10**30, "joint_params": {"bias": []}},
    ],
)
def test_what_is_recorded_of_a_translated_frame_is_read_alike_by_a_replay(raw: RawClient, said: Message) -> None:
    frame = json.dumps(said).encode().replace(b'"DEEP"', b"[" * 199 + b"]" * 199)
    request = raw.session.parse(frame)
    again = parse(request.raw)
    assert (again.command, again.type, again.id) == (request.command, request.type, request.id)
    for one, other in ((request.error, again.error), (again.error, request.error)):
        assert one is None or (other is not None and (one.code, one.message) == (other.code, other.message))
