"""Films and pictures, and the moments that they are made of."""

from __future__ import annotations

import re
import sys
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from PIL import Image, ImageSequence

from nmes.backend import fingerprint as fingerprints
from nmes.cli import main
from nmes.errors import FilmError, WorldError
from nmes.evaluation import Evaluation, Task, evaluate
from nmes.genome import Genome
from nmes.playback.fork import fork
from nmes.recording import Recorder, Recording
from nmes.view.caption import Caption
from nmes.view.film import Cut, film
from nmes.view.moments import moments
from nmes.view.part_colors import visible_shapes
from nmes.world import World
from recordings import Line, changed, first, record, rewrite, send

Pixels = npt.NDArray[np.uint8]


def throw(world: World, client: int) -> None:
    """A red cube flies along x at 2 m/s for 2 s; a green one stands still, far off; a blue one comes after 1 s."""
    send(
        world,
        client,
        type="spawn_cube",
        cube_name="red",
        position=[0, 5, 0],
        color=[1, 0, 0],
        linear_velocity=[2, 0, 0],
    )
    send(world, client, type="spawn_cube", cube_name="green", position=[0, 5, -50], color=[0, 1, 0], is_base=True)
    send(world, client, type="step", ticks=60)
    send(world, client, type="spawn_cube", cube_name="blue", position=[2, 9, 0], color=[0, 0, 1], is_base=True)
    for _ in range(60):
        world.tick()


CONFIG = {"gravity": [0, 0, 0]}


@pytest.fixture(scope="module")
def thrown(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return Recording(record(tmp_path_factory.mktemp("films") / "thrown.mcap", throw, CONFIG))


@pytest.fixture
def recording(thrown: Recording, tmp_path: Path) -> Recording:
    """The same, where pictures can be drawn."""
    try:
        film([thrown], tmp_path / "try.png", Cut(end=0.1), size=(32, 32))
    except WorldError as error:
        assert error.code == "unsupported"
        pytest.skip(f"no picture to judge: {error.message}")
    return thrown


def alien(monkeypatch: pytest.MonkeyPatch, path: Path, pose_rate: float = 10.0) -> Recording:
    """A recording of a machine that computes otherwise."""
    ticked = Recorder.ticked
    with monkeypatch.context() as patch:
        patch.setattr("nmes.recording.recorder.fingerprint", lambda b: {**fingerprints.fingerprint(b), "probe": "0ff"})
        patch.setattr(Recorder, "ticked", lambda self, frame, digest: ticked(self, frame, digest[::-1]))
        return Recording(record(path, throw, CONFIG, pose_rate=pose_rate))


def place(image: Pixels, channel: int) -> tuple[float, float] | None:
    """Where the middle of what has a colour is: column and row, as parts of the picture, or None."""
    others = [other for other in range(3) if other != channel]
    mask = image[..., channel].astype(int) - image[..., others].max(axis=2) > 60
    if not mask.any():
        return None
    rows, columns = np.nonzero(mask)
    return (columns.mean() + 0.5) / image.shape[1], (rows.mean() + 0.5) / image.shape[0]


def frames(path: Path) -> list[Pixels]:
    if path.suffix == ".mp4":
        with av.open(str(path)) as container:
            return [np.asarray(frame.to_ndarray(format="rgb24"), np.uint8) for frame in container.decode(video=0)]
    with Image.open(path) as image:
        return [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(image)]


def test_a_film_has_the_moments_of_the_ticks(thrown: Recording) -> None:
    ticks = list(moments(thrown))
    assert [moment.time for moment in ticks] == [tick / 60 for tick in range(1, 121)]
    assert list(ticks[59].shapes) == ["red", "green_BASE"]
    assert list(ticks[60].shapes) == [
        "red",
        "green_BASE",
        "blue_BASE",
    ]
    assert ticks[60].shapes["blue_BASE"] == ((1.0, 1.0, 1.0), (0.0, 0.0, 1.0, 1.0), "box")
    for moment in ticks:
        assert moment.poses[0] == pytest.approx([2 * moment.time, 5, 0, 0, 0, 0, 1], abs=1e-9)


def test_a_recording_of_another_machine_is_filmed_from_its_poses(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    ticks = list(moments(alien(monkeypatch, tmp_path / "alien.mcap")))
    assert [moment.time for moment in ticks] == pytest.approx([tick / 60 for tick in range(6, 121)])
    for moment in ticks:
        assert moment.poses[0] == pytest.approx([2 * moment.time, 5, 0, 0, 0, 0, 1], abs=1e-5)
    assert list(ticks[-1].shapes) == ["red", "green_BASE", "blue_BASE"]
    with pytest.raises(FilmError, match="holds no poses"):
        list(moments(alien(monkeypatch, tmp_path / "blind.mcap", pose_rate=0)))


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("rotation", (0, 0, 0, 0)),
        ("rotation", (0, 0, 0, np.nan)),
        ("rotation", (0, 0, 1e300, 0)),
        ("translation", (np.inf, 0, 0)),
        ("translation", (1e300, 0, 0)),
    ],
)
def test_a_recorded_pose_that_is_none_is_told_as_damage(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, field: str, values: tuple[float, ...]
) -> None:
    """Others write recordings too: in theirs a rotation that was left out is (0, 0, 0, 0)."""
    source = alien(monkeypatch, tmp_path / "alien.mcap").path

    def spoil(lines: list[Line]) -> list[Line]:
        at = first(lines, "/tf", len(lines) // 2)
        message = FrameTransforms.FromString(lines[at].data)
        for axis, value in zip("xyzw", values, strict=False):
            setattr(getattr(message.transforms[1], field), axis, value)
        return changed(lines, at, message.SerializeToString())

    path = rewrite(source, tmp_path / "spoilt.mcap", spoil)
    status, output = run(path, "-o", tmp_path / "x.png")
    assert status == 1
    assert re.search(r"spoilt\.mcap: record \d+: the pose of cube 'green_BASE' is no position and rotation", output)


def test_time_in_a_film_goes_on_over_a_reset(tmp_path: Path) -> None:
    def play(world: World, client: int) -> None:
        send(world, client, type="step", ticks=3)
        send(world, client, type="reset", seed=9)
        send(world, client, type="step", ticks=2)

    ticks = list(moments(Recording(record(tmp_path / "x.mcap", play))))
    assert [(moment.time, moment.seed) for moment in ticks] == [
        (tick / 60, seed) for tick, seed in ((1, 0), (2, 0), (3, 0), (4, 9), (5, 9))
    ]


@pytest.mark.parametrize("ending", ["mp4", "gif"])
def test_a_film_shows_the_cubes_at_their_times(recording: Recording, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"film.{ending}"
    film([recording], path, Cut(camera="fixed", target="red"), fps=10, size=(160, 120))
    images = frames(path)
    assert len(images) == 21
    assert all(image.shape == (120, 160, 3) for image in images)
    columns = [spot[0] for image in images if (spot := place(image, 0)) is not None]
    assert len(columns) == 21
    assert all(before < after for before, after in pairwise(columns))
    if ending == "gif":
        with Image.open(path) as image:
            assert image.info["duration"] == 100 and image.info["loop"] == 0


def test_a_following_camera_keeps_the_moving_cube_in_the_middle(recording: Recording, tmp_path: Path) -> None:
    for camera in ("follow", "orbit"):
        path = tmp_path / "film.gif"
        film([recording], path, Cut(camera=camera, target="red"), fps=5, size=(120, 90))
        for image in frames(path)[1:-1]:
            spot = place(image, 0)
            assert spot is not None and abs(spot[0] - 0.5) < 0.12 and abs(spot[1] - 0.5) < 0.12


def test_the_camera_ignores_distant_cubes_that_do_not_move(recording: Recording, tmp_path: Path) -> None:
    film([recording], tmp_path / "red.png", Cut(end=0.5), size=(120, 90))
    image = frames(tmp_path / "red.png")[0]
    spot = place(image, 0)
    assert spot is not None and abs(spot[0] - 0.5) < 0.1


def test_a_film_may_be_faster_and_a_part(recording: Recording, tmp_path: Path) -> None:
    path = tmp_path / "film.gif"
    film([recording], path, Cut(begin=0.5, end=1.5, speed=0.5), fps=10, size=(32, 32))
    assert len(frames(path)) == 21
    film([recording], path, Cut(speed=4), fps=10, size=(32, 32))
    assert len(frames(path)) == 6
    with pytest.raises(FilmError, match=r"ends at 2\.00 s"):
        film([recording], path, Cut(begin=3))


def test_moments_from_a_time_on_are_the_same_and_begin_at_a_keyframe(tmp_path: Path) -> None:
    """Whoever wants a second of an hour does not wait for the hour; also where the recording goes on from another."""
    whole = Recording(record(tmp_path / "whole.mcap", throw, {**CONFIG, "keyframes": 0.25}))
    world = World(whole.config)
    recorder = fork(whole, world, tmp_path / "later.mcap", 40)
    for _ in range(60):
        world.tick()
    recorder.close()
    for recording in (whole, Recording(tmp_path / "later.mcap")):
        every = [(moment.time, moment.poses.tobytes()) for moment in moments(recording)]
        for begin in (0.0, 0.01, 0.25, 0.26, 0.5, every[-1][0], 9.0):
            part = [(moment.time, moment.poses.tobytes()) for moment in moments(recording, begin)]
            assert part == every[len(every) - len(part) :] and part
            assert part[0][0] <= max(begin, every[0][0])
            if begin > 1.3 or recording is not whole:  # a command of 60 ticks has no keyframe within
                assert part[0][0] > min(begin, every[-1][0]) - 0.3


def test_several_recordings_are_filmed_side_by_side(recording: Recording, tmp_path: Path) -> None:
    path = tmp_path / "grid.png"
    film([recording, recording, recording], path, Cut(target="red"), size=(200, 100))
    image = frames(path)[0]
    assert image.shape == (100, 200, 3)
    quarters = [image[:50, :100], image[:50, 100:], image[50:, :100], image[50:, 100:]]
    assert [place(quarter, 0) is not None for quarter in quarters] == [True, True, True, False]


def test_a_line_over_the_picture_tells_what_it_is_and_when(recording: Recording, tmp_path: Path) -> None:
    def drawn(titles: list[str] | None = None, end: float = 1.0) -> Pixels:
        film([recording], tmp_path / "x.png", Cut(target="red", end=end), titles=titles, size=(240, 160))
        return frames(tmp_path / "x.png")[0].astype(int)

    bare, named = drawn([""]), drawn()
    assert (named[16:] == bare[16:]).all()
    line = named[:16].max(axis=2)
    assert line.max() > 200 and np.median(line) < 130  # letters on a dark line
    assert (named == drawn(["thrown"])).all() and (named != drawn(["#12, score 3.5"])).any()
    later = drawn(end=2.0)
    assert (later[:16, :120] == named[:16, :120]).mean() > 0.9 and (later[:16, 180:] != named[:16, 180:]).any()
    film([recording], tmp_path / "x.png", size=(96, 96))  # too narrow for a line
    small = frames(tmp_path / "x.png")[0]
    film([recording], tmp_path / "x.png", titles=[""], size=(96, 96))
    assert (small == frames(tmp_path / "x.png")[0]).all()


def test_each_recording_of_several_has_its_line(recording: Recording, tmp_path: Path) -> None:
    def drawn(titles: list[str] | None) -> Pixels:
        film([recording] * 2, tmp_path / "x.png", Cut(target="red"), titles=titles, size=(480, 120))
        return frames(tmp_path / "x.png")[0][:16]

    assert (drawn(None) == drawn(["thrown", "thrown"])).all()  # the names of the files
    other = drawn(["thrown", "another"])
    assert (drawn(None)[:, :240] == other[:, :240]).all() and (drawn(None)[:, 240:] != other[:, 240:]).any()


@pytest.fixture(scope="module")
def episodes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Evaluation]:
    """Two seconds of the walker, without and with a target."""
    tasks = {name: Task({**Task.load(name).document, "name": f"short-{name}", "duration": 2}) for name in TASKS}
    folder = str(tmp_path_factory.mktemp("episodes"))
    return {name: evaluate(Genome.load("walker"), task, seeds=[1], record=folder) for name, task in tasks.items()}


TASKS = ("walk", "reach")


def test_the_line_of_an_episode_has_its_score_so_far(episodes: dict[str, Evaluation], tmp_path: Path) -> None:
    walk = episodes["walk"]
    source = Recording(walk.recordings[0])
    caption = Caption.of(source)
    assert caption.title == "walker on short-walk, seed 1" and caption.scores is not None
    assert caption.scores[-1, 1] == walk.results[0].score != caption.scores[60, 1]
    paper = np.zeros((160, 320, 3), np.uint8)
    middle = float(caption.scores[60, 0])
    for row, differs in ((59, False), (60, True), (61, False), (-1, False)):  # the score is that of the moment
        scores = caption.scores.copy()
        scores[row, 1] += 5.0
        changed = Caption(caption.title, scores).draw(paper, middle) != caption.draw(paper, middle)
        assert changed.any() == differs, row
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(source.path.read_bytes()[: -source.path.stat().st_size // 3])
    torn = Caption.of(Recording(cut))
    assert torn.scores is None and torn.title == "walker on short-walk, seed 1 (no score: damaged)"


def test_a_flag_stands_at_the_target_of_a_creature(episodes: dict[str, Evaluation], tmp_path: Path) -> None:
    red = {}
    for name in TASKS:
        source = Recording(episodes[name].recordings[0])
        try:
            film([source], tmp_path / "x.png", titles=[""], size=(320, 240))
        except WorldError as error:
            pytest.skip(f"no picture to judge: {error.message}")
        image = frames(tmp_path / "x.png")[0].astype(int)
        red[name] = int((image[..., 0] - image[..., 1:].max(axis=2) > 80).sum())
    assert red["walk"] == 0 and red["reach"] > 20
    assert list(moments(Recording(episodes["reach"].recordings[0])))[-1].targets == (
        Task({**Task.load("reach").document, "name": "short-reach", "duration": 2}).target(1),
    )


def test_cubes_without_a_colour_are_told_apart(recording: Recording, tmp_path: Path) -> None:
    def play(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="one", position=[-1, 1, 0])
        send(world, client, type="spawn_cube", cube_name="two", position=[1, 1, 0])
        send(world, client, type="spawn_cube", cube_name="grey", position=[0, 3, 0], color=[0.8, 0.8, 0.79])
        send(world, client, type="step")

    source = Recording(record(tmp_path / "plain.mcap", play, CONFIG))
    colors = {name: color for name, (_, color, _) in visible_shapes(list(moments(source))[-1].shapes).items()}
    assert colors["grey"] == (0.8, 0.8, 0.79, 1.0)
    assert np.ptp(colors["one"][:3]) > 0.15 and np.ptp(colors["two"][:3]) > 0.15 and colors["one"] != colors["two"]
    film([source], tmp_path / "x.png", titles=[""], size=(160, 120))
    image = frames(tmp_path / "x.png")[0].astype(int)
    assert (np.ptp(image[40:], axis=2) > 35).sum() > 200  # coloured, below the sky


def test_a_planar_world_is_filmed_from_its_front(tmp_path: Path, recording: Recording) -> None:
    def play(world: World, client: int) -> None:
        send(world, client, type="spawn_cube", cube_name="a", position=[-2, 2, 0], color=[1, 0, 0])
        send(world, client, type="spawn_cube", cube_name="b", position=[2, 2, 0], color=[0, 0, 1])
        send(world, client, type="step")

    path = record(tmp_path / "flat.mcap", play, {"backend": "pymunk", "gravity": [0, 0, 0]})
    film([Recording(path)], tmp_path / "flat.png", size=(160, 120))
    image = frames(tmp_path / "flat.png")[0]
    red, blue = place(image, 0), place(image, 2)
    assert red is not None and blue is not None
    assert red[0] == pytest.approx(1 - blue[0], abs=0.02) and red[1] == pytest.approx(blue[1], abs=0.02)


def test_a_film_that_fails_leaves_the_old_file(recording: Recording, tmp_path: Path) -> None:
    path = tmp_path / "film.gif"
    path.write_text("old")

    def interrupt(doing: str, done: int, total: int) -> None:
        if doing == "drawing" and done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        film([recording], path, fps=5, size=(32, 32), progress=interrupt)
    assert path.read_text() == "old"
    assert list(tmp_path.glob(".*")) == []


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(main, ["render", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def test_nmes_render_writes_films_and_pictures(recording: Recording, tmp_path: Path) -> None:
    path = tmp_path / "film.gif"
    status, output = run(recording.path, "-o", path, "--size", "64x48", "--fps", 5, "--to", "1s", "--camera", "orbit")
    assert (status, output) == (0, f"wrote {path}\n")
    assert len(frames(path)) == 6


def test_wrong_usage_is_explained(thrown: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(thrown.path, "-o", tmp_path / "x.avi") == (
        1,
        f"Error: {tmp_path / 'x.avi'}: a film ends in .mp4 or .gif, a picture in .png\n",
    )
    status, output = run(thrown.path, "-o", tmp_path / "x.gif", "--target", "purple")
    assert status == 1 and "no cube's name begins with 'purple' (there are: red, green_BASE, blue_BASE)" in output
    status, output = run(thrown.path, "-o", tmp_path / "none" / "x.gif")
    assert status == 1 and "there is no folder" in output
    status, output = run(thrown.path, "-o", tmp_path / "x.gif", "--size", "big")
    assert status == 2 and "WIDTHxHEIGHT" in output
    monkeypatch.setitem(sys.modules, "av", None)
    status, output = run(thrown.path, "-o", tmp_path / "x.mp4")
    assert status == 1 and "nmes[film]" in output


def test_without_opengl_the_message_names_what_to_install(
    thrown: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nmes.backends.mujoco3d.rendering.opengl_context", lambda: None)
    with pytest.raises(WorldError, match="libegl1 or libosmesa6"):
        film([thrown], tmp_path / "x.png")
    assert not (tmp_path / "x.png").exists()
