"""Cloning, the forward model, principal components, and Q-learning: each finds what is known to be there."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from command_line import run
from nmes.brain import load_brain
from nmes.errors import CommandFailed, DocumentError, MachineError
from nmes.learning.learners.cloning import Cloning, squares
from nmes.learning.learners.cube import ACTIONS, STATES, TICKS, TargetCube, arrivals, learn_to_arrive
from nmes.learning.learners.networks import Network
from nmes.learning.learners.novelty import ForwardModel
from nmes.learning.learners.pca import principal_components
from nmes.learning.learners.q_learning import QLearning
from nmes.learning.learners.q_table import read_q_table
from nmes.learning.learners.rows import Spaces
from nmes.measure.clock import ClockWorld, clock_world
from nmes.measure.hosts import running_host
from nmes.variation.draw import Draw
from slopes import slopes

# -- cloning ----------------------------------------------------------------------------------------------------------


def taught(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns observations of different sizes, and what a teacher does with them."""
    seen = Draw(1, "seen").normals(3 * count).reshape(count, 3) * [10.0, 1.0, 0.1] + [5.0, 0.0, -3.0]
    return seen, np.stack([np.tanh(0.1 * seen[:, 0] - 0.5), 0.5 * np.sin(seen[:, 1] + 10.0 * seen[:, 2])], axis=1)


def cloned(passes: int) -> tuple[Cloning, list[float]]:
    clone = Cloning(Spaces(3, 2), Cloning.Options(units=16, rate=1e-2), Draw(1))
    seen, done = taught(1000)
    reports = [clone.learn(seen, done, Draw(1, number), 1.0 - number / passes) for number in range(passes)]
    assert {report.steps for report in reports} == {900} == {clone.lessons(1000)}
    return clone, [report.figures["error of steps held back"] for report in reports]


def test_a_clone_does_what_its_teacher_did_also_where_it_has_not_seen_it() -> None:
    clone, errors = cloned(20)
    assert errors[0] > 0.01 > 0.001 > errors[-1]
    seen, done = taught(1000)
    brain = load_brain(clone.brain(), [*"abc"], [*"xy"])
    brain.reset(seed=0, dt=0.1)
    controls = np.array([brain.step(row).copy() for row in seen[:50]])
    np.testing.assert_allclose(controls, clone.best(seen[:50]), rtol=0, atol=1e-9)
    assert np.abs(controls - done[:50]).mean() < 0.05


def test_the_gradient_of_a_clone_is_that_by_differences() -> None:
    network, (seen, done) = Network((3, 5, 2)), taught(20)
    parameters = network.initial(Draw(2), 1.0)
    found = slopes(lambda point: squares(network, point, seen, done)[1], parameters)
    np.testing.assert_allclose(squares(network, parameters, seen, done)[0], found, rtol=1e-5, atol=1e-7)


# -- the forward model ------------------------------------------------------------------------------------------------


def test_what_a_forward_model_has_learned_is_no_longer_new_and_what_it_has_not_is() -> None:
    spaces, draw = Spaces(2, 1), Draw(1)
    model = ForwardModel(spaces, 16, draw)
    seen, actions = draw.normals(2000).reshape(1000, 2), draw.normals(1000).reshape(1000, 1)
    usual = np.abs(seen[:, 0]) < 1.0

    def following(turn: float) -> np.ndarray:
        return seen + np.stack([0.5 * actions[:, 0], turn * np.sin(3.0 * seen[:, 0])], axis=1)

    after = following(0.5)
    first = model.errors(seen, actions, after)
    for _ in range(200):
        model.learn(seen[usual], actions[usual], after[usual], draw)
    last = model.errors(seen, actions, after)
    assert last[usual].mean() < 0.1 * first[usual].mean()
    assert last[~usual].mean() > 5.0 * last[usual].mean()
    assert model.errors(seen, actions, following(-0.5))[usual].mean() > 5.0 * last[usual].mean()


def test_a_forward_model_of_choices_tells_them_apart() -> None:
    spaces, draw = Spaces(1, 3, choices=True), Draw(1)
    model = ForwardModel(spaces, 16, draw)
    seen = draw.normals(600).reshape(600, 1)
    actions = np.array([[float(draw.count(0, 2))] for _ in range(600)])
    after = seen + np.array([-1.0, 2.0, 0.5])[actions.astype(int)]
    first = model.errors(seen, actions, after).mean()
    for _ in range(100):
        model.learn(seen, actions, after, draw)
    assert model.errors(seen, actions, after).mean() < 0.01 * first


# -- principal components ---------------------------------------------------------------------------------------------


def test_principal_components_are_the_axes_that_were_mixed() -> None:
    draw = np.random.default_rng(1)
    mixed = (
        draw.normal(size=(400, 6)) * [9.0, 5.0, 3.0, 1.0, 0.1, 0.0] @ np.linalg.qr(draw.normal(size=(6, 6)))[0] + 7.0
    )
    found = principal_components(mixed)
    values, vectors = np.linalg.eigh(np.cov(mixed.T))
    np.testing.assert_allclose(found.variances, values[::-1], atol=1e-10)
    np.testing.assert_allclose(np.abs(found.directions @ vectors[:, ::-1]), np.eye(6), atol=1e-6)
    np.testing.assert_allclose(found.apply(mixed, 2).var(axis=0, ddof=1), found.variances[:2])
    assert (found.directions[np.arange(6), np.abs(found.directions).argmax(axis=1)] > 0).all()


def test_one_observation_has_no_principal_components() -> None:
    with pytest.raises(ValueError, match="2 or more"):
        principal_components(np.zeros((1, 3)))


# -- Q-learning -------------------------------------------------------------------------------------------------------


def test_q_learning_finds_the_values_of_a_corridor() -> None:
    """Four places in a row; at the right end is a reward of 1. What is `k` steps away from it is worth 0.9 to the k."""
    learner, draw = QLearning(4, 2, QLearning.Options(rate=0.5, slower=1e6, gamma=0.9)), Draw(1)
    for _ in range(300):
        place = 0
        while place < 3:
            action = learner.choose(place, 0.3, draw)
            after = max(0, place + (1 if action else -1))
            learner.learn(place, action, float(after == 3), after % 3, after == 3)  # then it begins anew
            place = after
    np.testing.assert_allclose(learner.values[:3, 1], [0.81, 0.9, 1.0], atol=1e-3)
    np.testing.assert_allclose(learner.values[1:3, 0], [0.729, 0.81], atol=1e-2)
    assert [learner.best(place) for place in range(3)] == [1, 1, 1]


def test_visits_make_the_steps_of_q_learning_shorter() -> None:
    learner = QLearning(1, 1, QLearning.Options(rate=0.5, slower=2.0, gamma=0.0))
    values = []
    for reward in (1.0, 0.0, 0.0):
        learner.learn(0, 0, reward, 0, False)
        values.append(float(learner.values[0, 0]))
    assert values == pytest.approx([0.5, 0.5 * (1 - 1 / 3), 0.5 * (1 - 1 / 3) * (1 - 0.25)])


def arrived(seed: int, episodes: int, tests: int) -> tuple[int, bytes]:
    """Lets a cube learn; returns in how many others of so many episodes it arrives, and what it has learned."""
    cube = TargetCube(seed)
    try:
        learner = learn_to_arrive(cube, episodes)
        return arrivals(cube, learner, range(1200, 1200 + tests)), learner.values.tobytes()
    finally:
        cube.close()


def test_the_cube_of_the_paper_learns_to_arrive_the_same_way_each_time() -> None:
    assert arrived(1, 0, 5)[0] == 0
    assert arrived(1, 60, 10)[0] >= 1
    assert arrived(2, 3, 1) == arrived(2, 3, 1) != arrived(3, 3, 1)


def test_a_push_that_is_late_begins_later_and_the_one_before_goes_on() -> None:
    def ways(delay: int, *actions: int) -> list[float]:
        cube = TargetCube(1, delay)
        try:
            cube.begin(0)
            start, found = cube.distance, []
            for action in actions:
                cube.push(action)
                found.append(start - cube.distance)
            return found
        finally:
            cube.close()

    assert ways(12, 0, 2) == pytest.approx([0.0, ways(0, 0)[0]], abs=1e-3)
    nothing, whole = 0.0, ways(0, 0)[0]
    assert nothing < abs(ways(6, 0)[0]) < abs(whole)
    assert ways(6, 0, 0) != ways(6, 0, 1)


class Steering(QLearning):
    """Pushes along the axis on which more is to be done to be at rest on the target."""

    def best(self, state: int) -> int:
        along_x, along_z, speed_x, speed_z = np.unravel_index(state, (7, 7, 5, 5))
        x, z = int(along_x) - 3 - (int(speed_x) - 2), int(along_z) - 3 - (int(speed_z) - 2)
        return (0 if x > 0 else 1) if abs(x) >= abs(z) else (2 if z > 0 else 3)


def test_the_cube_arrives_in_a_world_that_waits_for_nobody() -> None:
    steering = Steering(STATES, ACTIONS, QLearning.Options())
    waiting = TargetCube(1)
    try:
        assert arrivals(waiting, steering, range(3)) == 3 and waiting.late == 0
    finally:
        waiting.close()
    with clock_world(5.0) as world:
        began = world.frame
        cube = TargetCube(1, world=world)
        assert arrivals(cube, steering, range(3)) >= 1  # all, but where the machine is held up for long
        assert world.frame - began >= cube.pushes * TICKS + cube.late > 0
        with pytest.raises(CommandFailed, match="nobody"):
            world.do({"type": "get_cube_state", "cube_name": "nobody"})


def test_a_world_that_waits_for_nobody_is_told_from_one_that_has_ended() -> None:
    with running_host("realtime", 5.0) as host, host.connect() as client:
        world = ClockWorld(client)
        world.tick()
        client.set_mode("lockstep")
        client.timeout = 0.2
        with pytest.raises(MachineError, match="the world ticks no more"):
            for _ in range(100):
                world.tick()


def test_what_was_learned_is_judged_by_the_clock() -> None:
    command = ["learn", "cube", "--episodes", "3", "--test", "1", "--seed", "2", "--json"]
    waiting, judged = (json.loads(run(*command, *more).stdout) for more in ((), ("--real-time", "50")))
    assert judged["digest"] == waiting["digest"] and judged["rate"] == 50
    assert judged["late"] >= 0 and judged["part"] in (0, 1)
    refused = run(*command, "--real-time", "0")
    assert refused.exit_code == 2 and "0 is not in the range 0.01<=x<=100" in refused.output


def test_the_command_teaches_the_cube_as_the_library_does() -> None:
    told = json.loads(run("learn", "cube", "--episodes", "3", "--test", "1", "--seed", "2", "--json").stdout)
    cube = TargetCube(2)
    try:
        learner = learn_to_arrive(cube, 3)
        count = arrivals(cube, learner, range(3, 4))
    finally:
        cube.close()
    assert told == {
        **{"episodes": 3, "delay": 0, "arrived": count, "of": 1, "part": float(count)},
        "digest": learner.digest,
    }
    late = json.loads(
        run("learn", "cube", "--episodes", "3", "--test", "1", "--seed", "2", "--delay", "6", "--json").stdout
    )
    assert late["digest"] != told["digest"]


def test_the_table_that_was_learned_is_written_and_read(tmp_path: Path) -> None:
    file = tmp_path / "table.json"
    told = json.loads(
        run("learn", "cube", "--episodes", "3", "--test", "1", "--seed", "2", "--json", "-o", file).stdout
    )
    table = read_q_table(file.read_bytes())
    cube = TargetCube(2)
    try:
        learner = learn_to_arrive(cube, 3)
    finally:
        cube.close()
    assert (np.array(table["values"]) == learner.values).all() and (np.array(table["visits"]) == learner.visits).all()
    assert table["digest"] == learner.digest == told["digest"]
    assert table["figures"] == {"episodes": 3, "seed": 2, "delay": 0, "arrived": told["arrived"], "of": 1}
    refused = run("learn", "cube", "--episodes", "3", "-o", tmp_path / "none" / "table.json")
    assert refused.exit_code == 1 and "cannot write" in refused.output


@pytest.mark.parametrize(
    ("place", "value", "path"),
    [
        ("values", [], "values"),
        ("dimensions", [{"name": "x", "unit": "", "edges": [1, 1]}], "dimensions/0/edges"),
        ("dimensions", [{"name": "x", "unit": "", "edges": [1]}] * 8, "values"),
        ("actions", [{"name": "a"}], "values/0"),
        ("format", "nmes-q-table/2", "format"),
        ("more", 1, "more"),
        ("figures", {"a": "b"}, "figures/a"),
    ],
)
def test_a_table_that_does_not_fit_together_is_refused(place: str, value: object, path: str) -> None:
    document = {
        **{"format": "nmes-q-table/1", "title": "", "dimensions": [{"name": "x", "unit": "m", "edges": [0]}]},
        **{"actions": [{"name": "a"}, {"name": "b", "arrow": [0, 1]}], "values": [[0, 1], [2, 3]]},
        **{"visits": [[0, 0], [1, 1]], "figures": {}, "digest": "0" * 32},
    }
    assert read_q_table(json.dumps(document).encode()) == document
    with pytest.raises(DocumentError) as refused:
        read_q_table(json.dumps({**document, place: value}).encode())
    assert refused.value.path == path


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_the_cube_of_the_paper_learns_to_arrive_reliably(seed: int) -> None:
    assert arrived(seed, 1200, 30)[0] >= 27
