"""Each built-in engine keeps the contract; what each is allowed to miss the physics by stands here."""

from __future__ import annotations

from dataclasses import replace

import pytest

from nmes.backend import SceneSpec, Simulation
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


class StagedMujoco(MujocoBackend):
    """MuJoCo where it computes forces four times a step, in which nothing sleeps."""

    capabilities = MujocoBackend.capabilities - {"sleep"}

    def create(self, scene: SceneSpec) -> Simulation:
        return super().create(replace(scene, options={"integrator": "rk4", "sleep": False}))


class TestStagedMujoco(BackendContract):
    backend = StagedMujoco
    joint_momentum_error = 1e-5


@pytest.mark.long
@pytest.mark.parametrize(("contract", "count"), [(TestBallistic, 100), (TestPymunk, 1000), (TestMujoco, 1000)])
def test_many_programs_repeat_themselves_in_fresh_processes(contract: type[BackendContract], count: int) -> None:
    contract().check_fresh_processes(0, count)
