"""Each built-in engine keeps the contract; what each is allowed to miss the physics by stands here."""

from __future__ import annotations

import pytest

from nmes.backend.contract import BackendContract
from nmes.backends.ballistic import BallisticBackend
from nmes.backends.mujoco3d import MujocoBackend
from nmes.backends.pymunk2d import PymunkBackend


class TestBallistic(BackendContract):
    backend = BallisticBackend
    fall_error = 1e-9  # its parabola is exact
    rest_error = 1e-9
    bounce_error = 0.03


class TestPymunk(BackendContract):
    backend = PymunkBackend
    programs = 20


class TestMujoco(BackendContract):
    backend = MujocoBackend
    joint_momentum_error = 0.01  # it integrates joint coordinates, which keeps them together, not their momentum


@pytest.mark.long
@pytest.mark.parametrize(("contract", "count"), [(TestBallistic, 100), (TestPymunk, 1000), (TestMujoco, 1000)])
def test_many_programs_repeat_themselves_in_fresh_processes(contract: type[BackendContract], count: int) -> None:
    contract().check_fresh_processes(0, count)
