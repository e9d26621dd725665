"""Environments: rows that are driven from outside have the bits of worlds that are driven so."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from creatures import exploding, snake
from nmes.backend import Array, Places
from nmes.backends.mujoco3d.rows import MujocoRows
from nmes.errors import RecordingError, WorldError
from nmes.evaluation import Environments, Result, Task, prove
from nmes.evaluation.environments import Autoreset
from nmes.evaluation.episode import Episode
from nmes.genome import Genome
from nmes.playback import replay
from nmes.recording import Recording
from nmes.world import World

MOST = 2  # episodes of each row that are run again in worlds


class Player:
    """In the place of a brain: does what is written, and writes down what it senses."""

    open_loop = False

    def __init__(self, actions: Array) -> None:
        self.actions = iter(actions)
        self.sensed: list[bytes] = []

    def reset(self, seed: int, dt: float) -> None:
        """Has nothing to forget."""

    def step(self, inputs: Array) -> Array:
        self.sensed.append(inputs.tobytes())
        return next(self.actions)


def in_a_world(genome: Genome, task: Task, seed: int, actions: Array) -> tuple[Result, list[bytes], Array]:
    """Returns how an episode comes out, what is sensed at each tick, and what it is worth from the start on."""
    world, player = World(task.world_config(seed)), Player(actions)
    try:
        episode = Episode(world, genome, player, task, seed)  # type: ignore[arg-type]
        return episode.run(), player.sensed, episode.scores_so_far()[:, 1]
    finally:
        world.close()


class Watcher:
    """Steps environments with drawn actions, and checks every episode that ends against a world."""

    def __init__(self, genome: Genome, task: Task, rows: int, **options: Any) -> None:
        self.genome, self.task = genome, task
        self.environments = Environments(genome, task, rows, **options)
        self.ended: list[Result] = []
        self.seen_last = 0  # of how many episodes the last observation could be compared
        self._checked = [0] * rows
        self._draw = np.random.default_rng(0)

    def run(self, seed: int, ticks: int, scale: float = 1.0) -> None:
        environments, rows = self.environments, len(self.environments.results)
        seen: list[list[bytes]] = [[row.tobytes()] for row in environments.reset(seed)]
        done: list[list[Array]] = [[] for _ in range(rows)]
        rewards: list[list[float]] = [[] for _ in range(rows)]
        for _ in range(ticks):
            actions = scale * self._draw.uniform(-1.0, 1.0, (rows, len(environments.motors)))
            observations, given, terminated, truncated = environments.step(actions)
            for row in range(rows):
                done[row].append(actions[row])
                rewards[row].append(float(given[row]))
                if terminated[row] or truncated[row]:
                    self._checked[row] += 1
                    if self._checked[row] <= MOST:
                        self.check(row, seen[row], done[row], rewards[row], bool(truncated[row]))
                    seen[row], done[row], rewards[row] = [], [], []
                seen[row].append(observations[row].tobytes())

    def check(self, row: int, seen: list[bytes], done: list[Array], rewards: list[float], lasted: bool) -> None:
        result = self.environments.results[row]
        assert result is not None
        # As long as it takes: what comes after its end is not asked for.
        actions = np.array(done + [done[-1]] * self.task.ticks)
        expected, sensed, worth = in_a_world(self.genome, self.task, result.seed, actions)
        assert result == expected
        assert lasted == (result.ended is None and result.fault is None)
        assert seen[: len(done)] == sensed[: len(done)]
        last = self.environments.last_observations[row].tobytes()
        # A world whose episode has ended is stopped a second later at the latest.
        assert len(sensed) <= len(done) or last == sensed[len(done)]
        self.seen_last += len(sensed) > len(done)
        if not lasted:
            assert len(done) == result.ticks + (result.ended in ("energy", "speed", "spin", "size") or _faulted(result))
        total = 0.0
        for reward, value in zip(rewards[:-1], worth[1:], strict=False):
            expected_reward = 0.0 if np.isnan(value) else value - total
            assert reward == expected_reward
            total += reward
        assert rewards[-1] == (result.score or 0.0) - total
        self.ended.append(result)


def _faulted(result: Result) -> bool:
    return result.fault is not None and result.fault.startswith("diverged")


def task(**changes: Any) -> Task:
    return Task({**Task.load("walk").document, "duration": 1.0, "seeds": [1, 2, 3], "limits": {}, **changes})


def stretching() -> dict[str, Any]:
    """Returns the genome of two small cubes with a fast slide between them that is as long as one likes."""
    cubes = [{"id": f"c{i}", "size": 0.2, "mass": 1, "position": [0.2 * i, 0.1, 0]} for i in range(2)]
    motor = {"mode": "velocity", "range": [-20, 20], "max_effort": 500}
    joint = {"id": "j", "cube1": "c0", "cube2": "c1", "type": "slide", "anchor": [0.1, 0.1, 0], "axis": [1, 0, 0]}
    body = {"cubes": cubes, "joints": [{**joint, "motor": motor}]}
    return {"format": "nmes-genome/1", "name": "stretching", "body": body}


CASES: dict[str, tuple[Genome, Task]] = {
    "it lasts": (Genome(snake()), task()),
    "a limit": (Genome(snake()), task(limits={"energy": 2.0})),
    "a stretch": (Genome(stretching()), task(limits={"size": 0.4})),
    "an end": (Genome(snake()), task(ends=[{"name": "gone", "when": "displacement.horizontal > 0.05"}])),
    "a worth of nothing": (Genome(snake()), task(objective="time < 0.2 ? 1 / (energy - energy) : energy")),
    "folds": (Genome(snake()), task(objective="mean.speed + max.height - min.lowest + time_upright + start.reach")),
    "a target": (
        Genome.load("seeker"),
        task(target={"distance": [0.5, 2], "bearing": [-1, 1]}, objective="start.distance - distance"),
    ),
    "contacts": (Genome(snake()), task(objective="contacts + mean.contacts")),
    "a duty factor": (Genome(snake()), task(limits={"energy": 3.0}).with_duty()),
    "a prop": (Genome.load("juggler"), Task({**Task.load("pole").document, "duration": 0.7, "seeds": [1, 2]})),
    "another engine": (Genome(snake()), task(world={"backend": "pymunk"})),
    "a fault": (Genome(exploding()), task()),
}


@pytest.mark.parametrize("case", CASES)
def test_every_episode_has_the_bits_of_a_world_that_is_driven_so(case: str) -> None:
    watcher = Watcher(*CASES[case], 2)
    watcher.run(seed=5, ticks=130)
    assert len(watcher.ended) >= 2
    ends = {result.ended or (result.fault or "").partition(":")[0] for result in watcher.ended}
    assert watcher.seen_last or case not in ("a limit", "an end", "a prop")
    assert {
        "a limit": "energy",
        "a stretch": "size",
        "a duty factor": "energy",
        "an end": "gone",
        "a prop": "fallen",
        "a fault": "diverged",
    }.get(case, "") in ends


def test_an_episode_without_a_score_was_worth_nothing_in_all() -> None:
    """A plate is hurled against the limits of its slide ten times a second: the solver flings the whole body."""
    cubes = [{"id": f"c{i}", "size": 1, "mass": 1 - 0.95 * i, "position": [i, 0.5, 0]} for i in range(2)]
    motor = {"mode": "velocity", "range": [-118, 118], "max_effort": 2000}
    slide = {"type": "slide", "axis": [1, 0, 0], "limits": [-0.24, 0.24], "motor": motor}
    joint = {"id": "j", "cube1": "c0", "cube2": "c1", "anchor": [0.5, 0.5, 0], **slide}
    body = {"cubes": cubes, "joints": [joint]}
    flung = Genome({"format": "nmes-genome/1", "name": "flung", "body": body})
    environments = Environments(flung, task(objective="1 + displacement.horizontal"), 1)
    environments.reset(0)
    rewards = []
    for tick in range(60):
        _, given, _, truncated = environments.step(np.array([[float(np.sign(np.sin(np.pi * tick / 6 + 0.1)))]]))
        rewards.append(float(given[0]))
    (result,) = environments.results
    assert truncated.all() and result is not None and (result.fault or "").startswith("energy: ")
    assert result.score is None and rewards[0] > 1 and max(np.cumsum(rewards)) > 2
    assert abs(sum(rewards)) < 1e-9


def test_a_row_that_the_engine_gives_up_goes_on_in_a_world(monkeypatch: pytest.MonkeyPatch) -> None:
    step, ticks = MujocoRows.step, count(1)

    def giving_up(rows: MujocoRows, places: Places, substeps: int) -> list[int]:
        lost = step(rows, places, substeps)
        return sorted({*lost, 1}) if next(ticks) in (7, 85) else lost

    monkeypatch.setattr(MujocoRows, "step", giving_up)
    watcher = Watcher(Genome(snake()), task(), 3)
    watcher.run(seed=5, ticks=130)
    assert len(watcher.ended) == 6


def test_rows_and_their_episodes_draw_their_scenes_and_nothing_else_matters() -> None:
    def scenes(rows: int, seed: int, **options: Any) -> tuple[list[list[int]], bytes]:
        environments = Environments(Genome(snake()), task(duration=0.1), rows, seeds=range(20, 30), **options)
        environments.reset(seed + 1)
        environments.reset(seed)
        drawn: list[list[int]] = []
        for tick in range(18):
            environments.step(np.full((rows, 3), 0.01 * tick))
            if tick % 6 == 5:
                assert environments.truncated.all() and not environments.terminated.any()
                drawn.append([result.seed for result in environments.results[:3] if result is not None])
        return drawn, environments.last_observations[:3].tobytes()

    drawn, bits = scenes(3, 1)
    assert scenes(3, 1) == scenes(5, 1, threads=2) == (drawn, bits)
    assert scenes(3, 2)[0] != drawn
    assert len({seed for seeds in drawn for seed in seeds}) > 4 and all(20 <= s < 30 for seeds in drawn for s in seeds)


def test_arrays_are_reused_and_a_new_episode_begins_at_its_start() -> None:
    environments = Environments(Genome(snake()), task(duration=0.1, seeds=[1]), 2)
    first = environments.reset(0)
    start = first.copy()
    for _ in range(6):
        arrays = environments.step(np.full((2, 3), 0.5))
        assert arrays[0] is first and arrays[1] is environments.rewards
        assert arrays[2] is environments.terminated and arrays[3] is environments.truncated
    assert (first == start).all() and (environments.last_observations != start).any()


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((2, 4)), "the shape"),
        (np.zeros(3), "the shape"),
        (np.array([[0, 0, 0], [0, 1.5, 0]]), "row 1 for 'j1' is 1.5"),
        (np.array([[0, 0, np.nan], [0, 0, 0]]), "row 0 for 'j2' is nan"),
    ],
)
def test_actions_that_motors_do_not_take_move_nothing(actions: Array, message: str) -> None:
    environments = Environments(Genome(snake()), task(duration=0.1), 2)
    before = environments.reset(0).copy()
    with pytest.raises(ValueError, match=message):
        environments.step(actions)
    assert (environments.observations == before).all()
    for _ in range(6):
        environments.step(np.zeros((2, 3)))
    assert environments.truncated.all()


@pytest.mark.parametrize("backend", ["mujoco", "pymunk"])
def test_a_step_comes_after_a_reset(backend: str) -> None:
    environments = Environments(Genome(snake()), task(duration=0.1, world={"backend": backend}), 2)
    for _ in range(2):
        with pytest.raises(ValueError, match="reset comes first"):
            environments.step(np.zeros((2, 3)))
        environments.reset(0)
        environments.step(np.zeros((2, 3)))
        environments.close()


def test_who_cannot_begin_is_refused() -> None:
    with pytest.raises(WorldError, match="4 cubes, at most 3"):
        Environments(Genome(snake()), task(limits={"cubes": 3}), 1)
    with pytest.raises(WorldError, match="cannot begin with seed 2: restless"):
        Environments(Genome(snake()), task(vary={"drop": [9, 9]}, settle=0, settle_limit=0.25), 1, seeds=[2])
    for rows, seeds in ((0, [1]), (1, [])):
        with pytest.raises(ValueError, match="1 row and 1 seed or more"):
            Environments(Genome(snake()), task(), rows, seeds=seeds)


def run(environments: Environments, ticks: int, seed: Any = 3) -> list[tuple[Any, ...]]:
    """Returns copies of what each step returns, with actions that depend on nothing but the tick."""
    environments.reset(seed)
    shape = len(environments.results), len(environments.motors)
    steps = []
    for tick in range(ticks):
        steps.append(tuple(array.copy() for array in environments.step(np.full(shape, np.sin(0.3 * tick)))))
    return steps


def test_a_row_has_the_seed_of_its_number_and_is_the_same_among_others() -> None:
    def one(seed: Any, rows: int, row: int) -> list[list[bytes]]:
        environments = Environments(Genome(snake()), task(duration=0.1), rows, seeds=range(20, 30))
        return [[array[row].tobytes() for array in step] for step in run(environments, 30, seed)]

    assert one(5, 4, 2) == one(7, 1, 0) == one([1, 7], 2, 1) != one(8, 1, 0)


def test_next_step_begins_an_episode_in_the_step_after_its_end() -> None:
    modes: tuple[tuple[Autoreset, int], ...] = ("same_step", 12), ("next_step", 14)
    same, late = (
        run(Environments(Genome(snake()), task(duration=0.1), 2, seeds=range(20, 30), autoreset=mode), ticks)
        for mode, ticks in modes
    )
    for step in range(5):
        assert all((a == b).all() for a, b in zip(same[step], late[step], strict=True))
    observations, rewards, terminated, truncated = late[6]  # what begins now has not been driven yet
    assert late[5][3].all() and not (truncated.any() or terminated.any() or rewards.any())
    assert (observations == same[5][0]).all() and (late[5][0] != observations).any()


def test_a_row_whose_episode_is_over_waits_until_it_is_reset() -> None:
    ends = [{"name": "high", "when": "time > 0.05"}]
    environments = Environments(Genome(snake()), task(ends=ends), 3, autoreset="disabled", seeds=range(20, 30))
    for _ in range(2):
        last = run(environments, 4)[-1]
        assert last[2].all() and (last[0] == environments.last_observations).all()
        with pytest.raises(ValueError, match="the episode of row 0 is over"):
            environments.step(np.zeros((3, 3)))
    before = environments.observations.copy()
    environments.reset(None, np.array([True, False, True]))
    with pytest.raises(ValueError, match="the episode of row 1 is over"):
        environments.step(np.zeros((3, 3)))
    assert (environments.observations[1] == before[1]).all() and (environments.observations[0] != before[0]).any()
    environments.reset([None, 4, None], np.array([False, True, False]))
    environments.step(np.zeros((3, 3)))
    assert not environments.terminated.any()


def test_the_first_reset_of_a_row_needs_a_seed_and_there_are_as_many_as_rows() -> None:
    environments = Environments(Genome(snake()), task(), 2)
    for seed, message in ((None, "needs a seed"), ([1, None], "needs a seed"), ([1], "there are 2 rows, not 1")):
        with pytest.raises(ValueError, match=message):
            environments.reset(seed)
    with pytest.raises(ValueError, match="autoreset is one of"):
        Environments(Genome(snake()), task(), 2, autoreset="never")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "text", ["velocity.x - 0.01 * energy", "max.height * 2", 'cube("c1").speed + contacts', "time < 0.1 ? 1 : 1 / 0"]
)
def test_a_reward_of_ones_own_is_what_its_expression_is_worth_at_each_tick(text: str) -> None:
    document = task(duration=0.3, seeds=[2], limits={"energy": 1000})
    scored = Task({**document.document, "objective": text})
    environments, actions = Environments(Genome(snake()), document, 2, reward=text), np.full((18, 3), 0.4)
    environments.reset(0)
    rewards = np.array([environments.step(np.repeat(action[None], 2, axis=0))[1].copy() for action in actions])
    worth = in_a_world(Genome(snake()), scored, 2, actions)[2][1:]
    assert (rewards == np.where(np.isfinite(worth), worth, 0.0)[:, None]).all() and rewards.any()


@pytest.mark.parametrize("text", ["", "speed > 1", 'cube("nobody").height', "velocity"])
def test_a_reward_that_cannot_be_is_refused(text: str) -> None:
    with pytest.raises(WorldError, match="reward") as refused:
        Environments(Genome(snake()), task(), 1, reward=text)
    assert refused.value.code == "bad_expression"


@pytest.mark.parametrize("autoreset", ["same_step", "next_step", "disabled"])
@pytest.mark.parametrize("case", ["it lasts", "a limit", "an end", "a prop", "another engine", "a fault"])
def test_each_episode_can_be_recorded_and_proved(case: str, autoreset: Any, tmp_path: Path) -> None:
    genome, asked = CASES[case]
    environments, path = Environments(genome, asked, 2, autoreset=autoreset), tmp_path / "episode.mcap"
    environments.reset(0)
    with pytest.raises(ValueError, match="nothing to record"):
        environments.record(1, path)
    draw = np.random.default_rng(1)
    while environments.results[1] is None:
        environments.step(draw.uniform(-1.0, 1.0, (2, len(environments.motors))))
        over = environments.terminated | environments.truncated
        if autoreset == "disabled" and over.tolist() == [True, False]:
            environments.reset(None, over)
    environments.record(1, path)
    assert replay(Recording(path)).verdict == "reproduced"
    assert prove(path).result == environments.results[1]
    if autoreset != "disabled":  # one that goes on can be recorded as far as it has come
        for _ in range(3):
            environments.step(np.zeros((2, len(environments.motors))))
        environments.record(1, path)
        report = replay(Recording(path))
        assert report.verdict == "reproduced"


def test_an_episode_of_a_creature_without_a_brain_can_be_proved_too(tmp_path: Path) -> None:
    genome = Genome({key: value for key, value in snake().items() if key != "brain"})
    environments, path = Environments(genome, task(duration=0.3), 1), tmp_path / "episode.mcap"
    run(environments, 18)
    environments.record(0, path)
    assert [prove(path).result] == environments.results


def test_a_recording_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    environments = Environments(Genome(snake()), task(), 1)
    environments.reset(0)
    environments.step(np.zeros((1, 3)))
    with pytest.raises(RecordingError):
        environments.record(0, tmp_path / "nowhere" / "episode.mcap")
    assert not list(tmp_path.iterdir())


def test_what_ends_an_episode_is_what_came_first() -> None:
    """A condition holds at one tick, and at the next the creature would be beyond a limit."""
    actions = np.full((30, 3), 0.8)
    worths = in_a_world(Genome(snake()), task(objective="energy", duration=0.5, seeds=[1]), 1, actions)[2]
    limit = float(worths[10] + worths[11]) / 2.0
    ends = [{"name": "soon", "when": "time > 9.5 / 60"}]
    asked = task(duration=0.5, seeds=[1], ends=ends, limits={"energy": limit})
    environments = Environments(Genome(snake()), asked, 1)
    environments.reset(0)
    for action in actions[:10]:
        environments.step(action[None])
    expected = in_a_world(Genome(snake()), asked, 1, actions)[0]
    assert environments.results == [expected] and (expected.ended, expected.ticks) == ("soon", 10)
