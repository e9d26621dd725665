"""The genomes that ship with the package do what they say; and `nmes genome`, and the pictures, on them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from PIL import Image

from layout import ROOT
from nmes import World
from nmes.cli import main
from nmes.genome import Genome
from nmes.genome.preview import grid_step, render_body, render_text, sheet
from nmes.genome.sensors import Flaws

NAMES = Genome.names()
FRICTIONS = (0.8, 1.2)


def live(name: str, friction: float, brain: bool = True, seconds: float = 10) -> tuple[Genome, Any]:
    """Lets a creature live; returns its genome and its cubes' states, shape (ticks + 1, cubes, 13)."""
    genome = Genome.load(name)
    world = World({"mode": "lockstep", "friction": friction})
    client = world.join()
    assert world.execute(client, {"type": "spawn_creature", "genome": genome.document, "name": "c"})["creature"] == "c"
    creature, mind = world.creature("c"), genome.brain()
    mind.reset(seed=1, dt=1 / 60)
    states = [world.poses()[1]]
    for _ in range(round(60 * seconds)):
        if brain:
            world.drive(client, "c", mind.step(creature.sense()))
        world.tick()
        states.append(world.poses()[1])
    assert world.fault is None
    return genome, np.array(states)


def travel(genome: Genome, states: Any) -> Any:
    """Returns how far the centre of mass has come, (x, y, z) in m."""
    mass = np.array([cube.mass for cube in genome.body.cubes])
    middle = (states[:, :, :3] * mass[:, None]).sum(axis=1) / mass.sum()
    return middle[-1] - middle[0]


def uprightness(states: Any, cube: int) -> Any:
    """Returns at each tick how much of a cube's own up is up: 1 upright, -1 on its head."""
    x, z = states[:, cube, 3], states[:, cube, 5]
    return 1 - 2 * (x * x + z * z)


def test_genomes_of_many_kinds_are_shipped() -> None:
    documents = [Genome.load(name).document for name in NAMES]
    assert len(NAMES) == 24
    assert {document["brain"]["kind"] for document in documents} == {"sine", "cpg", "mlp", "ctrnn", "graph"}
    assert sum("graph" in document["body"] for document in documents) >= 2
    assert [document["name"] for document in documents] == list(NAMES)
    for document in documents:
        assert document["author"] and document["license"] == "Apache-2.0" and document["description"].endswith(".")
    page = (ROOT / "docs" / "genomes.md").read_text()
    for name, document in zip(NAMES, documents, strict=True):
        row = next(line for line in page.splitlines() if line.startswith(f"| `{name}` |"))
        assert f"`{document['brain']['kind']}`" in row
        assert ("*grown*" in row) == ("graph" in document["body"])


@pytest.mark.parametrize(
    ("name", "least", "upright"),
    [
        ("walker", 12, 0.9),
        ("biped", 2, 0.7),
        ("centipede", 8, 0.9),
        ("inchworm", 3, 0.3),
        ("lurcher", 3, 0.3),
        ("roller", 10, 0.95),
    ],
)
@pytest.mark.parametrize("friction", FRICTIONS)
def test_walkers_crawlers_and_carts_get_ahead_and_keep_upright(
    name: str, least: float, upright: float, friction: float
) -> None:
    genome, states = live(name, friction)
    x, _, z = travel(genome, states)
    assert x > least
    assert abs(z) < 0.5 * x
    assert uprightness(states, 0).min() > upright


@pytest.mark.parametrize("friction", FRICTIONS)
def test_the_biped_lifts_its_feet_by_turns(friction: float) -> None:
    genome, states = live("biped", friction)
    parts = [cube.id for cube in genome.body.cubes]
    heights = [states[120:, parts.index(f"{side}_foot"), 1] - 0.03 for side in ("left", "right")]
    up, other = (height > 0.01 for height in heights)
    assert up.any() and other.any()
    assert ((up & ~other).mean() > 0.1) and ((other & ~up).mean() > 0.1)


@pytest.mark.parametrize("friction", FRICTIONS)
def test_the_tumbler_rolls(friction: float) -> None:
    genome, states = live("tumbler", friction)
    assert travel(genome, states)[0] > 4
    assert uprightness(states, 0).min() < -0.95  # over its head, and upright again
    turns = int((np.diff(np.sign(uprightness(states, 0))) != 0).sum())
    assert turns >= 5


@pytest.mark.parametrize("friction", FRICTIONS)
def test_the_sidewinder_undulates_over_the_ground(friction: float) -> None:
    genome, states = live("sidewinder", friction)
    x, _, z = travel(genome, states)
    assert abs(z) > 10 and abs(z) > 2 * abs(x)  # it lies along x
    # Its cubes go up and down one after the other, a little.
    heights = states[120:, :, 1]
    assert 0.01 < np.ptp(heights, axis=0).min() and np.ptp(heights, axis=0).max() < 0.3


@pytest.mark.parametrize("friction", FRICTIONS)
def test_the_jumper_jumps_again_and_again(friction: float) -> None:
    genome, states = live("jumper", friction)
    foot = [cube.id for cube in genome.body.cubes].index("foot")
    height = states[:, foot, 1] - 0.03
    assert height.max() > 0.8
    assert (np.diff((height > 0.3).astype(int)) == 1).sum() >= 5
    assert uprightness(states, foot).min() > 0.8


@pytest.mark.parametrize("friction", FRICTIONS)
def test_the_balancer_keeps_its_pole_upright(friction: float) -> None:
    genome, states = live("balancer", friction)
    pole = [cube.id for cube in genome.body.cubes].index("pole")
    assert uprightness(states, pole).min() > 0.98
    _, idle = live("balancer", friction, brain=False, seconds=5)
    assert uprightness(idle, pole).min() < 0


# -- the command line -------------------------------------------------------------------------------------------------


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["genome", *arguments])


@pytest.fixture
def bad(tmp_path: Path) -> Path:
    document = Genome.load("jumper").document
    document["body"]["joints"][0]["cube1"] = "legg"
    document["body"]["cubes"][0]["position"][1] = 0
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(document))
    return path


def test_check_reports_all_mistakes(bad: Path) -> None:
    done = run("check", "walker", str(bad))
    assert done.exit_code == 1
    lines = done.output.splitlines()
    assert lines[0] == "walker: good"
    assert any(line.startswith("  body/joints/0/cube1: there is no cube 'legg'; did you mean leg?") for line in lines)
    assert any("below the ground" in line for line in lines)
    assert "Traceback" not in done.output
    (row,) = json.loads(run("check", str(bad), "--json").output)
    assert row["problems"][0]["path"].startswith("body/")
    assert run("check", *NAMES).exit_code == 0


def test_check_reports_mistakes_of_the_brain(tmp_path: Path) -> None:
    document = Genome.load("jumper").document
    document["brain"]["oscillators"][0]["motor"] = "nothing"
    path = tmp_path / "x.json"
    path.write_text(json.dumps(document))
    done = run("check", str(path))
    assert (done.exit_code, "brain/oscillators/0/motor: there is no motor 'nothing'" in done.output) == (1, True)


def test_directories_and_patterns_stand_for_their_files(tmp_path: Path) -> None:
    for name in ("walker", "roller"):
        (tmp_path / f"my-{name}.json").write_text(json.dumps(Genome.load(name).document))
    (tmp_path / "notes.txt").write_text("no genome")
    for argument in (str(tmp_path), str(tmp_path / "*.json")):
        rows = json.loads(run("check", argument, "--json").output)
        assert [row["name"] for row in rows] == ["roller", "walker"]
    empty = tmp_path / "empty"
    empty.mkdir()
    for argument in (str(empty), str(tmp_path / "x*.json"), str(tmp_path / "missing.json")):
        done = run("check", argument)
        assert (done.exit_code, "there is no" in done.output) == (2, True)
    assert run("check").exit_code == 2


def test_show_tables_the_body_and_draws_it() -> None:
    done = run("show", "centipede")
    assert done.exit_code == 0
    for part in ("leg.3.mirror", "position, -0.6 to 0.6 rad, 20 N m", "head.target_direction.z", "brain: cpg", "@@"):
        assert part in done.output
    (about,) = json.loads(run("show", "centipede", "--json").output)
    assert len(about["cubes"]) == 21 and about["generative"] and len(about["motors"]) == 19


def test_show_draws_one_large_and_many_on_a_sheet(tmp_path: Path) -> None:
    one, many = tmp_path / "one.png", tmp_path / "many.png"
    assert run("show", "roller", "-o", str(one)).exit_code == 0
    assert run("show", "roller", "walker", "jumper", "-o", str(many)).exit_code == 0
    with Image.open(one) as picture:
        assert picture.size == (720, 540)
    with Image.open(many) as picture:
        assert picture.size[0] > 2 * 320 and picture.size[1] > 2 * 260
    done = run("show", "roller", "-o", str(tmp_path / "no" / "one.png"))
    assert (done.exit_code, "cannot write" in done.output) == (1, True)


def test_expand_writes_a_valid_genome(tmp_path: Path) -> None:
    expanded = Genome.parse(run("expand", "centipede").output.encode())
    assert expanded.body == Genome.load("centipede").body
    assert "graph" not in expanded.document["body"]
    assert run("expand", "centipede", "inchworm", "-o", str(tmp_path / "out")).exit_code == 0
    assert Genome.load(tmp_path / "out" / "inchworm.json").body == Genome.load("inchworm").body
    assert run("expand", "centipede", "-o", str(tmp_path / "c.json")).exit_code == 0
    assert (tmp_path / "c.json").exists()


# -- pictures ---------------------------------------------------------------------------------------------------------


def document(*cubes: dict[str, Any]) -> Genome:
    joints = [
        {"id": f"j{i}", "cube1": cubes[0]["id"], "cube2": cube["id"], "type": "fixed", "anchor": [0, 1, 0]}
        for i, cube in enumerate(cubes[1:])
    ]
    return Genome({"format": "nmes-genome/1", "name": "x", "body": {"cubes": list(cubes), "joints": joints}})


RED, BLUE = [1, 0, 0], [0, 0, 1]


def test_near_boxes_hide_far_ones_in_a_picture() -> None:
    """The eye is at the front right and above: a wall of blue before a red one, and behind it."""
    wall = {"size": [1, 1, 0.1], "mass": 1}
    red = {"id": "red", "position": [0, 0.5, 0], "color": RED, **wall}

    def blueness(z: float) -> tuple[int, int]:
        blue = {"id": "blue", "position": [0, 0.5, z], "color": BLUE, **wall}
        pixels = render_body(document(red, blue).body, 200, 150).astype(int)
        strong = [(pixels[..., a] > 60) & (pixels[..., a] > 2 * pixels[..., b]) for a, b in ((2, 0), (0, 2))]
        return int(strong[0].sum()), int(strong[1].sum())

    before, behind = blueness(0.3), blueness(-0.3)
    assert before[0] > 2 * before[1] and behind[1] > 2 * behind[0]


def test_intersecting_boxes_are_both_visible_in_a_picture() -> None:
    body = document(
        {"id": "red", "position": [0, 0.5, 0], "size": [1, 0.4, 0.4], "mass": 1, "color": RED},
        {"id": "blue", "position": [0, 0.5, 0], "size": [0.4, 1, 0.4], "mass": 1, "color": BLUE},
    ).body
    pixels = render_body(body, 200, 150).astype(int)
    reds, blues = (
        np.argwhere((pixels[..., a] > 60) & (pixels[..., a] > 2 * pixels[..., b])) for a, b in ((0, 2), (2, 0))
    )
    assert len(reds) > 300 and len(blues) > 300
    assert reds[:, 1].min() < blues[:, 1].min() and reds[:, 1].max() > blues[:, 1].max()


def test_pictures_fill_their_frame_and_are_the_same_every_time() -> None:
    for name in NAMES:
        body = Genome.load(name).body
        pixels = render_body(body, 160, 120)
        assert (pixels == render_body(body, 160, 120)).all()
        dark = np.argwhere(pixels.min(axis=2) < 200)
        low, high = dark.min(axis=0), dark.max(axis=0)
        assert (low > 2).all() and (high < (117, 157)).all()  # nothing is cut off
        assert max((high - low) / (120, 160)) > 0.7  # and no room is wasted
        lines = render_text(body)
        assert any(lines) and max(map(len, lines)) <= 72 and len(lines) == 22


def test_the_grid_is_a_round_number_of_metres() -> None:
    steps = {name: grid_step(Genome.load(name).body) for name in NAMES}
    assert steps["walker"] == 0.1 and steps["balancer"] == 0.5
    assert set(steps.values()) <= {0.05, 0.1, 0.2, 0.5}


def test_what_is_not_there_at_birth_is_drawn_paler_and_told_on_the_card() -> None:
    document = Genome.load("jumper").document
    rules = [{"when": "age > 1", "grow": ["foot"]}]
    late = Genome({**document, "later": ["foot"], "development": rules})
    plain, paler = (render_body(each.body, 160, 120).astype(int) for each in (Genome(document), late))
    assert (paler >= plain).all() and (paler > plain + 40).any() and (paler == plain).any()
    card = late._repr_html_()
    assert "not there at birth" in card and "rules of development" in card
    assert "birth" not in Genome(document)._repr_html_()


def test_a_sheet_has_room_for_long_and_strange_names() -> None:
    body = Genome.load("jumper").body
    assert sheet([("x" * 100, body), ("ßé漢字", body), ("", body)], 120, 90).shape[2] == 3


# -- the page ---------------------------------------------------------------------------------------------------------


def require_wings(development: Any) -> None:
    """Requires that a creature develops as the page says of its rules: a wing grows, grows again, and is enlarged."""
    trunk = {"id": "trunk", "size": 0.2, "mass": 1, "position": [0, 0.1, 0]}
    wing = {"id": "wing", "size": 0.2, "mass": 1, "position": [0, 0.1, 0.25]}
    joint = {"id": "wing", "type": "fixed", "cube1": "trunk", "cube2": "wing", "anchor": [0, 0.1, 0.1]}
    document = {"format": "nmes-genome/1", "name": "bird", "body": {"cubes": [trunk, wing], "joints": [joint]}}
    world = World({"mode": "lockstep", "gravity": [0, 0, 0]})
    client = world.join()

    def wings(seconds: float, **command: Any) -> list[float]:
        """Lets time pass, and sends a command; returns the lengths of the wings that there are."""
        assert world.execute(client, {"type": "step", "ticks": round(seconds * 60)})["type"] != "error"
        if command:
            assert world.execute(client, command)["type"] != "error"
        cubes = world.creature("b").cubes
        return [world.entities.cubes[cubes["wing"]].size[0]] if "wing" in cubes else []

    spawn = {"type": "spawn_creature", "genome": {**document, **development}, "name": "b", "autonomous": False}
    assert world.execute(client, spawn)["type"] != "error"
    assert world.execute(client, {"type": "drive", "creature": "b", "controls": []})["type"] != "error"
    assert wings(1.9) == [] and wings(0.3) == [0.2]
    assert wings(1.0, type="shed", creature="b", part="wing") == []
    for cube in [name for name in world.entities.cubes if name.startswith("b.wing")]:
        world.execute(client, {"type": "despawn_cube", "cube_name": cube})
    assert wings(0.3) == [0.2]
    up = {"cube_name": "b.trunk", "impulse": [0, 5, 0]}
    assert wings(1.0, type="apply_physics", **up) == [0.2]
    assert wings(3.0) == [pytest.approx(0.3)]


def test_the_examples_of_the_page_work() -> None:
    page = (ROOT / "docs" / "genomes.md").read_text()
    examples = re.findall(r"^```json\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)
    whole, sensors, seen, flawed, talk, config, young, rules, body = examples
    hopper = Genome.parse(whole.encode())
    assert [motor.id for motor in hopper.body.motors] == list(hopper.brain().outputs) == ["leg"]
    head = {"format": "nmes-genome/1", "name": "grown"}
    grown = Genome({**head, **json.loads(f"{{{body}}}")})
    names = [cube.id for cube in grown.body.cubes]
    assert names.count("head") == 1 and {"leg.4", "leg.4.mirror", "segment.4"} <= set(names)
    readings = Genome({**hopper.document, **json.loads(f"{{{sensors}}}")}).body.sensors
    assert [sensor.id for sensor in readings] == [
        "leg.position", "torso.up.x", "torso.up.y", "torso.up.z", "foot.touch", "tilt",
    ]  # fmt: skip
    watcher = Genome({**hopper.document, **json.loads(f"{{{seen}}}")}).body.sensors
    assert (watcher[0].id, watcher[-2].id, watcher[-1].id) == ("torso.camera.1.1.r", "torso.camera.4.8.b", "below")
    assert Genome({**hopper.document, **json.loads(f"{{{flawed}}}")}).body.sensors[0].flaws == Flaws(0.02, 2, 0.01)
    later = json.loads(f"{{{young}}}")["later"]
    cubes = [
        {"id": name, "size": 0.2, "mass": 1, "position": [0, 0.1, z]}
        for name, z in zip(["trunk", *later], (0, 1, -1), strict=True)
    ]
    joints = [
        {"id": f"to.{name}", "type": "fixed", "cube1": "trunk", "cube2": name, "anchor": [0, 0.1, 0]} for name in later
    ]
    fledgling = Genome({**head, "body": {"cubes": cubes, "joints": joints}, "later": later}).body
    assert [cube.id for cube in fledgling.cubes] == ["trunk", *later] and set(fledgling.later) == {*later}
    require_wings(json.loads(f"{{{rules}}}"))
    talker = Genome({**hopper.document, **json.loads(f"{{{talk}}}")}).body
    assert [voice.id for voice in talker.voices] == ["say.alarm", "east", "say.map.2"] and len(talker.sensors) == 2
    assert {voice.channel for voice in talker.voices} == World(json.loads(config)).channels.channels.keys()
    (code,) = re.findall(r"^```python\n(.*?)^```", page, flags=re.DOTALL | re.MULTILINE)
    names_of_the_code: dict[str, Any] = {}
    exec(compile(code, "docs/genomes.md", "exec"), names_of_the_code)
    assert names_of_the_code["world"].cube_shape("w.torso") and names_of_the_code["world"].poses()[1][0, 0] > 5
