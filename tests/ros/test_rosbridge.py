"""The rosbridge door: programs for ROS drive a world as if it were a robot; what they do is recorded."""

from __future__ import annotations

import gc
import json
import math
import re
import shutil
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import orjson
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from nmes.backend.rotation import rotate
from nmes.cli import main
from nmes.playback import replay
from nmes.protocol import Limits
from nmes.recording import Recording
from nmes.ros import rosbridge_application
from nmes.ros.definitions import fields
from nmes.ros.graph import Views
from nmes.ros.messages import from_ros, ros_name, to_ros
from nmes.ros.services import Asked, look_up
from nmes.schemas.documents import parse_json
from nmes.server.connection import LONG
from nmes.world import World
from processes import process, ready
from recordings import send
from servers import PASSWORD, PATIENCE, Served, served

LOCKSTEP = {"name": "main", "backend": "mujoco", "mode": "lockstep"}
REALTIME = {**LOCKSTEP, "mode": "realtime"}

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "ros.md"
ROSLIB = HERE / "roslib"
NODE, NPM = shutil.which("node"), shutil.which("npm")
RUNNING = 120.0  # s

ROCKER = {
    "format": "nmes-genome/1",
    "name": "rocker",
    "body": {
        "cubes": [
            {"id": "torso", "size": 0.4, "mass": 2, "position": [0, 0.2, 0]},
            {"id": "arm", "size": [0.6, 0.1, 0.1], "mass": 0.5, "position": [0.4, 0.3, 0]},
        ],
        "joints": [
            {
                "id": "shoulder", "cube1": "torso", "cube2": "arm", "type": "hinge", "anchor": [0.15, 0.3, 0],
                "motor": {"mode": "position", "range": [-0.8, 0.8], "max_effort": 10},
            }
        ],
    },
}  # fmt: skip

OWN = [
    "/rocker/torso/pose", "/rocker/arm/pose", "/rocker/shoulder/command", "/rocker/joint_states",
    "/rocker/joint_command", "/rocker/command",
]  # fmt: skip
COMMON = ["/clock", "/tf", "/joint_states", "/joint_command"]


class Peer:
    """A client that says and hears operations."""

    def __init__(self, connection: ClientConnection) -> None:
        self.connection = connection

    def say(self, *operations: Mapping[str, Any] | str) -> None:
        for one in operations:
            self.connection.send(one if isinstance(one, str) else json.dumps(one))

    def hear(self, patience: float = PATIENCE) -> Any:
        return json.loads(self.connection.recv(patience))

    def until(self, **fields: Any) -> Any:
        """Returns the next message that has these fields."""
        while True:
            message = self.hear()
            if all(message.get(name) == value for name, value in fields.items()):
                return message

    def call(self, service: str, **args: Any) -> Any:
        self.say({"op": "call_service", "service": service, "args": args, "id": "c"})
        return self.until(op="service_response", id="c")

    def command(self, **command: Any) -> Any:
        return json.loads(self.call("/command", command=json.dumps(command))["values"]["reply"])

    def error(self, operation: Mapping[str, Any] | str) -> str:
        """Says what is refused; returns why."""
        self.say(operation)
        return str(self.until(op="status", level="error")["msg"])

    def silent(self) -> bool:
        """Whether nothing is said that was not asked for: the answer to a call comes next."""
        self.say({"op": "call_service", "service": "/rosapi/nodes", "id": "silent"})
        return bool(self.hear().get("id") == "silent")


@contextmanager
def peer(port: int, address: str = f"/?password={quote(PASSWORD)}", **options: Any) -> Iterator[Peer]:
    url = f"ws://127.0.0.1:{port}{address}"
    with connect(url, open_timeout=PATIENCE, close_timeout=1, max_size=None, **options) as connection:
        yield Peer(connection)


def door(server: Served, password: str | None = None) -> int:
    application = rosbridge_application(server.host, ["127.0.0.1"], [], password)
    return int(server.run(server.host.serve_http("127.0.0.1", 0, application))[1])


@pytest.fixture
def server() -> Iterator[Served]:
    with served(LOCKSTEP) as running:
        yield running


@pytest.fixture
def robot(server: Served) -> Iterator[Peer]:
    """A client of a world in lockstep in which a rocker is."""
    with peer(door(server)) as client:
        spawn(client)
        yield client


def spawn(client: Peer, **position: float) -> None:
    answer = client.call(
        "/spawn", model_name="rocker", model_xml=json.dumps(ROCKER), initial_pose={"position": position}
    )
    assert answer["values"] == {"success": True, "status_message": "spawned rocker"}


# -- unmodified clients --------------------------------------------------------------------------------------------


def test_a_controller_with_roslibpy_drives_a_creature_and_all_of_it_replays(tmp_path: Path) -> None:
    with process("serve", "--port", "0", "--rosbridge", "0", "--json", "--record", str(tmp_path)) as running:
        told = ready(running)
        controller = subprocess.run(
            [sys.executable, str(HERE / "controller.py"), str(told["rosbridge_port"]), json.dumps(ROCKER)],
            capture_output=True, text=True, timeout=RUNNING, check=False,
        )  # fmt: skip
        assert controller.returncode == 0, controller.stderr
        running.terminate()
        assert running.wait(PATIENCE) == 0
    seen = json.loads(controller.stdout)
    assert seen["spawned"] == {"success": True, "status_message": "spawned rocker"}
    assert seen["topics"] == COMMON + OWN and seen["after"] == COMMON
    assert seen["types"] == ["tf2_msgs/TFMessage", "geometry_msgs/PoseStamped"]
    assert seen["nodes"] == ["/nmes"] and seen["time"] >= 1 and seen["simulated"] is True
    assert seen["parameters"] == ["/use_sim_time"] and seen["node"] == ["/clock", "/tf"]
    assert seen["fields"] == ["header", "name", "position", "velocity", "effort"]
    assert seen["takes"][:2] == ["model_name", "model_xml"] and seen["answers"] == ["success", "status_message"]
    assert seen["of_type"] == ["/joint_states", "/joint_command", "/rocker/joint_states", "/rocker/joint_command"]
    assert seen["service"] == ["std_srvs/Empty", ["/spawn"]]
    assert max(seen["positions"]) > 0.3 and min(seen["positions"]) < -0.2  # it follows the wave
    recording = Path(told["recording"])
    assert replay(recording).verdict == "reproduced"
    commands = [record.data for record in Recording(recording) if b'"set_joint_params"' in record.data]
    assert len(commands) >= 90


def test_a_controller_with_roslib_drives_a_creature(tmp_path: Path) -> None:
    if NODE is None or NPM is None:
        pytest.skip("Node or npm is not installed: roslib was not run")
    folder = tmp_path / "roslib"
    shutil.copytree(ROSLIB, folder, ignore=shutil.ignore_patterns("node_modules"))
    if (ROSLIB / "node_modules").is_dir():
        (folder / "node_modules").symlink_to(ROSLIB / "node_modules")
    else:
        installing = [NPM, "ci", "--ignore-scripts"]
        installed = subprocess.run(installing, cwd=folder, timeout=RUNNING, capture_output=True, text=True, check=False)
        if installed.returncode:
            pytest.skip(f"npm cannot install roslib: it was not run: {installed.stderr}")
    with served(REALTIME) as server:
        url = f"ws://127.0.0.1:{door(server)}/?password={quote(PASSWORD)}"
        controller = subprocess.run(
            [NODE, "controller.mjs", url, json.dumps(ROCKER)],
            cwd=folder, capture_output=True, text=True, timeout=RUNNING, check=False,
        )  # fmt: skip
    assert controller.returncode == 0, controller.stderr
    seen = json.loads(controller.stdout)
    assert seen["spawned"]["success"] and seen["topics"]["topics"] == COMMON + OWN
    assert seen["raw"] == seen["topics"]["topics"] and seen["publishers"] == ["/nmes"] and seen["actions"] == []
    point = {"x": "float64", "y": "float64", "z": "float64"}
    assert seen["decoded"]["pose"] == {"position": point, "orientation": {**point, "w": "float64"}}
    assert seen["states"]["name"] == ["shoulder"] and seen["states"]["position"][0] == pytest.approx(0.4, abs=0.05)
    assert seen["pose"]["position"]["x"] == pytest.approx(1, abs=0.1)
    assert seen["pose"]["position"]["y"] == pytest.approx(2, abs=0.1)


def test_the_program_of_the_page_moves_a_robot(tmp_path: Path) -> None:
    (program,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), flags=re.DOTALL | re.MULTILINE)
    (copied,) = re.findall(r"^\$ nmes (genome copy .*)$", PAGE.read_text(), flags=re.MULTILINE)
    assert CliRunner().invoke(main, [*copied.split()[:-1], str(tmp_path / copied.split()[-1])]).exit_code == 0
    with process("serve", "--port", "0", "--rosbridge", "0", "--json", "--record", str(tmp_path)) as running:
        told = ready(running)
        program = program.replace("9090", str(told["rosbridge_port"])).replace("time.sleep(5)", "time.sleep(2)")
        ran = subprocess.run(
            [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=RUNNING, check=False
        )
        running.terminate()
        assert running.wait(PATIENCE) == 0
    assert ran.returncode == 0 and "/robot/joint_states" in ran.stdout, ran.stderr
    assert sum(b'"set_joint_params"' in record.data for record in Recording(Path(told["recording"]))) > 60


def test_the_lock_file_of_the_test_names_no_place_where_packages_are() -> None:
    lock = (ROSLIB / "package-lock.json").read_text()
    assert "resolved" not in lock


# -- what is told --------------------------------------------------------------------------------------------------


def test_topics_tell_what_the_protocol_tells_along_the_axes_of_ros(robot: Peer) -> None:
    robot.command(type="set_joint_param", joint_name="rocker.shoulder", param_name="target_position", value=0.5)
    robot.call("/step", ticks=45)
    told = {}
    for topic in ("/rocker/arm/pose", "/tf", "/clock", "/joint_states"):
        robot.say({"op": "subscribe", "topic": topic})
        told[topic] = robot.until(op="publish", topic=topic)["msg"]
    arm = robot.command(type="get_cube_state", cube_name="rocker.arm")
    joint = robot.command(type="get_joint_info", joint_name="rocker.shoulder")
    x, y, z = arm["position"]
    pose = told["/rocker/arm/pose"]
    assert pose["header"]["frame_id"] == "world" and pose["header"]["stamp"] == {"secs": 0, "nsecs": 750_000_000}
    assert pose["pose"]["position"] == {"x": x, "y": -z, "z": y}
    a, b, c, d = arm["quaternion"]
    assert pose["pose"]["orientation"] == {"x": a, "y": -c, "z": b, "w": d}
    transform = told["/tf"]["transforms"][1]
    assert transform["child_frame_id"] == "rocker/arm"
    assert transform["transform"] == {"translation": pose["pose"]["position"], "rotation": pose["pose"]["orientation"]}
    states = told["/joint_states"]
    assert states["name"] == ["rocker.shoulder"]
    assert (states["position"], states["velocity"]) == ([joint["position"]], [joint["velocity"]])
    assert states["effort"] == [joint["effort"]] and joint["position"] > 0.2
    assert told["/clock"] == {"clock": {"secs": 0, "nsecs": 750_000_000}}


vectors = st.tuples(*[st.floats(-100, 100)] * 3)


@given(vectors, vectors.filter(lambda v: math.hypot(*v) > 0.1), st.floats(-3, 3))
def test_the_axes_of_ros_are_the_worlds_turned_a_quarter_about_x(
    point: tuple[float, float, float], axis: tuple[float, float, float], angle: float
) -> None:
    there = to_ros(point)
    assert from_ros(there) == pytest.approx(point)
    assert to_ros((0, 1, 0)) == {"x": 0, "y": 0, "z": 1} and to_ros((1, 0, 0)) == {"x": 1, "y": 0, "z": 0}
    size, half = math.hypot(*axis), math.sin(angle / 2)
    x, y, z = (half * part / size for part in axis)
    turned = to_ros(rotate((x, y, z, math.cos(angle / 2)), point))
    told = to_ros((x, y, z))
    again = rotate((told["x"], told["y"], told["z"], math.cos(angle / 2)), (there["x"], there["y"], there["z"]))
    assert tuple(turned.values()) == pytest.approx(again, abs=1e-9)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_all_cubes_are_told_as_each_alone(count: int) -> None:
    world = World(LOCKSTEP)
    client = world.join()
    for number in range(count):
        place, turn = [1.5 * number, 2.25, -0.125 * number], [10.0 * number, 20.0, -30.0]
        send(world, client, type="spawn_cube", cube_name=f"a{number}.b", position=place, rotation=turn)
    views = Views()
    text = views.text(world, "/tf", ros2=False)
    assert text is not None
    told = json.loads(text)["msg"]["transforms"]
    assert [each["child_frame_id"] for each in told] == [f"a{number}/b" for number in range(count)]
    for each in told:
        text = views.text(world, f"/{each['child_frame_id']}/pose", ros2=False)
        assert text is not None
        alone = json.loads(text)["msg"]
        pose = {"position": each["transform"]["translation"], "orientation": each["transform"]["rotation"]}
        assert (alone["header"], alone["pose"]) == (each["header"], pose)


def test_cubes_whose_frames_would_have_one_name_have_none() -> None:
    """Two places of one frame would contradict each other, and tf2 refuses a frame that is below itself."""
    world = World(LOCKSTEP)
    client, views = world.join(), Views()

    def frames() -> dict[str, float]:
        text = views.text(world, "/tf", ros2=False)
        assert text is not None
        told = json.loads(text)["msg"]["transforms"]
        return {each["child_frame_id"]: each["transform"]["translation"]["x"] for each in told}

    for number, name in enumerate(("a-b", "alone", "a_b", "world", "last")):
        send(world, client, type="spawn_cube", cube_name=name, position=[3.0 * number, 2.0, 0.0])
    assert frames() == {"alone": 3.0, "last": 12.0}
    send(world, client, type="despawn_cube", cube_name="a_b")
    assert frames() == {"a_b": 0.0, "alone": 3.0, "last": 12.0}
    for name in ("a-b", "alone", "last"):
        send(world, client, type="despawn_cube", cube_name=name)
    assert frames() == {}


def test_the_list_of_all_topics_is_made_once_for_the_same_topics() -> None:
    world = World(LOCKSTEP)
    views, asked, names = Views(), [], []
    for _ in range(2):
        for _ in range(2):
            asked.append(look_up("/rosapi/topics_and_raw_types", Asked(views.graph(world), world, {})))
            names.append(set(orjson.loads(orjson.dumps(asked[-1]))["topics"]))
        send(world, world.join(), type="spawn_cube", cube_name="box", position=[0, 2, 0])
    assert asked[0] is asked[1] is not asked[2] is asked[3]
    assert names[2] - names[1] == {"/box/pose"}


def test_topics_of_a_world_that_slept_are_of_what_woke() -> None:
    world, views = World(LOCKSTEP), Views()
    client = world.join()
    for name, height in (("a", 1), ("b", 3)):
        send(world, client, type="spawn_cube", cube_name=name, position=[0, height, 0])
    joint = {"joint_name": "hinge", "joint_type": "hinge", "axis": [0, 0, 1]}
    send(world, client, type="create_joint", cube1="a", cube2="b", **joint)
    world.leave(client)
    topic = views.graph(world).find("/hinge/command")
    assert topic is not None and topic.hear is not None
    assert topic.hear({"data": 1})["param_name"] == "motor_target_velocity"
    world.hibernate()
    world.wake()
    send(world, world.join(), type="set_joint_params", joint_name="hinge", params={"target_position": 0.5})
    topic = views.graph(world).find("/hinge/command")
    assert topic is not None and topic.hear is not None
    assert topic.hear({"data": 1})["param_name"] == "target_position"


def test_types_of_ros_2_have_its_time(robot: Peer) -> None:
    robot.call("/step", ticks=90)
    robot.say({"op": "subscribe", "topic": "/rocker/joint_states", "type": "sensor_msgs/msg/JointState"})
    header = robot.until(op="publish")["msg"]["header"]
    assert header == {"stamp": {"sec": 1, "nanosec": 500_000_000}, "frame_id": ""}


def test_a_throttle_is_kept_in_the_worlds_time_and_after_a_reset(robot: Peer) -> None:
    robot.say({"op": "subscribe", "topic": "/clock", "throttle_rate": 100})
    robot.until(op="publish")
    heard = []
    for _ in range(24):
        robot.say({"op": "call_service", "service": "/step", "id": "s"})
        while (message := robot.hear())["op"] == "publish":
            heard.append(message["msg"]["clock"]["nsecs"])
    assert heard == [100_000_000, 200_000_000, 300_000_000, 400_000_000]
    robot.call("/reset")
    robot.say({"op": "call_service", "service": "/step", "id": "s"})
    assert robot.until(op="publish")["msg"]["clock"]["nsecs"] < 100_000_000


def test_a_subscription_ends_by_its_id_or_with_all_of_its_topic(robot: Peer) -> None:
    for number in ("one", "two"):
        robot.say({"op": "subscribe", "topic": "/clock", "id": number})
    robot.say({"op": "unsubscribe", "topic": "/clock", "id": "one"})
    robot.call("/rosapi/nodes")
    robot.say({"op": "call_service", "service": "/step"})
    robot.until(op="publish", topic="/clock")
    robot.say({"op": "unsubscribe", "topic": "/clock", "id": "two"})
    robot.call("/step")
    assert robot.silent()


def test_a_topic_of_what_is_not_there_yet_is_told_once_it_is(server: Served) -> None:
    with peer(door(server)) as client:
        client.say({"op": "subscribe", "topic": "/rocker/joint_states", "type": "sensor_msgs/JointState"})
        assert client.silent()
        spawn(client)
        client.say({"op": "call_service", "service": "/step"})
        assert client.until(op="publish")["msg"]["name"] == ["shoulder"]


def test_what_has_one_name_in_ros_and_two_in_the_world_is_refused(server: Served) -> None:
    with peer(door(server)) as client:
        for name in ("a.b", "a/b", "lone"):
            client.command(type="spawn_cube", cube_name=name, position=[len(name), 1, 0])
        assert client.call("/rosapi/topics")["values"]["topics"] == [*COMMON, "/lone/pose"]
        assert "two things" in client.error({"op": "subscribe", "topic": "/a/b/pose"})


@given(st.text(min_size=1, max_size=20))
def test_names_are_those_of_ros(name: str) -> None:
    assert ros_name(name).replace("/", "").replace("_", "").isascii()
    assert not set(ros_name(name)) & set(" .-~#\n\"'{}")


# -- what is done --------------------------------------------------------------------------------------------------


def test_messages_on_topics_drive_motors(robot: Peer) -> None:
    def joint() -> Any:
        return robot.command(type="get_joint_info", joint_name="rocker.shoulder")["params"]

    robot.say({"op": "advertise", "topic": "/rocker/shoulder/command", "type": "std_msgs/Float64"})
    robot.say({"op": "publish", "topic": "/rocker/shoulder/command", "msg": {"data": 0.25}})
    assert joint()["target_position"] == 0.25
    robot.say({"op": "publish", "topic": "/rocker/command", "msg": {"data": [0.5]}})
    assert joint()["target_position"] == pytest.approx(0.4)
    message = {"name": ["shoulder"], "position": [0.1], "velocity": [], "effort": [3.0]}
    robot.say({"op": "publish", "topic": "/rocker/joint_command", "msg": message})
    assert (joint()["target_position"], joint()["motor_max_force"]) == (0.1, 3.0)
    robot.say({"op": "publish", "topic": "/joint_command", "msg": {"name": ["rocker.shoulder"], "velocity": [1.5]}})
    assert joint()["motor_target_velocity"] == 1.5
    robot.say({"op": "publish", "topic": "/rocker/shoulder/command", "msg": {"data": -2}})
    assert joint()["motor_target_velocity"] == -2  # it is a servo no longer
    assert robot.silent()


def test_services_pause_resume_and_step(robot: Peer) -> None:
    assert robot.call("/step", ticks=7)["values"] == {"frame": 7}
    for service, paused in (("/pause", True), ("/resume", False)):
        assert robot.call(service) == {
            "op": "service_response", "service": service, "id": "c", "values": {}, "result": True,
        }  # fmt: skip
        assert robot.command(type="get_world_info")["paused"] is paused
    assert robot.call("/rosapi/get_time")["values"]["time"]["nsecs"] == round(7e9 / 60)


REFUSED = [
    ("nonsense", "JSON"),
    ("[]", "JSON object"),
    ({"op": "fly"}, "not known here; known are advertise"),
    ({}, "not known here"),
    ({"op": "subscribe", "topic": "/clock", "id": {}}, "id"),
    ({"op": "subscribe"}, "topic"),
    ({"op": "subscribe", "topic": "/none"}, "no topic /none"),
    ({"op": "subscribe", "topic": "/clock", "type": "std_msgs/String"}, "is of type rosgraph_msgs/Clock"),
    ({"op": "subscribe", "topic": "/clock", "compression": "png"}, "compression"),
    ({"op": "subscribe", "topic": "/clock", "throttle_rate": -1}, "throttle_rate"),
    ({"op": "subscribe", "topic": "/rocker/command"}, "listens"),
    ({"op": "advertise", "topic": "/clock", "type": "rosgraph_msgs/Clock"}, "does not listen"),
    ({"op": "advertise", "topic": "/rocker/command", "type": "std_msgs/String"}, "Float64MultiArray"),
    ({"op": "publish", "topic": "/none", "msg": {}}, "no topic /none"),
    ({"op": "publish", "topic": "/rocker/command"}, "msg"),
    ({"op": "publish", "topic": "/rocker/command", "msg": {"data": 3}}, "data"),
    ({"op": "publish", "topic": "/rocker/command", "msg": {"data": ["fast"]}}, "no number"),
    ({"op": "publish", "topic": "/rocker/command", "msg": {"data": [7]}}, "controls"),
    ({"op": "publish", "topic": "/rocker/command", "msg": {"data": [0.1, 0.2]}}, "controls"),
    ({"op": "publish", "topic": "/rocker/command", "msg": {"data": ["fast"] * 2}}, "takes 1 controls, got 2"),
    ({"op": "publish", "topic": "/rocker/shoulder/command", "msg": {"data": True}}, "no number"),
    ({"op": "publish", "topic": "/joint_command", "msg": {"name": []}}, "name"),
    ({"op": "publish", "topic": "/joint_command", "msg": {"name": ["nobody"], "position": [1]}}, "no joint 'nobody'"),
    ({"op": "publish", "topic": "/joint_command", "msg": {"name": ["rocker.shoulder"]}}, "nothing is asked"),
    (
        {"op": "publish", "topic": "/joint_command", "msg": {"name": ["rocker.shoulder"], "position": [1, 2]}},
        "one number for each",
    ),
    ({"op": "set_level", "level": "loud"}, "level"),
    ({"op": "subscribe", "topic": "/clock", "fragment_size": 100}, "fragment_size"),
    ({"op": "subscribe", "topic": "/clock", "queue_length": "long"}, "queue_length"),
    (
        {"op": "publish", "topic": "/rocker/shoulder/command", "msg": {"data": 0.1, "speed": 3}},
        "std_msgs/Float64 has no 'speed'; its fields are data",
    ),
    ({"op": "fragment", "id": "1", "data": "{", "num": 0, "total": 2}, "not known here"),
]


@pytest.mark.parametrize(("operation", "why"), REFUSED, ids=[str(each[0])[:60] for each in REFUSED])
def test_what_cannot_be_done_is_told_and_changes_nothing(robot: Peer, operation: Any, why: str) -> None:
    before = robot.command(type="get_world_state")
    assert why in robot.error(operation)
    assert robot.command(type="get_world_state") == before


def test_of_several_joints_the_first_that_cannot_be_set_is_told() -> None:
    config = {**LOCKSTEP, "roles": {"player": {}}}
    with served(config, role_passwords={"player": "of players"}) as server:
        port = door(server)
        with peer(port) as owner, peer(port, "/?password=of%20players&role=player") as player:
            spawn(owner)
            message = {"name": ["rocker.shoulder"] * 2, "position": [0.1, 0.1]}
            why = player.error({"op": "publish", "topic": "/joint_command", "msg": message})
            assert why.startswith("/joint_command: ") and "rocker" in why
            assert player.silent()
            joint = owner.command(type="get_joint_info", joint_name="rocker.shoulder")
            assert joint["params"]["target_position"] == 0


@pytest.mark.parametrize(
    ("service", "args", "why"),
    [
        ("/none", {}, "no service /none"),
        ("/step", {"ticks": "many"}, "ticks"),
        ("/step", {"ticks": 0}, "ticks"),
        ("/step", [1], "args"),
        ("/command", {"command": "{"}, "JSON"),
        ("/command", {"command": '{"type": "fly"}'}, "fly"),
        ("/command", {"command": '{"type": "unsubscribe"}'}, "topics"),
        ("/command", {"command": '{"type": "batch", "commands": [{"type": "subscribe"}]}'}, "topics"),
        ("/step", {"tiks": 3}, "nmes_msgs/Step has no 'tiks'; it takes ticks"),
        ("/rosapi/topics", {"of": "mine"}, "it takes nothing"),
        ("/rosapi/message_details", {"type": "std_msgs/Everything"}, "nothing here is of type"),
        ("/rosapi/service_request_details", {"type": "std_msgs/Float64"}, "nothing here is of type"),
        ("/rosapi/set_param", {"name": "/use_sim_time", "value": "false"}, "no parameters here"),
        ("/rosapi/topic_type", {}, "topic"),
    ],
)
def test_a_call_that_fails_says_why(robot: Peer, service: str, args: Any, why: str) -> None:
    robot.say({"op": "call_service", "service": service, "args": args, "id": 9})
    answer = robot.until(op="service_response")
    assert answer["result"] is False and answer["id"] == 9 and why in answer["values"]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"model_xml": "<robot/>"}, "JSON"),
        ({"model_xml": "{}"}, "format"),
        ({"model_name": "rocker"}, "rocker"),
        ({"initial_pose": {"orientation": {"x": 0.7, "w": 0.7}}}, "orientation"),
        ({"initial_pose": {"position": {"x": "far"}}}, "x is no number"),
        ({"initial_pose": 3}, "initial_pose"),
        ({"robot_namespace": "/elsewhere"}, "robot_namespace"),
        ({"reference_frame": "rocker/torso"}, "reference_frame"),
    ],
)
def test_a_creature_that_cannot_be_spawned_is_told_in_the_answer(robot: Peer, change: Any, why: str) -> None:
    answer = robot.call("/spawn", **{"model_name": "other", "model_xml": json.dumps(ROCKER), **change})
    assert answer["values"]["success"] is False and why in answer["values"]["status_message"]


def test_levels_say_what_is_told(robot: Peer) -> None:
    robot.say({"op": "unadvertise", "topic": "/rocker/command"})
    assert robot.silent()
    robot.say({"op": "set_level", "level": "warning"}, {"op": "unadvertise", "topic": "/rocker/command", "id": 4})
    warning = robot.hear()
    assert (warning["level"], warning["id"]) == ("warning", 4)
    robot.say({"op": "set_level", "level": "none"}, {"op": "fly"})
    assert robot.silent()


@pytest.mark.parametrize(
    ("operation", "why"),
    [
        ({"op": "subscribe", "topic": "/clock", "queue_length": 10}, "queue_length: nothing is queued here"),
        ({"op": "advertise", "topic": "/rocker/command", "type": "std_msgs/Float64MultiArray", "z": 1, "b": 2}, "b, z"),
        ({"op": "unsubscribe", "topic": "/tf", "id": "other"}, "under that id"),
        ({"op": "unsubscribe", "topic": "/clock"}, "do not listen"),
    ],
)
def test_what_is_passed_over_is_told_as_a_warning(robot: Peer, operation: Any, why: str) -> None:
    robot.say({"op": "subscribe", "topic": "/tf", "id": "mine"}, {"op": "set_level", "level": "warning"})
    robot.say({"id": 5, **operation})
    warning = robot.until(op="status")
    assert warning["level"] == "warning" and why in warning["msg"]
    assert warning["id"] == operation.get("id", 5)


def test_a_world_that_stops_for_a_fault_tells_those_who_only_listen(server: Served) -> None:
    with peer(door(server)) as client, server.peer() as other:
        client.say({"op": "subscribe", "topic": "/clock"})
        client.until(op="publish")
        other.ask({"type": "spawn_cube", "cube_name": "a", "mass": 1e-6})
        other.ask({"type": "apply_force", "cube_name": "a", "force": [1e15, 0, 0]})
        assert other.ask({"type": "step", "ticks": 1000})["code"] == "world_faulted"
        assert client.until(op="status", level="error")["msg"].startswith("world_fault: ")
        assert client.call("/reset")["result"] is True


def test_nothing_is_kept_of_a_world_that_is_closed(server: Served) -> None:
    port = door(server)
    with peer(port) as client:
        spawn(client)
        client.call("/rosapi/topics")
        kept = server.call(lambda: weakref.ref(server.host.worlds["main"].world))
        server.client().close_world("main")
        with pytest.raises(ConnectionClosed):
            while True:
                client.hear()
    deadline = time.monotonic() + PATIENCE
    while kept() is not None and time.monotonic() < deadline:
        server.call(gc.collect)
        time.sleep(0.01)
    assert kept() is None
    with pytest.raises(ConnectionClosed), peer(port) as late:
        late.call("/rosapi/topics")


# -- types ---------------------------------------------------------------------------------------------------------


def fits(value: Any, kind: str, array: bool = False) -> bool:
    """Whether a value has the fields of a type of ROS, all of them and no more."""
    if array:
        return isinstance(value, list) and all(fits(each, kind) for each in value)
    atoms = {"string": str, "bool": bool, "float64": float, "int32": int, "int64": int, "uint32": int}
    if kind in atoms:
        return isinstance(value, atoms[kind])
    known = fields(kind)
    return value.keys() == known.keys() and all(
        fits(value[name], field.type, field.array) for name, field in known.items()
    )


def asked(client: Peer, service: str, args: Mapping[str, Any]) -> Any:
    client.say({"op": "call_service", "service": service, "args": args, "id": "asked"})
    return client.until(op="service_response", id="asked")


def test_all_that_is_told_has_the_fields_of_its_type(robot: Peer) -> None:
    names, types = robot.call("/rosapi/topics")["values"].values()
    told = 0
    for name, kind in zip(names, types, strict=True):
        if robot.call("/rosapi/publishers", topic=name)["values"]["publishers"]:
            robot.say({"op": "subscribe", "topic": name, "type": kind})
            assert fits(robot.until(op="publish", topic=name)["msg"], kind), name
            told += 1
        else:
            assert robot.call("/rosapi/subscribers", topic=name)["values"] == {"subscribers": ["/nmes"]}
    assert told == 6 and len(names) == 10
    arguments = {"topic": "/tf", "type": "sensor_msgs/JointState", "service": "/step", "node": "/nmes", "name": "/x"}
    services = robot.call("/rosapi/services")["values"]["services"]
    for service in (each for each in services if each.startswith("/rosapi/")):
        kind = asked(robot, "/rosapi/service_type", {"service": service})["values"]["type"]
        said = {name: arguments[name] for name in fields(f"{kind}Request") if name in arguments}
        if kind.startswith("rosapi/Service") and "type" in said:
            said["type"] = "gazebo_msgs/SpawnModel"
        answer = asked(robot, service, said)
        if service in ("/rosapi/set_param", "/rosapi/delete_param"):
            assert answer["result"] is False
            continue
        values = answer["values"]
        if kind == "rosapi/GetTime":  # as ROS 1 and ROS 2 write it, in one
            assert values["time"].pop("sec") == 0 and values["time"].pop("nanosec") == 0
        assert answer["result"] is True and fits(values, f"{kind}Response"), service


def test_types_are_told_as_lists_of_fields_and_as_text(robot: Peer) -> None:
    (clock, time_of) = robot.call("/rosapi/message_details", type="rosgraph_msgs/msg/Clock")["values"]["typedefs"]
    assert clock == {
        "type": "rosgraph_msgs/Clock", "fieldnames": ["clock"], "fieldtypes": ["time"], "fieldarraylen": [-1],
        "examples": ["{}"], "constnames": [], "constvalues": [],
    }  # fmt: skip
    assert time_of["fieldnames"] == ["secs", "nsecs"]
    request = robot.call("/rosapi/service_request_details", type="gazebo_msgs/SpawnModel")["values"]["typedefs"]
    assert [each["type"] for each in request] == [
        "gazebo_msgs/SpawnModelRequest", "geometry_msgs/Pose", "geometry_msgs/Point", "geometry_msgs/Quaternion",
    ]  # fmt: skip
    told = robot.call("/rosapi/topics_and_raw_types")["values"]
    text = dict(zip(told["topics"], told["typedefs_full_text"], strict=True))["/tf"]
    assert text.startswith("geometry_msgs/TransformStamped[] transforms\n")
    assert re.findall("^MSG: (.*)$", text, re.MULTILINE) == [
        "geometry_msgs/TransformStamped", "std_msgs/Header", "geometry_msgs/Transform", "geometry_msgs/Vector3",
        "geometry_msgs/Quaternion",
    ]  # fmt: skip


# -- who may come --------------------------------------------------------------------------------------------------


def test_a_client_needs_the_password_in_its_address_or_a_header() -> None:
    with served(auth_delay=0.01) as server:
        port = door(server)
        with peer(port, "/", additional_headers={"Authorization": f"Bearer {PASSWORD}"}) as client:
            assert client.silent()
        with peer(port, f"/anywhere?password={quote(PASSWORD)}&world=main") as client:
            assert client.silent()
        for address in ("/", "/?password=guess", f"/?password={quote(PASSWORD)}&world=none"):
            with peer(port, address) as client:
                assert client.hear()["level"] == "error"
                with pytest.raises(ConnectionClosed):
                    client.hear()
        with pytest.raises(InvalidStatus), peer(port, origin="https://evil.example"):
            pass  # a foreign page


def test_nobody_needs_one_where_it_was_made_up_for_this_machine(tmp_path: Path) -> None:
    common = ("serve", "--port", "0", "--rosbridge", "0", "--json", "--no-record")
    with process(*common) as running, peer(ready(running)["rosbridge_port"], "/") as client:
        assert client.silent()
    with process(*common, NMES_PASSWORD=PASSWORD) as running:
        with peer(ready(running)["rosbridge_port"], "/") as client:
            assert "password" in client.hear()["msg"]


def test_it_does_not_go_with_workers(tmp_path: Path) -> None:
    with process("serve", "--rosbridge", "0", "--workers", "2", "--record", str(tmp_path)) as running:
        assert running.wait(PATIENCE) == 2
        assert running.stderr is not None and "--workers does not go with --rosbridge" in running.stderr.read()


# -- hostile clients -----------------------------------------------------------------------------------------------


def test_one_who_does_not_read_holds_up_nobody_and_is_cut() -> None:
    with served(REALTIME, limits=Limits(stall_timeout=1.0)) as server:
        port = door(server)
        with peer(port) as idle, peer(port) as other:
            cubes = [{"type": "spawn_cube", "position": [0, 2 * n, 0]} for n in range(200)]
            other.command(type="batch", commands=cubes)
            idle.say({"op": "subscribe", "topic": "/tf"})
            for _ in range(3000):
                try:
                    idle.say({"op": "call_service", "service": "/rosapi/topics"})
                except ConnectionClosed:  # the socket is closed a little before it is no peer any more
                    break
                if server.call(lambda: len(server.host.worlds["main"]._peers)) == 1:
                    break
            other.say({"op": "subscribe", "topic": "/clock"})
            first = other.until(op="publish")["msg"]["clock"]
            deadline = time.monotonic() + PATIENCE
            while time.monotonic() < deadline and server.call(lambda: server.host.worlds["main"].clients) > 1:
                other.until(op="publish", topic="/clock")
            assert server.call(lambda: server.host.worlds["main"].clients) == 1
            assert other.until(op="publish")["msg"]["clock"] != first


def test_one_who_only_asks_is_read_no_further_than_he_reads() -> None:
    call = json.dumps({"op": "call_service", "service": "/rosapi/services", "id": "x" * 400})
    with served(LOCKSTEP, limits=Limits(stall_timeout=600.0)) as server, peer(door(server)) as client:
        client.connection.socket.settimeout(2.0)
        with pytest.raises((TimeoutError, ConnectionClosed)):
            for _ in range(100_000):  # 40 MB
                client.say(call)


def test_what_is_long_is_read_in_a_thread_and_in_its_turn(robot: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[tuple[bool, bool]] = []  # whether it was long, and whether in a thread of readers

    def noting(text: bytes) -> Any:
        read.append((len(text) > LONG, threading.current_thread().name.startswith("nmes-reader")))
        return parse_json(text)

    monkeypatch.setattr("nmes.ros.bridge.parse_json", noting)
    monkeypatch.setattr("nmes.ros.services.parse_json", noting)
    long = json.dumps({"type": "set_joint_param", "joint_name": "rocker.shoulder", "param_name": "target_position"})
    for number in range(10):  # each long one before a short one
        command = long.replace("}", f', "value": {number / 20}}}') + " " * LONG
        robot.say({"op": "call_service", "service": "/command", "args": {"command": command}, "id": number})
        robot.say({"op": "publish", "topic": "/rocker/shoulder/command", "msg": {"data": -number / 20}})
    assert robot.call("/command", command='{"type": "ping"}' + " " * LONG)["result"] is True
    joint = robot.command(type="get_joint_info", joint_name="rocker.shoulder")
    assert joint["params"]["target_position"] == -0.45
    assert read.count((True, True)) == 22 and (True, False) not in read and (False, True) not in read
    assert "more than" in robot.error('{"op": "fly", "a": [' + "[]," * 70_000 + "0]}")


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)
OPERATIONS = ["advertise", "unadvertise", "publish", "subscribe", "unsubscribe", "call_service", "set_level"]
operations = st.fixed_dictionaries(
    {"op": st.sampled_from(OPERATIONS)},
    optional={
        "topic": st.sampled_from([*COMMON, *OWN, "/", "", "/none"]) | values,
        "type": st.sampled_from(["std_msgs/Float64", "sensor_msgs/msg/JointState", "/", "a/srv/b"]) | values,
        "msg": st.fixed_dictionaries(
            {}, optional={name: values for name in ("data", "name", "position", "velocity", "effort", "header")}
        ) | values,
        "service": st.sampled_from(["/spawn", "/command", "/step", "/rosapi/get_param", "/rosapi/topic_type"]) | values,
        "args": st.fixed_dictionaries(
            {}, optional={name: values for name in ("name", "node", "command", "ticks", "model_xml", "initial_pose")}
        ) | values,
        "id": values,
        "throttle_rate": values,
        "compression": values,
        "level": values,
    },
)  # fmt: skip


def test_whatever_is_said_is_answered_and_nothing_ends(tmp_path: Path) -> None:
    with served(LOCKSTEP, record_to=tmp_path) as server, peer(door(server)) as robot:
        spawn(robot)

        @settings(max_examples=150, deadline=None)
        @given(st.lists(operations | st.text(max_size=20), max_size=6))
        def attack(said: list[Any]) -> None:
            robot.say(*said)
            robot.say({"op": "call_service", "service": "/rosapi/nodes", "id": "alive"})
            robot.until(op="service_response", id="alive")

        attack()
        assert server.call(lambda: server.host.worlds["main"].status.fault) is None
    (path,) = tmp_path.iterdir()
    assert replay(path).verdict == "reproduced"
