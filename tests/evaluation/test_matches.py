"""Matches: creatures that meet in one world, what each is worth, who has lost by rule, and what recordings prove."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from creatures import SINE, cpg, exploding, mlp, snake
from duels import duel, push, roles
from nmes.errors import ProofError, SimulationFault, WorldError
from nmes.evaluation import Match, MatchTask, Task, brain_of, evaluate, play, prove, prove_match
from nmes.evaluation.judge import Result
from nmes.evaluation.match import match_metadata
from nmes.evaluation.steps import perform
from nmes.genome import Genome
from nmes.playback import replay
from nmes.protocol import parse
from nmes.recording import Recorder
from nmes.world import World

QUIET = snake(None)
ZERO = (0.0, 0.0, 0.0)


def centre(world: World, role: str) -> np.ndarray[Any, Any]:
    """Where a creature's centre of mass is, m, asked of the world cube by cube."""
    creature = world.creature(role)
    states = world.simulation.states([world.entities.cube(name).body for name in creature.cubes.values()])
    masses = np.array([cube.mass for cube in creature.body.cubes])
    return np.asarray(masses @ states[:, :3] / masses.sum())


def place(world: World, cube: str) -> tuple[float, ...]:
    """Where a cube is, m."""
    return world.simulation.body_state(world.entities.cube(cube).body).position


def run_by_hand(task: MatchTask, red: dict[str, Any], blue: dict[str, Any], seed: int = 3) -> tuple[World, Match]:
    """Runs a match in a world that is there to be asked when it is over."""
    genomes = {"red": Genome(red), "blue": Genome(blue)}
    world = World(task.world_config(seed))
    match = Match(world, genomes, {role: brain_of(genome) for role, genome in genomes.items()}, task, seed)
    perform(world, world.join(), match.steps())
    return world, match


@pytest.mark.parametrize("brain", [SINE, cpg(4), mlp(4), None], ids=["sine", "cpg", "mlp", "none"])
def test_a_recording_proves_the_scores_that_playing_gave(brain: dict[str, Any] | None, tmp_path: Path) -> None:
    genomes = {"red": snake(brain), "blue": push()}
    first, second = play(duel(), genomes), play(duel(), genomes, record=tmp_path)
    assert [match.results for match in first] == [match.results for match in second]
    assert [result.ticks for result in first[0].results.values()] == [90, 90]
    assert first[0].results["red"].score != first[1].results["red"].score
    for match in second:
        assert match.recording is not None and replay(match.recording).verdict == "reproduced"
        for compared in (False, True):
            proof = prove_match(match.recording, brain=compared)
            assert (dict(proof.results), proof.seed) == (match.results, match.seed)
        assert {role: genome.hash for role, genome in proof.genomes.items()} == {
            role: Genome(genome).hash for role, genome in genomes.items()
        }


def test_scores_are_what_the_world_says_at_the_end() -> None:
    task = duel(**roles({"objective": "red.apart.blue"}, {"objective": "blue.displacement.x"}))
    world, match = run_by_hand(task, push(), snake())
    red, blue = centre(world, "red"), centre(world, "blue")
    scores = {role: result.score for role, result in match.results().items()}
    assert scores["red"] == pytest.approx(math.dist(red, blue), abs=1e-9)
    assert scores["blue"] == pytest.approx(blue[0] - 1.0, abs=0.02)  # but for what it moved while it settled


def test_a_creature_is_set_down_with_its_centre_of_mass_in_its_place_however_it_is_turned() -> None:
    lopsided = snake(None)
    lopsided["body"]["cubes"][3]["mass"] = 3.0
    for turn in (0.0, 1.0, -2.0):
        task = duel(duration=0.1, vary={}, **roles({"heading": turn, "position": [-2, 0.5, 1]}, {}))
        world = World(task.world_config(3))
        match = Match(world, {"red": Genome(lopsided), "blue": Genome(push())}, {}, task, 3)
        steps, client = match.steps(), world.join()
        for step in steps:
            if step is None:
                break
            assert isinstance(step, bytes)
            world.handle(client, parse(step))
        x, _, z = centre(world, "red")
        assert (x, z) == pytest.approx((-2, 1), abs=1e-9)
        head, root = (place(world, f"red.{cube}") for cube in ("c3", "c0"))
        assert math.atan2(-(head[2] - root[2]), head[0] - root[0]) == pytest.approx(turn)
        assert min(place(world, f"red.c{i}")[1] for i in range(4)) == pytest.approx(0.57)


def test_a_target_that_is_another_role_is_its_root_wherever_that_goes() -> None:
    seeing = snake()
    seeing["sensors"] = [{"type": "target_distance", "cube": "c0"}]
    world, _ = run_by_hand(duel(), seeing, push())
    head, other = (place(world, cube) for cube in ("red.c0", "blue.trunk"))
    assert world.creature("red").sense()[0] == pytest.approx(math.dist(head, other))
    assert math.dist(head, other) < 2.4  # and it has come nearer since the start, when it was 2.54 m


def test_a_touch_is_seen_at_its_tick_and_what_comes_after_is_measured_from_there() -> None:
    ways = {"objective": "max.red.touching.blue"}, {"objective": "blue.after_touch.red.x"}
    task = duel(duration=2.5, vary={}, **roles(ways[0], ways[1]))
    light = snake(None)
    for cube in light["body"]["cubes"]:
        cube["mass"] = 0.05
    genomes = {"red": Genome(push(9.0)), "blue": Genome(light)}
    world = World(task.world_config(3))
    match = Match(world, genomes, {"red": brain_of(genomes["red"]), "blue": None}, task, 3)
    client, touched_at, places = world.join(), None, []
    for step in (steps := match.steps()):
        if step is None:
            world.tick()
            bodies = {world.entities.cube(name).body for name in world.creature("blue").cubes.values()}
            reds = [world.entities.cube(name).body for name in world.creature("red").cubes.values()]
            touch = any(c.other in bodies for number in reds for c in world.simulation.contacts(number))
            if touch and touched_at is None:
                touched_at = centre(world, "blue")[0]
            places.append(centre(world, "blue")[0])
        elif isinstance(step, bytes):
            world.handle(client, parse(step))
        else:
            world.drive(client, step.creature, step.controls)
    steps.close()
    results = match.results()
    assert touched_at is not None and results["red"].score == 1.0
    assert results["blue"].score == pytest.approx(places[-1] - touched_at, abs=1e-9)
    assert abs(places[-1] - touched_at) > 0.05
    apart = play(task, {"red": push(-9.0), "blue": QUIET}, seeds=[3])[0].results
    assert (apart["red"].score, apart["blue"].score) == (0.0, 0.0)


def test_a_condition_ends_the_match_for_all_at_its_tick() -> None:
    task = duel(duration=4, ends=[{"name": "met", "when": "red.touching.blue > 0 || red.apart.blue < 0.9"}])
    results = play(task, {"red": push(8.0), "blue": push(8.0)}, seeds=[3])[0].results
    assert {result.ended for result in results.values()} == {"met"}
    assert len({result.ticks for result in results.values()}) == 1 and results["red"].ticks < 240


def test_who_was_struck_before_is_not_blamed_for_energy_that_the_other_makes() -> None:
    _, match = run_by_hand(duel(vary={}), push(), QUIET)
    referee = match._referee
    assert referee is not None
    columns, speeds = (
        dict(zip(("red", "blue"), referee._columns, strict=False)),
        {"red": np.zeros(91), "blue": np.zeros(91)},
    )
    speeds["blue"][10:] = 10.0  # of the work of red, which has it back from the solver a second later
    speeds["red"][70:] = 5.0
    energy = {}
    for role, part in columns.items():
        referee._states[:, part, 7] = speeds[role][:, None]
        energy[role] = referee.trajectories.of[role].bodies.masses.sum() * speeds[role] ** 2 / 2
    referee._powers[:] = 0.0
    referee._powers[10, 0, 0] = referee._powers[10, 1, 0] = energy["blue"][10] * 60
    assert energy["blue"].max() > energy["red"].max()
    assert referee.results({})["red"].ended == "red: energy of nothing"


def test_props_stand_in_the_world_and_can_be_aimed_at_and_measured() -> None:
    ball = {"id": "ball", "size": [0.2, 0.2, 0.2], "mass": 0.5, "position": [0, 0, 0.5]}
    red = {"target": "ball", "objective": "red.distance - red.apart.ball"}
    task = duel(props=[ball], **roles(red, {"objective": 'cube("ball").displacement.x'}))
    world, match = run_by_hand(task, push(), QUIET)
    assert world.creature("red").target == "ball"
    assert match.results()["red"].score == 0.0
    assert abs(match.results()["blue"].score or 0.0) < 1e-3  # nobody came near it
    assert place(world, "ball")[1] == pytest.approx(0.1, abs=0.01)


# -- rules -----------------------------------------------------------------------------------------------------------


def test_who_is_beyond_a_limit_of_its_role_has_lost_and_the_other_has_its_score() -> None:
    worker = push(9.0)
    task = duel(limits={"energy": 1e6}, **roles({"limits": {"energy": 2}}, {}))
    results = play(task, {"red": worker, "blue": worker}, seeds=[3])[0].results
    assert results["red"].score is None and "beyond its limit of energy" in str(results["red"].fault)
    assert results["blue"].fault is None and results["blue"].score is not None
    assert {result.ended for result in results.values()} == {"red: energy"}
    assert results["red"].energy <= 2.0 and results["red"].ticks == results["blue"].ticks < 90


def test_both_lose_who_are_beyond_a_limit_at_one_tick() -> None:
    task = duel(limits={"energy": 0.0})
    match = play(task, {"red": push(9.0), "blue": push(9.0)}, seeds=[3])[0]
    assert [result.score for result in match.results.values()] == [None, None]
    assert {result.ended for result in match.results.values()} == {"red: energy, blue: energy"}


def swatter() -> dict[str, Any]:
    """A heavy base with a bar that it spins at 95 rad/s, no cube of which is ever fast."""
    base = {"id": "base", "size": [0.6, 0.3, 0.6], "mass": 300, "position": [0, 0.15, 0]}
    bar = {"id": "bar", "size": [1.9, 0.1, 0.1], "mass": 20, "position": [0, 0.36, 0]}
    motor = {"mode": "velocity", "range": [-95, 95], "max_effort": 600}
    spin = {"type": "hinge", "anchor": [0, 0.3, 0], "axis": [0, 1, 0], "motor": motor}
    joint = {"id": "spin", "cube1": "base", "cube2": "bar", **spin}
    turns = {"kind": "sine", "oscillators": [{"motor": "spin", "frequency": 0, "amplitude": 0, "offset": 1}]}
    body = {"cubes": [base, bar], "joints": [joint]}
    return {"format": "nmes-genome/1", "name": "swatter", "body": body, "brain": turns}


def test_who_is_struck_so_hard_that_it_is_beyond_a_limit_goes_on() -> None:
    task, speeds = MatchTask.load("interference"), [0.0]

    def look(world: World) -> None:
        numbers = [world.entities.cube(cube).body for cube in world.creature("robot").cubes.values()]
        if world.frame > 0:
            speeds.extend(np.linalg.norm(world.simulation.states(numbers)[:, 7:10], axis=1))

    results = attended(task, {"robot": Genome.load("seeker"), "interferer": Genome(swatter())}, 1, look)
    assert max(speeds) > task.roles["robot"].bounds["speed"]
    assert {(result.fault, result.ended, result.ticks) for result in results.values()} == {(None, None, 900)}


@pytest.mark.parametrize("limits", [{"spin": 5}, {"speed": 0.3}], ids=str)
def test_who_makes_itself_too_fast_has_lost_whoever_is_beside_it(limits: dict[str, float]) -> None:
    task = duel(vary={}, limits=limits, **roles({}, {"position": [0.45, 0, 0]}))
    results = play(task, {"red": push(9.0), "blue": QUIET}, seeds=[3])[0].results
    assert str(results["red"].fault) == f"beyond: it was beyond its limit of {next(iter(limits))}"
    assert results["blue"].fault is None and results["blue"].score is not None


@pytest.mark.parametrize("loser", ["red", "blue"])
def test_who_makes_energy_of_nothing_has_lost(loser: str) -> None:
    genomes = {"red": snake(), "blue": snake(), loser: exploding()}
    results = play(duel(vary={}), genomes, seeds=[3])[0].results
    other = results["blue" if loser == "red" else "red"]
    assert results[loser].score is None and str(results[loser].fault).startswith("energy: by 0.03 s")
    assert {result.ended for result in results.values()} == {f"{loser}: energy of nothing"}
    _, match = run_by_hand(duel(vary={}), genomes["red"], genomes["blue"])
    assert match.results() == match.results() == results
    assert other.score is not None and other.fault is None


def attended(
    task: MatchTask, genomes: dict[str, Genome], seed: int, look: Callable[[World], None]
) -> dict[str, Result]:
    """Returns how a match comes out in a world that is there to be looked at before each tick."""
    world = World(task.world_config(seed))
    match = Match(world, genomes, {role: brain_of(genome) for role, genome in genomes.items()}, task, seed)
    client = world.join()
    for step in match.steps():
        if step is None:
            look(world)
            world.tick()
        elif isinstance(step, bytes):
            world.handle(client, parse(step))
        else:
            world.drive(client, step.creature, step.controls)
    assert match.results() == match.results()
    return match.results()


def meddled(task: MatchTask, frame: int, meddle: Callable[[World], None]) -> dict[str, Result]:
    """Returns how a match of two carts comes out where something is done to their world at a frame."""
    genomes = {"red": Genome(push()), "blue": Genome(push())}
    return attended(task, genomes, 3, lambda world: meddle(world) if world.frame == frame else None)


START, LATER = 3, 60  # frames before the start of a duel, and after it


def shove(**impulses: float) -> Callable[[World], None]:
    """Returns what pushes the first cube of each role along z, N s, in the next tick."""

    def meddle(world: World) -> None:
        for role, impulse in impulses.items():
            cube = world.entities.cube(next(iter(world.creature(role).cubes.values())))
            world.simulation.apply(cube.body, ZERO, ZERO, (0.0, 0.0, impulse), ZERO)

    return meddle


@pytest.mark.parametrize("frame", [START, LATER])
@pytest.mark.parametrize(("culprit", "loser"), [("red.w1", "red"), ("blue.w2", "blue"), (None, None), ("ball", None)])
def test_over_whose_cube_the_engine_fails_has_lost(
    culprit: str | None, loser: str | None, frame: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def meddle(world: World) -> None:
        def fail(substeps: int) -> None:
            body = None if culprit is None else world.entities.cube(culprit).body
            raise SimulationFault("diverged", "it is off", body)

        monkeypatch.setattr(world.simulation, "step", fail)

    ball = {"id": "ball", "size": [0.2, 0.2, 0.2], "mass": 1, "position": [0, 0, 3]}
    for role, result in meddled(duel(props=[ball]), frame, meddle).items():
        assert (result.score is None) == (role == loser or loser is None)
        assert str(result.fault).startswith("diverged: it is off") == (result.score is None)
        assert 0 < result.ticks < 90 if frame == LATER else result.ticks == 0
        assert frame == LATER or result.score in (None, 0.0)  # as it was at the start


@pytest.mark.parametrize("frame", [START, LATER])
@pytest.mark.parametrize(("loser", "other"), [("red", "blue"), ("blue", "red")])
def test_who_breaks_the_engine_has_lost_even_where_all_are_no_numbers_in_the_end(
    loser: str, other: str, frame: int
) -> None:
    results = meddled(duel(), frame, shove(**{loser: 1e200}))
    assert results[loser].score is None and f"(cube {loser}." in str(results[loser].fault)
    assert results[other].score is not None and results[other].fault is None


@pytest.mark.parametrize(
    ("red", "blue", "losers"), [(1e4, 100.0, {"red"}), (200.0, 1e4, {"blue"}), (100.0, 200.0, {"red", "blue"})]
)
def test_who_blows_up_takes_nobody_down_who_is_beyond_a_limit_at_the_same_tick(
    red: float, blue: float, losers: set[str]
) -> None:
    results = meddled(duel(limits={"speed": 10}), LATER, shove(red=red, blue=blue))
    assert {role for role, result in results.items() if result.score is None} == losers
    assert {role for role, result in results.items() if str(result.fault).startswith("beyond: ")} == losers
    assert {frozenset(each.split(":")[0] for each in str(result.ended).split(", ")) for result in results.values()} == {
        frozenset(losers)
    }


def test_who_never_comes_to_rest_has_lost_before_the_start() -> None:
    ball = push(name="bouncer")
    task = duel(settle=0.25, settle_limit=0.25, vary={"drop": [3, 3]}, **roles({}, {"position": [1, -3, 0]}))
    results = play(task, {"red": ball, "blue": QUIET}, seeds=[3])[0].results
    assert str(results["red"].fault).startswith("restless: ") and results["red"].score is None
    assert (results["blue"].score, results["blue"].ticks) == (0.0, 0)


def test_a_role_without_a_finite_value_has_lost() -> None:
    task = duel(**roles({"objective": "1 / (red.time - red.time)"}, {}))
    results = play(task, {"red": QUIET, "blue": QUIET}, seeds=[3])[0].results
    assert results["red"].score is None and str(results["red"].fault).startswith("bad_expression: ")
    assert results["blue"].score is not None


def test_creatures_that_may_not_play_are_refused_with_their_role() -> None:
    task = duel(**roles({"limits": {"cubes": 3}, "objective": 'red.cube("tail").height'}, {}))
    with pytest.raises(WorldError, match=r"red: the body has 4 cubes, at most 3 .*red: .* cube 'tail'"):
        play(task, {"red": QUIET, "blue": QUIET})
    with pytest.raises(WorldError, match=r"roles red, blue.* creatures for red, green"):
        play(duel(), {"red": QUIET, "green": QUIET})


def test_the_doors_for_one_creature_say_what_a_match_is() -> None:
    with pytest.raises(Exception, match="roles: this is a match of red, blue"):
        evaluate(QUIET, duel().document)
    with pytest.raises(Exception, match="roles: there are none"):
        play(Task.load("walk").document, {})


# -- proofs ----------------------------------------------------------------------------------------------------------


def record(path: Path, extra: dict[int, dict[str, Any]], skip: str = "") -> Path:
    """Records a match by hand, with commands before some of its steps, and with a creature that is not driven."""
    task, genomes = duel(), {"red": Genome(push()), "blue": Genome(snake())}
    world = World(task.world_config(3))
    recorder = world.journal = Recorder(path, world, about=match_metadata(task, genomes, 3))
    match = Match(world, genomes, {role: brain_of(genome) for role, genome in genomes.items()}, task, 3)
    client = world.join()
    for number, step in enumerate(match.steps()):
        if number in extra:
            world.execute(client, extra[number])
        if step is None:
            world.tick()
        elif isinstance(step, bytes):
            world.handle(client, parse(step))
        elif step.creature != skip:
            world.drive(client, step.creature, step.controls)
    world.leave(client)
    recorder.close()
    world.close()
    return path


def test_a_match_recorded_by_hand_proves_its_scores(tmp_path: Path) -> None:
    proof = prove_match(record(tmp_path / "x.mcap", {}), brain=True)
    assert dict(proof.results) == play(duel(), {"red": push(), "blue": snake()}, seeds=[3])[0].results


@pytest.mark.parametrize("number", [40, 41, 42])
def test_a_match_in_which_a_creature_was_pushed_proves_nothing(number: int, tmp_path: Path) -> None:
    shove = {"type": "apply_physics", "cube_name": "blue.c0", "force": [50, 0, 0]}
    with pytest.raises(ProofError, match="the command apply_physics where there should be") as caught:
        prove_match(record(tmp_path / "x.mcap", {number: shove}))
    assert caught.value.code == "diverged"


def test_a_creature_with_a_brain_must_be_driven(tmp_path: Path) -> None:
    path = record(tmp_path / "x.mcap", {}, skip="blue")
    with pytest.raises(ProofError, match="where there should be a drive of blue"):
        prove_match(path)


def test_matches_and_episodes_prove_nothing_of_each_other(tmp_path: Path) -> None:
    (match,) = play(duel(seeds=[3]), {"red": push(), "blue": snake()}, record=tmp_path)
    assert match.recording is not None
    with pytest.raises(ProofError, match="of a match") as caught:
        prove(match.recording)
    assert caught.value.code == "not_an_evaluation"
    alone = evaluate(
        "roller", {**Task.load("walk").document, "name": "short", "duration": 1, "seeds": [1]}, record=tmp_path
    )
    with pytest.raises(ProofError, match="no recording of a match"):
        prove_match(alone.recordings[0])
