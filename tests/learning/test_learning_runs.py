"""Runs of learning: kept leg by leg, gone on with to the last bit, proved, and damaged in every way."""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import random
import shutil
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import pytest

from learning_runs import MOMENT, OPTIONS, SETTINGS, begin, finish
from nmes.errors import DocumentError, RunError
from nmes.evaluation import Environments, Task, evaluate
from nmes.evolution.run_log import RunLog, RunWriter
from nmes.genome import Genome
from nmes.learning.learners.networks import Network
from nmes.learning.legs import Learning
from nmes.learning.run import LearningRun
from nmes.learning.run_verify import LearningVerdict, verify_learning
from nmes.learning.settings import LearningSettings
from nmes.learning.state import read_state, state_digest, write_state

LEGS = 8


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> LearningRun:
    return finish(begin(tmp_path_factory.mktemp("learning") / "whole"))


@pytest.fixture
def copied(whole: LearningRun, tmp_path: Path) -> Path:
    folder = tmp_path / "copy"
    shutil.copytree(whole.folder, folder)
    return folder


def verified(folder: Path, sample: int | None = 3) -> LearningVerdict:
    return verify_learning(folder, 1, sample, lambda doing, done, total: None)


# -- what a run is ----------------------------------------------------------------------------------------------------


def test_legs_are_scored_now_and_then_and_the_best_is_a_genome_that_scores_it(whole: LearningRun) -> None:
    assert [leg.steps for leg in whole.legs] == [60 * number for number in range(1, LEGS + 1)]
    assert [leg.leg for leg in whole.legs if leg.content["genome_hash"] is not None] == [3, 6, 8]
    genome, best = whole.genome(), whole.best
    assert genome is not None and best is not None
    assert whole.finished and best.score == max(leg.score for leg in whole.legs if leg.score is not None)
    assert evaluate(genome, Task(MOMENT)).score == best.score
    assert genome.document["brain"]["kind"] == "mlp"
    assert genome.document["parents"] == [Genome.load("inchworm").hash]


def test_the_genome_does_what_the_learner_does_without_chance(whole: LearningRun) -> None:
    learning = Learning(LearningSettings.read({**SETTINGS, "every": 1}))
    learning.go()
    assert learning.champion is not None
    brain = learning.champion.genome.brain()
    brain.reset(seed=0, dt=1 / 60)
    environments = Environments(learning.champion.genome, Task(MOMENT), 2)
    seen = environments.reset(3)
    for _ in range(30):
        controls = np.array([brain.step(row).copy() for row in seen])
        np.testing.assert_allclose(controls, learning.best(seen), rtol=0, atol=1e-9)
        seen = environments.step(controls)[0]
    learning.close()
    environments.close()


def test_another_seed_is_another_run_and_threads_do_not_show(whole: LearningRun, tmp_path: Path) -> None:
    again = finish(begin(tmp_path / "again"), threads=3)
    assert again.digest == whole.digest
    assert (tmp_path / "again" / "log.jsonl").read_bytes() == (whole.folder / "log.jsonl").read_bytes()
    assert finish(begin(tmp_path / "other", seed=6, steps=60)).digest != whole.legs[0].digest


def test_each_leg_draws_anew(whole: LearningRun, tmp_path: Path) -> None:
    """A policy that stays the same, as it hardly learns, earns something else in each leg."""
    genome = whole.genome()
    assert genome is not None
    run = finish(begin(tmp_path / "run", steps=180, options={**OPTIONS, "rate": 1e-9}, genome=genome.document))
    returned = [leg.returned or 0.0 for leg in run.legs]
    assert min(abs(one - other) for one, other in pairwise(returned)) > 1e-5


def test_a_run_with_a_reward_of_its_own_earns_it(tmp_path: Path) -> None:
    run = finish(begin(tmp_path / "paid", reward="3", steps=2 * 36, options={**OPTIONS, "ticks": 12}))
    assert [leg.returned for leg in run.legs] == [36.0, 36.0]
    assert begin(tmp_path / "unpaid").digest != run.digest


def test_numbers_that_are_too_large_end_a_run_with_words(tmp_path: Path) -> None:
    run = begin(tmp_path / "run", reward="1e308 * (1 + time)")
    with pytest.raises(RunError, match="in leg 1 learning came to numbers that are too large") as caught:
        finish(run)
    assert caught.value.code == "not_finite"
    assert LearningRun.open(run.folder).digest == run.digest


def test_learning_goes_on_from_a_brain_that_was_learned(whole: LearningRun, tmp_path: Path) -> None:
    genome = whole.genome()
    assert genome is not None
    settings = {**SETTINGS, "genome": genome.document, "options": {**OPTIONS, "rate": 1e-9, "units": 5}, "every": 1}
    learning = Learning(LearningSettings.read(settings))
    learning.go()
    assert learning.champion is not None
    brains = [each.brain() for each in (genome, learning.champion.genome)]
    for brain in brains:
        brain.reset(seed=0, dt=1 / 60)
    read = np.linspace(-1.0, 1.0, len(brains[0].inputs))
    np.testing.assert_allclose(brains[0].step(read), brains[1].step(read), atol=1e-5)
    assert brains[0].document != brains[1].document
    learning.close()


# -- interrupted ------------------------------------------------------------------------------------------------------


def advance(folder: Path, threads: int) -> None:
    finish(LearningRun.open(folder), threads)


def lines(folder: Path) -> int:
    log = folder / "log.jsonl"
    return log.read_bytes().count(b"\n") if log.exists() else 0


@pytest.mark.parametrize("algorithm", ["ppo", pytest.param("reinforce", marks=pytest.mark.long)])
def test_kills_do_not_show(algorithm: str, tmp_path: Path) -> None:
    options = OPTIONS if algorithm == "ppo" else {"rows": 3, "ticks": 20, "units": 8}
    settings: dict[str, Any] = {"algorithm": algorithm, "options": options}
    straight = finish(begin(tmp_path / "straight", **settings))
    folder, draw = tmp_path / "killed", random.Random(algorithm)
    begin(folder, **settings)
    for threads, until in ((2, 1), (1, 3), (3, 6)):
        child = multiprocessing.get_context("fork").Process(target=advance, args=(folder, threads))
        child.start()
        while lines(folder) < until and child.is_alive():
            time.sleep(0.001)
        time.sleep(draw.uniform(0.0, 0.05))
        child.kill()
        child.join()
    run = LearningRun.open(folder)
    assert len(run.legs) < LEGS
    assert finish(run).digest == straight.digest
    for name in ("log.jsonl", "genome.json", "run.json", "states/000008.state"):
        assert (folder / name).read_bytes() == (straight.folder / name).read_bytes(), name


def test_whoever_takes_no_more_legs_interrupts_the_run(whole: LearningRun, tmp_path: Path) -> None:
    run = begin(tmp_path / "run")
    for leg in run.advance():
        if leg.leg == 4:
            break
    assert not LearningRun.open(run.folder).finished
    assert finish(LearningRun.open(run.folder)).digest == whole.digest


@pytest.mark.parametrize("lost", [[8], [7, 8], list(range(1, 9))], ids=["the last", "two", "all"])
def test_states_that_are_lost_are_computed_again(lost: list[int], whole: LearningRun, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    run = begin(folder, steps=9 * 60)
    for leg in run.advance():
        if leg.leg == 8:
            break
    for number in lost:
        (folder / "states" / f"{number:06d}.state").write_bytes(b"[]\nnothing")
    straight = finish(begin(tmp_path / "straight", steps=9 * 60))
    assert finish(LearningRun.open(folder)).digest == straight.digest


def test_few_states_are_kept_of_many_legs(tmp_path: Path) -> None:
    run = finish(
        begin(tmp_path / "run", steps=40 * 6, options={**OPTIONS, "rows": 1, "ticks": 6, "epochs": 1}, every=40)
    )
    assert run.kept() == [*range(3, 39, 3), 39, 40]
    assert verified(run.folder).verdict == "holds"


def test_a_full_disk_leaves_a_run_that_goes_on(
    whole: LearningRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, real, room = begin(tmp_path / "run"), os.fsync, [4]

    def fsync(file: int) -> None:
        room[0] -= 1
        if room[0] < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(file)

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(RunError, match=r"No space left on device; make room, then resume the run") as caught:
        finish(run)
    assert caught.value.code == "cannot_write"
    monkeypatch.undo()
    again = LearningRun.open(run.folder)
    assert 0 < len(again.legs) < LEGS
    assert finish(again).digest == whole.digest
    assert not list(run.folder.rglob("*.part"))


def test_one_process_at_a_time_goes_on_with_a_run(tmp_path: Path) -> None:
    run = begin(tmp_path / "run")
    first = run.advance()
    next(first)
    with pytest.raises(RunError, match="another process goes on"):
        finish(LearningRun.open(run.folder))
    first.close()  # type: ignore[attr-defined]


def test_a_run_that_was_begun_where_other_numbers_come_out_is_not_gone_on_with(copied: Path) -> None:
    document = json.loads((copied / "run.json").read_bytes())
    document["fingerprint"]["learner"] = "0" * 64
    (copied / "run.json").write_bytes(orjson.dumps(document))
    with pytest.raises(RunError) as caught:
        finish(LearningRun.open(copied))
    assert caught.value.code == "not_comparable"
    assert verified(copied).verdict == "holds"


# -- proof ------------------------------------------------------------------------------------------------------------


def rewritten(folder: Path, change: Callable[[int, dict[str, Any]], None]) -> None:
    """Changes the log's lines, and gives them digests that fit."""
    origin = LearningRun.open(folder)._log.origin
    contents = [orjson.loads(line.content) for line in RunLog(folder / "log.jsonl", origin).lines()]
    for number, content in enumerate(contents, 1):
        change(number, content)
    (folder / "log.jsonl").unlink()
    writer = RunWriter(RunLog(folder / "log.jsonl", origin))
    writer.append(contents)
    writer.close()


@pytest.mark.parametrize("sample", [0, 3, 100, None])
def test_a_run_holds(sample: int | None, whole: LearningRun) -> None:
    found = verified(whole.folder, sample)
    assert (found.verdict, found.findings, found.legs, found.digest) == ("holds", (), LEGS, whole.digest)
    if sample == 0:  # the best is done again all the same
        assert found.again == 1
    else:
        assert found.again == (LEGS if sample in (100, None) else sample + 1)


def test_the_legs_that_are_done_again_are_others_each_time_and_have_the_best(
    whole: LearningRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen: list[tuple[int, ...]] = []

    def again(run: LearningRun, learning: Learning, legs: list[int]) -> list[str]:
        chosen.append(tuple(legs))
        return []

    monkeypatch.setattr("nmes.learning.run_verify._again", again)
    assert whole.best is not None
    seeds = [verified(whole.folder).seed for _ in range(20)]
    assert len(set(seeds)) == 20 and len(set(chosen)) > 2
    assert all({1, whole.best.leg, LEGS} <= {*legs} for legs in chosen)
    before = chosen[0]
    assert verify_learning(whole.folder, 1, 3, lambda *_: None, seeds[0]).seed == seeds[0] and chosen[-1] == before


def test_a_score_that_was_made_up_is_found(copied: Path) -> None:
    def praise(number: int, content: dict[str, Any]) -> None:
        if number == LEGS:
            content["score"] = 99.0

    rewritten(copied, praise)
    found = verified(copied)
    assert found.verdict == "broken"
    assert any("score is 99.0 in the log" in finding for finding in found.findings)


def test_a_state_that_was_changed_is_not_begun_from_and_shows_in_what_comes_of_it(copied: Path) -> None:
    path = copied / "states" / "000005.state"
    state = {name: array.copy() for name, array in read_state(path.read_bytes()).items()}
    state["parameters"][0] += 1.0
    path.write_bytes(write_state(state))
    found = verified(copied, 100)
    assert (found.verdict, found.again) == ("holds", LEGS)  # leg 6, the best, is done again from the state before

    rewritten(copied, lambda number, content: content.update(state=state_digest(state)) if number == 5 else None)
    found = verified(copied, 100)
    assert found.verdict == "broken"
    assert [finding.split(":")[0] for finding in found.findings] == ["leg 5"]


@pytest.mark.parametrize("kept", [[], [5], [1, 5]])
def test_legs_are_drawn_among_all_whatever_states_the_run_keeps(copied: Path, kept: list[int]) -> None:
    rewritten(copied, lambda number, content: content.update({"return": 99.0}) if number == 3 else None)
    for path in (copied / "states").iterdir():
        if int(path.stem) not in kept:
            path.unlink()
    found = verified(copied, 100)
    assert (found.verdict, found.again) == ("broken", LEGS) and "leg 3: return is 99.0" in found.findings[0]


def test_a_genome_that_is_not_the_best_of_the_run_is_found_and_written_anew(copied: Path, whole: LearningRun) -> None:
    (copied / "genome.json").write_bytes(orjson.dumps(Genome.load("walker").document))
    found = verified(copied)
    assert found.verdict == "broken" and "is not the best of its run" in found.findings[0]
    finish(LearningRun.open(copied))
    assert (copied / "genome.json").read_bytes() == (whole.folder / "genome.json").read_bytes()


# -- damaged ----------------------------------------------------------------------------------------------------------


def test_a_log_is_followed(copied: Path) -> None:
    log = copied / "log.jsonl"
    text = log.read_bytes()
    log.write_bytes(text.replace(b'"steps":60,', b'"steps":61,', 1))
    with pytest.raises(RunError) as caught:
        LearningRun.open(copied)
    assert caught.value.code == "log_damaged"
    assert verified(copied).verdict == "broken"
    log.write_bytes(text[:-5])  # a torn line is not there yet
    assert len(LearningRun.open(copied).legs) == LEGS - 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"", "not as it must be"),
        (b"{}", "is missing"),
        (b'{"format": "nmes-run/1"}', "is a run of the format nmes-run/1, not nmes-learning/1: .* by `nmes evolve`"),
        (b'{"format": "nmes-learning/2"}', "in the version of NMES that began it"),
    ],
)
def test_a_folder_with_other_settings_is_no_run(text: bytes, words: str, copied: Path) -> None:
    (copied / "run.json").write_bytes(text)
    with pytest.raises(RunError, match=words) as caught:
        LearningRun.open(copied)
    assert caught.value.code == "no_run"


def test_a_folder_without_a_run_is_none_and_one_with_a_run_is_not_begun_in(copied: Path, tmp_path: Path) -> None:
    with pytest.raises(RunError, match="there is no run in"):
        LearningRun.open(tmp_path / "nothing")
    with pytest.raises(RunError) as caught:
        begin(copied)
    assert caught.value.code == "run_exists"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"algorithm": "dqn"}, "there is no algorithm 'dqn'"),
        ({"algorithm": "clone", "options": {}}, "'clone' learns from recordings, and it alone"),
        ({"recordings": ["a.mcap"]}, "'clone' learns from recordings, and it alone"),
    ],
)
def test_a_folder_of_no_algorithm_that_there_is_holds_no_run(changes: dict[str, Any], words: str, copied: Path) -> None:
    document = orjson.loads((copied / "run.json").read_bytes())
    (copied / "run.json").write_bytes(orjson.dumps({**document, **changes}))
    with pytest.raises(RunError, match=words) as caught:
        LearningRun.open(copied)
    assert caught.value.code == "no_run"


@pytest.mark.parametrize(
    "champion",
    [[1, "x", "genome"], [1, None, "genome"], [1, 2.0, []], ["1", 2.0, "genome"], [9, 2.0, "genome"], [1], "x", {}],
)
def test_a_state_whose_champion_is_none_is_damaged(champion: Any, copied: Path) -> None:
    genome = orjson.loads((copied / "genome.json").read_bytes())
    told = [genome if each == "genome" else each for each in champion] if isinstance(champion, list) else champion
    path = copied / "states" / f"{LEGS:06d}.state"
    state = {**read_state(path.read_bytes()), "champion": np.frombuffer(orjson.dumps(told), np.uint8)}
    assert_damaged(copied, state)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_state_with_what_is_no_number_is_damaged(value: float, copied: Path) -> None:
    path = copied / "states" / f"{LEGS:06d}.state"
    state = {name: array.copy() for name, array in read_state(path.read_bytes()).items()}
    state["parameters"][-1] = value
    assert_damaged(copied, state)


def test_a_state_whose_sums_are_no_numbers_ends_a_run_with_words(copied: Path) -> None:
    path = copied / "states" / f"{LEGS - 1:06d}.state"
    state = {name: array.copy() for name, array in read_state(path.read_bytes()).items()}
    body = Genome.load("inchworm").body
    network = Network((len(body.sensors), OPTIONS["units"], OPTIONS["units"], len(body.motors)))
    *hidden, (weights, _) = network.layers(state["parameters"])
    for _, biases in hidden:
        biases[...] = 50.0  # every unit is at 1, and the sum of half of them beyond all numbers
    weights[...] = [1.7e308, -1.7e308] * (OPTIONS["units"] // 2)
    rewound(copied, state)
    with pytest.raises(RunError, match=f"in leg {LEGS} learning came to numbers that are too large") as caught:
        finish(LearningRun.open(copied))
    assert caught.value.code == "not_finite"


def assert_damaged(folder: Path, state: dict[str, Any]) -> None:
    """Puts a state into a run from which nobody can go on."""
    rewound(folder, state)
    with pytest.raises(RunError, match="is not of this run") as caught:
        finish(LearningRun.open(folder))
    assert caught.value.code == "log_damaged"


def rewound(folder: Path, state: dict[str, Any]) -> None:
    """Takes the last leg of a run away, and has another state after the one before it, which the log has too."""
    (folder / "states" / f"{LEGS - 1:06d}.state").write_bytes(write_state(state))
    rewritten(folder, lambda number, content: content.update(state=state_digest(state)) if number == LEGS - 1 else None)
    log = folder / "log.jsonl"
    log.write_bytes(b"".join(log.read_bytes().splitlines(keepends=True)[: LEGS - 1]))


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{}\n",
        b"[1]\n",
        b'[["a","<f8",[2]]]\n' + bytes(15),
        b'[["a","<f8",[1]]]\n' + bytes(9),
        b'[["a","|O",[1]]]\n' + bytes(8),
        b'[["a","<f8",[-1]]]\n',
        b'[["a","<f8",[1e300]]]\n',
    ],
)
def test_bytes_that_are_no_state_are_refused(text: bytes) -> None:
    with pytest.raises(ValueError):
        read_state(text)


def test_a_state_is_read_as_it_was_written() -> None:
    state = {"b": np.arange(6.0).reshape(2, 3), "a": np.array([7, 8], np.uint8), "c": np.zeros((0, 2))}
    found = read_state(write_state(state))
    assert list(found) == ["a", "b", "c"]
    for name, array in state.items():
        assert (found[name].dtype, found[name].shape) == (array.dtype, array.shape)
        assert (found[name] == array).all()


# -- settings ---------------------------------------------------------------------------------------------------------

BOXES = {"cubes": [{"id": "one", "size": [1, 1, 1], "mass": 1, "position": [0, 0.5, 0]}]}
AIMLESS = {"format": "nmes-task/1", "name": "aimless", "description": "Nothing.", "duration": 1, "seeds": [1]}
STILL = {"format": "nmes-genome/1", "name": "still", "body": BOXES}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"steps": 0}, "steps: "),
        ({"algorithm": "pppo"}, "there is no algorithm 'pppo'; did you mean ppo"),
        ({"options": {"rowz": 3}}, "'ppo' has no such option; did you mean rows"),
        ({"options": {"rows": 0.5}}, "must be a whole number"),
        ({"options": {"gamma": 2}}, "options.gamma: must be from 0 to 1"),
        ({"genome": STILL}, "'still' has no motors: there is nothing to learn"),
        ({"genome": "nobody"}, "genome: there is no genome 'nobody'"),
        ({"task": "nothing"}, "task: there is no task 'nothing'"),
        ({"task": AIMLESS}, "task/objective: is missing"),
        ({"genome": "centipede", "task": {**Task.load("walk").document, "limits": {"cubes": 1}}}, "may not take part"),
        ({"reward": "velocity.q"}, "reward: "),
        ({"reward": 'cube("tail").height'}, "there is no cube 'tail'"),
        ({"algorithm": "clone", "options": {}}, "'clone' learns from recordings, and it alone"),
        ({"recordings": ["a.mcap"]}, "'clone' learns from recordings, and it alone"),
        ({"whatever": 1}, "there is no such field"),
    ],
)
def test_settings_that_cannot_be_run_are_refused_with_their_place(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(DocumentError, match=words):
        LearningSettings.read({**SETTINGS, **changes})


def test_a_network_of_another_form_is_not_replaced_in_silence() -> None:
    genome = Genome.load("inchworm")
    sensors, motors = len(genome.body.sensors), len(genome.body.motors)
    layer = {"weights": [[0.0] * sensors] * motors, "biases": [0.0] * motors, "activation": "relu"}
    document = {**genome.document, "brain": {"kind": "mlp", "layers": [layer]}}
    with pytest.raises(DocumentError, match="genome/brain: learning goes on only from layers of tanh"):
        LearningSettings.read({**SETTINGS, "genome": document})
    layer["activation"] = "identity"
    assert LearningSettings.read({**SETTINGS, "genome": document}).start() is not None
