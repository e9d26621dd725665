"""Channels: what is said is heard from the next tick on, by cubes, creatures and brains; recorded and saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nmes import World, protocol
from nmes.errors import RejectedMessage, WorldError
from nmes.evaluation import Evaluator, Task, evaluate
from nmes.genome import Genome
from nmes.playback import replay
from nmes.recording import Recorder

Document = dict[str, Any]
CHANNELS = {"alarm": {"range": 10}, "map": {"size": 3}, "whisper": {"range": 4, "fades": True}}


class Place:
    """A world in lockstep without gravity, and one client in it; every reply is checked against its schema."""

    def __init__(self, recording: Path | None = None, **config: Any) -> None:
        self.world = World({"mode": "lockstep", "gravity": [0, 0, 0], "channels": CHANNELS, **config})
        self.recorder = None if recording is None else Recorder(recording, self.world)
        self.world.journal = self.recorder
        self.client = self.world.join()

    def __call__(self, kind: str, **fields: Any) -> Document:
        reply = self.world.execute(self.client, {"type": kind, **fields})
        protocol.validate_reply(reply)
        return reply

    def cube(self, name: str, x: float, z: float = 0.0) -> None:
        assert self("spawn_cube", cube_name=name, position=[x, 5, z], size=0.5, list=False)["spawned"] == name

    def creature(self, name: str, x: float, **parts: Any) -> Document:
        reply = self("spawn_creature", genome=speaker(**parts), name=name, position=[x, 4.8, 0])
        assert reply["type"] == "creature_spawned", reply
        return reply

    def tick(self, ticks: int = 1) -> None:
        assert self("step", ticks=ticks)["type"] == "stepped"

    def heard(self, channel: str, cube: str) -> list[tuple[str, Any, Any]]:
        voices = self("hear", channel=channel, cube_name=cube)["voices"]
        return [(voice["cube_name"], voice["value"], pytest.approx(voice["distance"])) for voice in voices]


def speaker(**parts: Any) -> Document:
    """A creature of two cubes and a motor between them."""
    cubes = [
        {"id": "root", "size": 0.4, "mass": 1, "position": [0, 0.2, 0]},
        {"id": "tail", "size": 0.4, "mass": 1, "position": [-2, 0.2, 0]},
    ]
    motor = {"mode": "velocity", "range": [-1, 1], "max_effort": 20}
    joint = {"id": "j", "cube1": "root", "cube2": "tail", "type": "slide", "anchor": [-1, 0.2, 0], "motor": motor}
    body = {"cubes": cubes, "joints": [joint]}
    return {"format": "nmes-genome/1", "name": "speaker", "body": body, **parts}


EARS = [{"type": "hear", "cube": "root", "channel": "alarm"}]
VOICES = [{"channel": "alarm"}, {"channel": "map", "number": 3}, {"id": "first", "channel": "map"}]


@pytest.mark.parametrize("backend", ["mujoco", "pymunk", "ballistic"])
def test_what_is_said_is_heard_from_the_next_tick_on(backend: str) -> None:
    place = Place(backend=backend)
    place.cube("a", 0)
    place.cube("b", 3)
    assert place("say", channel="alarm", value=0.5, cube_name="a") == {
        "type": "said", "channel": "alarm", "cube_name": "a",
    }  # fmt: skip
    assert place.heard("alarm", "b") == []
    place.tick()
    assert place.heard("alarm", "b") == [("a", [0.5], 3)]
    assert place.heard("alarm", "a") == []  # nobody hears itself
    place.tick(5)
    assert place.heard("alarm", "b") == [("a", [0.5], 3)]  # it lasts
    place("say", channel="alarm", value=[-1], cube_name="a")
    assert place.heard("alarm", "b") == [("a", [0.5], 3)]
    place.tick()
    assert place.heard("alarm", "b") == [("a", [-1], 3)]
    place("say", channel="alarm", cube_name="a")
    place.tick()
    assert place.heard("alarm", "b") == []
    assert place("say", channel="alarm", cube_name="a")["type"] == "said"  # who is silent may fall silent


def test_the_nearest_is_heard_first_and_of_those_equally_far_the_older() -> None:
    place = Place()
    for name, x in (("ear", 0), ("far", 9), ("right", 4), ("left", -4), ("away", 11)):
        place.cube(name, x)
    for name in ("away", "left", "far", "right"):
        place("say", channel="alarm", value=1, cube_name=name)
    place.tick()
    assert [name for name, _, _ in place.heard("alarm", "ear")] == ["right", "left", "far"]
    place("set_cube_state", cube_name="away", position=[1, 5, 0])
    assert [name for name, _, _ in place.heard("alarm", "ear")] == ["away", "right", "left", "far"]


def test_what_fades_is_half_as_loud_at_half_the_range() -> None:
    place = Place()
    for name, x in (("a", 0), ("b", 2), ("c", 3.9), ("d", -4.1)):
        place.cube(name, x)
    place("say", channel="whisper", value=-0.8, cube_name="a")
    place.tick()
    assert place.heard("whisper", "b") == [("a", [pytest.approx(-0.4)], 2)]
    assert place.heard("whisper", "c") == [("a", [pytest.approx(-0.02)], 3.9)]
    assert place.heard("whisper", "d") == []


def test_a_voice_is_gone_with_its_cube_and_with_a_reset() -> None:
    place = Place()
    place.cube("a", 0)
    place.cube("b", 3)
    place("say", channel="map", value=[1, 0, 1], cube_name="a")
    place.tick()
    assert place.heard("map", "b") == [("a", [1, 0, 1], 3)]
    place("despawn_cube", cube_name="a")
    assert place.heard("map", "b") == []
    place.cube("a", 0)  # another of that name
    place.tick()
    assert place.heard("map", "b") == []
    place("say", channel="map", value=[1, 0, 1], cube_name="a")
    place.tick()
    place("reset")
    place.cube("a", 0)
    place.cube("b", 3)
    place.tick()
    assert place.heard("map", "b") == []


@pytest.mark.parametrize(
    ("command", "field"),
    [
        ({"channel": "nothing", "value": 1, "cube_name": "a"}, "channel"),
        ({"channel": "alarm", "value": [1, 1], "cube_name": "a"}, "value"),
        ({"channel": "map", "value": 1, "cube_name": "a"}, "value"),
        ({"channel": "alarm", "value": 1.5, "cube_name": "a"}, "value"),
        ({"channel": "alarm", "value": 1, "cube_name": "b"}, "cube_name"),
        ({"channel": "alarm", "value": 1, "creature": "b"}, "creature"),
    ],
)
def test_what_cannot_be_said_is_refused_and_changes_nothing(command: Document, field: str) -> None:
    place = Place()
    place.cube("a", 0)
    before = place.world.digest()
    reply = place("say", **command)
    assert (reply["type"], reply["field"]) == ("error", field)
    assert place.world.digest() == before
    assert place("say", channel="alarm", value=1, cube_name="a", creature="a")["code"] == "invalid"


def test_where_there_are_no_channels_nothing_is_said_and_the_digest_is_the_engines() -> None:
    world = World({"mode": "lockstep"})
    client = world.join()
    world.execute(client, {"type": "spawn_cube", "cube_name": "a"})
    for kind in ("say", "hear"):
        reply = world.execute(client, {"type": kind, "channel": "alarm", "cube_name": "a"})
        assert (reply["code"], reply["field"]) == ("invalid", "channel")
    assert world.digest() == world.simulation.digest()
    assert b"channels" not in world.snapshot()


def test_a_channel_that_fades_needs_a_range() -> None:
    with pytest.raises(RejectedMessage) as refusal:
        World({"channels": {"alarm": {"fades": True}}})
    assert refusal.value.path == "channels/alarm/fades"


# -- creatures --------------------------------------------------------------------------------------------------------


def test_voices_are_outputs_behind_the_motors_and_ears_are_sensors() -> None:
    place = Place()
    ears = [*EARS, {"type": "hear", "cube": "root", "channel": "map", "number": 3}]
    reply = place.creature("one", 0, voices=VOICES, sensors=ears)
    assert (reply["motors"], reply["voices"]) == (["j"], ["say.alarm", "say.map.3", "first"])
    assert reply["sensors"] == ["root.hear.alarm", "root.hear.map.3"]
    place.creature("two", 6, sensors=ears)
    assert place("sense", creature="two")["values"] == [0, 0]
    assert place("drive", creature="one", controls=[0, 0.25, -0.5, 1])["type"] == "driven"
    assert place("sense", creature="two")["values"] == [0, 0]
    place.tick()
    assert place("sense", creature="two")["values"] == [0.25, -0.5]
    assert place("sense", creature="one")["values"] == [0, 0]  # a creature does not hear itself
    voices = place("hear", channel="map", creature="two")["voices"]
    assert [(voice["cube_name"], voice["value"]) for voice in voices] == [("one.root", [1, 0, -0.5])]
    place("set_cube_state", cube_name="two.root", position=[20, 5, 0])
    assert place("sense", creature="two")["values"] == [0, -0.5]  # the alarm has a range of 10 m
    short = place("drive", creature="one", controls=[0])
    assert short["code"] == "invalid" and "1 motors and then of its 3 voices" in short["message"]


def test_an_ear_is_where_its_cube_is() -> None:
    place = Place()
    place.creature(
        "one", 0, sensors=[{"type": "hear", "cube": cube, "channel": "whisper"} for cube in ("root", "tail")]
    )
    place.cube("near", 3.5)
    place("say", channel="whisper", value=1, cube_name="near")
    place.tick()
    root, tail = place("sense", creature="one")["values"]
    assert (root, tail) == (pytest.approx(0.125), 0)
    place("say", channel="whisper", value=1, cube_name="one.tail")  # its own, which it does not hear
    place.tick()
    assert place("sense", creature="one")["values"] == pytest.approx([0.125, 0])


def test_a_creature_is_silent_and_deaf_where_the_world_has_no_such_channel() -> None:
    place = Place(channels={"other": {}})
    place.creature("one", 0, voices=VOICES)
    place.creature("two", 3, sensors=EARS)
    assert place("drive", creature="one", controls=[0, 1, 1, 1])["type"] == "driven"
    place.tick()
    assert place("sense", creature="two")["values"] == [0]


@pytest.mark.parametrize(
    ("parts", "field"),
    [
        ({"voices": [{"channel": "alarm", "number": 2}]}, "genome/voices"),
        ({"sensors": [{**EARS[0], "number": 2}]}, "genome/sensors"),
    ],
)
def test_a_number_that_a_channel_has_not_is_refused(parts: Document, field: str) -> None:
    place = Place()
    reply = place("spawn_creature", genome=speaker(**parts))
    assert (reply["code"], reply["field"]) == ("invalid", field)
    assert place.world.cubes() == []


@pytest.mark.parametrize(
    ("parts", "path"),
    [
        ({"sensors": [{"type": "hear", "cube": "root"}]}, "sensors/0"),
        ({"sensors": [{"type": "up", "cube": "root", "channel": "a"}]}, "sensors/0/channel"),
        ({"sensors": [{"type": "up", "cube": "root", "number": 2}]}, "sensors/0/number"),
        ({"sensors": [{"type": "hear", "joint": "j", "channel": "a"}]}, "sensors/0/type"),
        ({"sensors": [{"type": "hear", "cube": "root", "channel": "a", "axis": "x"}]}, "sensors/0/axis"),
        ({"voices": [{"channel": "a"}, {"id": "b", "channel": "a"}]}, "voices/1"),
        ({"voices": [{"channel": "a"}, {"id": "say.a", "channel": "b"}]}, "voices/1"),
        ({"voices": [{"id": "j", "channel": "a"}]}, "voices/0"),
        ({"voices": [{"channel": "a b"}]}, "voices/0/channel"),
        ({"voices": [{"channel": "a", "number": 9}]}, "voices/0/number"),
    ],
)
def test_an_ill_genome_is_told_where(parts: Document, path: str) -> None:
    assert [found for found, _ in Genome.problems(speaker(**parts))] == [path]


def test_a_brain_has_voices_for_outputs() -> None:
    oscillators = [{"motor": name, "amplitude": 1, "frequency": 1} for name in ("j", "say.alarm")]
    genome = Genome(speaker(voices=VOICES, brain={"kind": "sine", "oscillators": oscillators}))
    assert genome.body.outputs == ("j", "say.alarm", "say.map.3", "first")
    brain = genome.brain()
    brain.reset(seed=0, dt=1 / 60)
    controls = [brain.step(np.zeros(len(genome.body.sensors))).copy() for _ in range(16)][-1]
    assert controls[0] == controls[1] == pytest.approx(1, abs=0.02) and controls[2:].tolist() == [0, 0]
    oscillators[0]["motor"] = "nothing"
    wrong = speaker(voices=VOICES, brain={"kind": "sine", "oscillators": oscillators})
    assert [path for path, _ in Genome.problems(wrong)] == ["brain/oscillators/0/motor"]
    # Where a voice is wrong itself, what may be its name is not blamed.
    wrong = speaker(voices=[{"channel": "a b", "id": "x"}], brain={"kind": "sine", "oscillators": oscillators})
    assert [path for path, _ in Genome.problems(wrong)] == ["voices/0/channel"]


# -- histories --------------------------------------------------------------------------------------------------------


def talk(place: Place, ticks: int) -> None:
    """Lets two creatures talk, one by commands and one by the way of callers in this process."""
    for tick in range(ticks):
        controls = np.array([0.1, np.sin(tick), -0.3, 1.0])
        place.world.drive(place.client, "one", controls)
        heard = place.world.creature("two").sense()[0]
        place("drive", creature="two", controls=[heard, -heard, 0, 0])
        if tick % 7 == 3:
            place("say", channel="whisper", value=(tick % 5) / 5, creature="one")
        place.tick()


def test_what_is_said_and_heard_is_recorded_and_replayed_also_from_keyframes(tmp_path: Path) -> None:
    path = tmp_path / "talk.mcap"
    place = Place(path, keyframes=0.25)
    place.creature("one", 0, voices=VOICES, sensors=EARS)
    place.creature("two", 6, voices=VOICES, sensors=EARS)
    talk(place, 70)
    assert place.recorder is not None
    place.recorder.close()
    assert replay(path).verdict == "reproduced"
    assert replay(path, first=50).verdict == "reproduced"


def test_brains_that_the_world_runs_talk_and_are_replayed(tmp_path: Path) -> None:
    path = tmp_path / "minds.mcap"
    place = Place(path, keyframes=0.25)
    wave = {"kind": "sine", "oscillators": [{"motor": "say.alarm", "amplitude": 1, "frequency": 2}]}
    echo = {"kind": "mlp", "outputs": ["j", "say.map.3"], "layers": [{"weights": [[1], [2]], "biases": [0, 0]}]}
    for name, x, brain in (("one", 0, wave), ("two", 6, echo)):
        genome = speaker(voices=VOICES, sensors=EARS, brain=brain)
        place("spawn_creature", genome=genome, name=name, position=[x, 4.8, 0], autonomous=True)
    place("spawn_creature", genome=speaker(sensors=[{**EARS[0], "channel": "map", "number": 3}]), name="three",
          position=[12, 4.8, 0])  # fmt: skip
    said, echoed = [], []
    for _ in range(40):
        place.tick()
        said.append(place.world.creature("two").sense()[0])
        echoed.append(place.world.creature("three").sense()[0])
    assert max(said) > 0.9 and min(said) < -0.9
    # What is heard after a tick drives the echo in the next, and is heard after that.
    assert echoed[1:] == pytest.approx(np.tanh(2 * np.array(said[:-1])))
    assert place.recorder is not None
    place.recorder.close()
    assert replay(path).verdict == "reproduced" and replay(path, first=30).verdict == "reproduced"


def test_a_restored_world_hears_the_same_and_goes_on_alike() -> None:
    place = Place()
    place.creature("one", 0, voices=VOICES, sensors=EARS)
    place.creature("two", 6, voices=VOICES, sensors=EARS)
    talk(place, 9)
    place("say", channel="map", value=[0.1, 0.2, 0.3], cube_name="two.tail")  # said, and not yet heard
    saved = place.world.snapshot()
    again = Place()
    again.world.restore(saved)
    assert again.world.digest() == place.world.digest()
    assert again.world.snapshot() == saved
    for one in (place, again):
        one.client = one.world.clients()[0]
        talk(one, 5)
    assert again.world.digest() == place.world.digest()
    assert again("hear", channel="map", cube_name="one.root") == place("hear", channel="map", cube_name="one.root")


def test_the_digest_tells_what_is_said_and_what_is_heard() -> None:
    digests = []
    for value in (None, 0.5, 0.25):
        place = Place()
        place.cube("a", 0)
        if value is not None:
            place("say", channel="alarm", value=value, cube_name="a")
        digests.append(place.world.digest())
        place.tick()
        digests.append(place.world.digest())
    assert len(set(digests)) == 6
    quiet = Place()
    quiet.cube("a", 0)
    assert quiet.world.digest() != quiet.world.simulation.digest()


def test_a_forged_snapshot_of_voices_is_refused() -> None:
    place = Place()
    place.cube("a", 0)
    place("say", channel="map", value=[0, 0.5, 1], cube_name="a")
    saved = place.world.snapshot()
    voice = b'{"channel":"map","body":1,"value":[0.0,0.5,1.0]}'
    assert voice in saved
    for forged in (
        saved.replace(voice, voice.replace(b"map", b"alarm")),
        saved.replace(voice, voice.replace(b"map", b"nothing")),
        saved.replace(voice, voice.replace(b'"body":1', b'"body":2')),
        saved.replace(voice, voice.replace(b"1.0]", b"2.0]")),
        saved.replace(voice, voice + b"," + voice),
        saved.replace(b'"channels":{"said":[' + voice + b'],"heard":[]},', b""),
        saved.replace(b',"channels":{"said":[' + voice + b'],"heard":[]}', b""),
    ):
        if forged == saved:
            continue
        with pytest.raises(WorldError) as refusal:
            place.world.restore(forged)
        assert refusal.value.code == "bad_snapshot"
    silent = World({"mode": "lockstep"})
    with pytest.raises(WorldError):
        silent.restore(silent.snapshot().replace(b'"next_client"', b'"channels":{"said":[],"heard":[]},"next_client"'))


def test_alone_in_a_row_there_is_silence_and_voices_are_no_motors(tmp_path: Path) -> None:
    weights = [[1.0, 1.0, 0.3], [0.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 0.5]]
    brain = {"kind": "mlp", "layers": [{"weights": weights, "biases": [0.1, 0.2, 0.3, 0.4]}]}
    sensors = [*EARS, {"type": "height", "cube": "root"}, {"type": "position", "joint": "j"}]
    document = speaker(voices=VOICES, sensors=sensors, brain=brain)
    task = Task({"format": "nmes-task/1", "name": "t", "description": "d", "world": {"channels": CHANNELS},
                 "duration": 1, "seeds": [1, 2], "objective": "displacement.x"})  # fmt: skip
    with Evaluator(jobs=1) as evaluator:
        rows = evaluator.evaluate_population([document] * 3, task)
    world = evaluate(document, task, record=str(tmp_path))  # what is recorded runs in a world
    assert [evaluation.score for evaluation in rows] == [world.score] * 3
    assert world.score not in (None, 0.0), rows
