"""Quantities of several bodies in one world: the same figures however many rows are computed at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from nmes.objective import MEETING_QUANTITIES, Cast, Condition, Objective, Quantity
from nmes.objective.trajectories import Trajectories
from nmes.objective.trajectory import ObservedBodies, Trajectory

CAST = Cast(("red", "blue"), ("ball",))
ROWS = 7


def walk(seed: int, cubes: tuple[str, ...]) -> Trajectory:
    """A trajectory of cubes that wander."""
    draw, count = np.random.default_rng(seed), len(cubes)
    bodies = ObservedBodies(cubes, count, np.ones((count, 3)), np.arange(1.0, count + 1), 10)
    trajectory = Trajectory(bodies, ROWS - 1, 0)
    trajectory.states[:] = draw.normal(size=trajectory.states.shape)
    trajectory.rows = ROWS
    return trajectory


def meeting() -> Trajectories:
    """Two bodies of two cubes and of one, and a ball; red touches blue from row 3 on, and the ball at row 1."""
    both = {"red": walk(1, ("a", "b")), "blue": walk(2, ("c",))}
    meeting = Trajectories(both, walk(3, ("ball",)), {"red": "blue", "blue": "ball"}, ROWS - 1, touches=True)
    meeting.touching[3:, 0, 1] = meeting.touching[1, 0, 2] = True
    meeting.rows = ROWS
    return meeting


def centres(trajectory: Trajectory) -> np.ndarray[Any, Any]:
    """The centres of mass, summed otherwise."""
    masses = trajectory.bodies.masses
    return np.asarray(np.einsum("n,rnx->rx", masses / masses.sum(), trajectory.states[:, :, :3]))


def test_the_formulas() -> None:
    them = meeting()
    red, blue, ball = (centres(each) for each in (them.of["red"], them.of["blue"], walk(3, ("ball",))))
    expected = {
        "red.apart.blue": np.linalg.norm(red - blue, axis=1),
        "blue.apart.red": np.linalg.norm(red - blue, axis=1),
        "red.distance": np.linalg.norm(red - blue, axis=1),
        "blue.distance": np.linalg.norm(blue - ball, axis=1),
        'red.cube("b").distance': np.linalg.norm(them.of["red"].states[:, 1, :3] - blue, axis=1),
        "red.apart.ball": np.linalg.norm(red - ball, axis=1),
        "red.touching.blue": np.array([0, 0, 0, 1, 1, 1, 1]),
        "red.touching.ball": np.array([0, 1, 0, 0, 0, 0, 0]),
        "blue.touching.red": np.zeros(ROWS),
        "red.after_touch.blue.z": np.where(np.arange(ROWS) < 3, 0.0, red[:, 2] - red[3, 2]),
        "red.after_touch.blue.horizontal": np.where(np.arange(ROWS) < 3, 0, np.hypot(*(red - red[3])[:, [0, 2]].T)),
        "red.after_touch.ball.x": np.where(np.arange(ROWS) < 1, 0.0, red[:, 0] - red[1, 0]),
        "blue.after_touch.red.x": np.zeros(ROWS),
        "red.position.y": red[:, 1],
        'red.cube("b").position.y': them.of["red"].states[:, 1, 1],
        'cube("ball").position.y': ball[:, 1],
        "time": np.arange(ROWS) / 10,
        "max.red.touching.ball": np.array([0, 1, 1, 1, 1, 1, 1]),
        "min.red.apart.blue": np.minimum.accumulate(np.linalg.norm(red - blue, axis=1)),
        "start.blue.height": np.full(ROWS, blue[0, 1]),
    }
    for text, values in expected.items():
        objective = Objective(text, cast=CAST)
        assert str(objective.needs[0]) == text
        np.testing.assert_allclose(them.values_so_far(objective), values, atol=1e-12, err_msg=text)
        assert objective.value(them.values(objective.needs)) == pytest.approx(values[-1])


@pytest.mark.parametrize("name", MEETING_QUANTITIES)
def test_how_many_rows_are_computed_at_a_time_changes_no_bit(name: str) -> None:
    first, *axis = name.split(".")
    them, quantity = meeting(), Quantity(".".join([first, "blue", *axis]), role="red")
    whole = them.series(quantity)
    for begin in range(ROWS):
        for end in range(begin + 1, ROWS + 1):
            assert them.series(quantity, begin, end).tolist() == whole[begin:end].tolist()


def test_a_condition_holds_first_where_its_quantities_say() -> None:
    assert meeting().first(Condition("red.touching.blue > 0", cast=CAST), 1, ROWS) == 3
    assert meeting().first(Condition("red.after_touch.ball.horizontal > 0", cast=CAST), 1, ROWS) == 2
    assert meeting().first(Condition("red.touching.blue > 0 && time < 0.25", cast=CAST), 1, ROWS) is None
