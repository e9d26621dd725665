"""The contract catches what it is there to catch: each engine below has one planted defect."""

from __future__ import annotations

import copy
import mmap
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pytest

from nmes.backend import (
    Array,
    Backend,
    BodySpec,
    BodyState,
    CameraSpec,
    Image,
    JointParams,
    JointSpec,
    JointState,
    SceneSpec,
    Simulation,
    Vector,
)
from nmes.backend.contract import BackendContract
from nmes.backend.contract.base import ZERO
from nmes.backends.ballistic import BallisticBackend, BallisticSimulation
from nmes.backends.pymunk2d import PymunkBackend, PymunkSimulation
from nmes.errors import WorldError


class Planted(BallisticBackend):
    """Ballistic with a defect: subclasses say in which method."""

    class Defect(BallisticSimulation):
        pass

    def create(self, scene: SceneSpec) -> BallisticSimulation:
        return self.Defect(scene)


class DropsImpulses(Planted):
    class Defect(BallisticSimulation):
        def apply(self, body: int, force: Vector, torque: Vector, impulse: Vector, angular_impulse: Vector) -> None:
            super().apply(body, force, torque, ZERO, angular_impulse)


class TurnsTheWrongWay(Planted):
    class Defect(BallisticSimulation):
        def apply(self, body: int, force: Vector, torque: Vector, impulse: Vector, angular_impulse: Vector) -> None:
            x, y, z = torque
            super().apply(body, force, (x, y, -z), impulse, angular_impulse)


class KeepsOnlyTheLastForce(Planted):
    class Defect(BallisticSimulation):
        def apply(self, body: int, force: Vector, torque: Vector, impulse: Vector, angular_impulse: Vector) -> None:
            self._bodies[body].force = ZERO
            super().apply(body, force, torque, impulse, angular_impulse)


class NeverLetsGo(Planted):
    class Defect(BallisticSimulation):
        def step(self, substeps: int) -> None:
            forces = {number: body.force for number, body in self._bodies.items()}
            super().step(substeps)
            for number, force in forces.items():
                self._bodies[number].force = force


class KicksAtOnce(Planted):
    class Defect(BallisticSimulation):
        def apply(self, body: int, force: Vector, torque: Vector, impulse: Vector, angular_impulse: Vector) -> None:
            super().apply(body, force, torque, impulse, angular_impulse)
            self._kick(self._bodies[body])
            self._bodies[body].impulse = ZERO


class AnswersFromAStaleCache(Planted):
    class Defect(BallisticSimulation):
        def states(self, bodies: Sequence[int]) -> Array:
            cache: dict[tuple[int, ...], Array] = self.__dict__.setdefault("cache", {})
            return cache.setdefault(tuple(bodies), super().states(bodies)).copy()


class KeepsItsAnswers(Planted):
    class Defect(BallisticSimulation):
        def states(self, bodies: Sequence[int]) -> Array:
            cache: dict[tuple[int, ...], Array] = self.__dict__.setdefault("cache", {})
            answer = cache.setdefault(tuple(bodies), np.zeros((len(bodies), 13)))
            answer[:] = super().states(bodies)
            return answer


class AnswersInItsOwnOrder(Planted):
    class Defect(BallisticSimulation):
        def states(self, bodies: Sequence[int]) -> Array:
            return super().states(sorted(bodies))


class DigestsWithoutVelocity(Planted):
    class Defect(BallisticSimulation):
        def digest(self) -> bytes:
            moving = [(body, body.linear) for body in self._bodies.values()]
            for body, _ in moving:
                body.linear = ZERO
            digest = super().digest()
            for body, linear in moving:
                body.linear = linear
            return digest


class DigestsRounded(Planted):
    class Defect(BallisticSimulation):
        def digest(self) -> bytes:
            exact = [(body, body.position) for body in self._bodies.values()]
            for body, (x, y, z) in exact:
                body.position = (float(np.float32(x)), float(np.float32(y)), float(np.float32(z)))
            digest = super().digest()
            for body, position in exact:
                body.position = position
            return digest


class DigestsWithoutForces(Planted):
    class Defect(BallisticSimulation):
        def digest(self) -> bytes:
            waiting = [(body, body.force) for body in self._bodies.values()]
            for body, _ in waiting:
                body.force = ZERO
            digest = super().digest()
            for body, force in waiting:
                body.force = force
            return digest


class DependsOnTheProcess(Planted):
    class Defect(BallisticSimulation):
        def add_body(self, body: int, spec: BodySpec) -> None:
            x, y, z = spec.position
            super().add_body(body, replace(spec, position=(x + hash("x") % 1000 * 1e-12, y, z)))


class SharesState(Planted):
    class Defect(BallisticSimulation):
        steps: ClassVar[int] = 0

        def step(self, substeps: int) -> None:
            super().step(substeps)
            type(self).steps += 1
            for body in self._bodies.values():
                if not body.frozen:
                    body.linear = (body.linear[0] + 1e-9 * (self.steps % 2), *body.linear[1:])


class ChangesWhenAsked(Planted):
    class Defect(BallisticSimulation):
        def sleeping(self, body: int) -> bool:
            x, y, z = self._bodies[body].linear
            self._bodies[body].linear = (x * (1 + 1e-15), y, z)
            return False


class DisturbsOthers(Planted):
    class Defect(BallisticSimulation):
        def add_body(self, body: int, spec: BodySpec) -> None:
            for other in self._bodies.values():
                x, y, z = other.position
                other.position = (x, float(np.nextafter(y, 0)), z)
            super().add_body(body, spec)


class FallsFrozen(Planted):
    class Defect(BallisticSimulation):
        def set_frozen(self, body: int, frozen: bool) -> None:
            velocity = self._bodies[body].linear
            super().set_frozen(body, frozen)
            self._bodies[body].linear = velocity


class PushesWhatWasFrozen(Planted):
    class Defect(BallisticSimulation):
        def set_frozen(self, body: int, frozen: bool) -> None:
            impulse = self._bodies[body].impulse
            super().set_frozen(body, frozen)
            self._bodies[body].impulse = impulse


class FallsTooSlowly(Planted):
    def create(self, scene: SceneSpec) -> BallisticSimulation:
        x, y, z = scene.gravity
        return BallisticSimulation(replace(scene, gravity=(x, y * 0.9999, z)))


class StandsInTheGround(Planted):
    class Defect(BallisticSimulation):
        def step(self, substeps: int) -> None:
            super().step(substeps)
            for body in self._bodies.values():
                if body.ground_force:
                    body.position = (body.position[0], body.position[1] - 0.02, body.position[2])


class BouncesHigher(Planted):
    class Defect(BallisticSimulation):
        def add_body(self, body: int, spec: BodySpec) -> None:
            super().add_body(body, replace(spec, restitution=spec.restitution * 1.2))


class SlidesWithoutFriction(Planted):
    class Defect(BallisticSimulation):
        def add_body(self, body: int, spec: BodySpec) -> None:
            super().add_body(body, replace(spec, friction=0.0))


class CutsToRest(Planted):
    class Defect(BallisticSimulation):
        def remove_joint(self, joint: int) -> None:
            spec = self._joints[joint]
            super().remove_joint(joint)
            self._bodies[spec.body2].linear = ZERO


class JoinsLoosely(Planted):
    class Defect(BallisticSimulation):
        def step(self, substeps: int) -> None:
            super().step(substeps)
            for spec in self._joints.values():
                x, y, z = self._bodies[spec.body2].position
                self._bodies[spec.body2].position = (x, y + 1e-4, z)


class AcceptsEveryJoint(Planted):
    class Defect(BallisticSimulation):
        def add_joint(self, joint: int, spec: JointSpec) -> None:
            super().add_joint(joint, replace(spec, kind="fixed"))


class PromisesSleep(Planted):
    capabilities = BallisticBackend.capabilities | {"sleep"}


class InventsACapability(Planted):
    capabilities = BallisticBackend.capabilities | {"telepathy"}


class PromisesWhatItLacks(Planted):
    lacking: ClassVar = {"joint.fixed": "install glue"}


class SavesWithoutForces(Planted):
    class Defect(BallisticSimulation):
        def restore(self, snapshot: bytes) -> None:
            super().restore(snapshot)
            for body in self._bodies.values():
                body.force = ZERO


class SavesRounded(Planted):
    class Defect(BallisticSimulation):
        def restore(self, snapshot: bytes) -> None:
            super().restore(snapshot)
            for body in self._bodies.values():
                x, y, z = body.linear
                body.linear = (round(x, 12), y, z)


class NeverFaults(Planted):
    class Defect(BallisticSimulation):
        def step(self, substeps: int) -> None:
            before = copy.deepcopy(self._bodies)
            try:
                super().step(substeps)
            except Exception:
                self._bodies = before
                self._clusters = None


class ShowsTheFault(Planted):
    class Defect(BallisticSimulation):
        def step(self, substeps: int) -> None:
            try:
                super().step(substeps)
            except Exception:
                body = next(iter(self._bodies.values()))
                body.position = (float("inf"), 0.0, 0.0)
                raise


class KeepsItsWorlds(Planted):
    kept: ClassVar[list[Any]] = []

    def create(self, scene: SceneSpec) -> BallisticSimulation:
        memory = mmap.mmap(-1, 1 << 20)  # memory of its own: none that earlier tests freed and did not give back
        memory.write(bytes([1]) * len(memory))
        self.kept.append(memory)
        return BallisticSimulation(scene)


class PlantedInThePlane(PymunkBackend):
    """The planar engine with a defect."""

    class Defect(PymunkSimulation):
        pass

    def create(self, scene: SceneSpec) -> PymunkSimulation:
        return self.Defect(scene)


class ReadsEffortWithoutSign(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def joint_state(self, joint: int) -> JointState:
            state = super().joint_state(joint)
            return replace(state, effort=abs(state.effort))


class ReadsJointsTheOtherWay(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def joint_state(self, joint: int) -> JointState:
            state = super().joint_state(joint)
            return replace(state, position=-state.position)


class ForgetsJointsOfTheFrozen(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def set_frozen(self, body: int, frozen: bool) -> None:
            super().set_frozen(body, frozen)
            for j in self._bodies[body].joints.values():
                if j.one.frozen and j.two.frozen:
                    j.zero = j.two.body.angle - j.one.body.angle


class DigestsOnlyMotorsThatDrive(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def set_joint_params(self, joint: int, params: JointParams) -> None:
            idle = params.motor == "off" or params.max_effort == 0.0
            super().set_joint_params(joint, params.with_target(0.0) if idle else params)


class DrivesTooHard(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def add_joint(self, joint: int, spec: JointSpec) -> None:
            strong = replace(spec.params, max_effort=1.5 * spec.params.max_effort)
            super().add_joint(joint, replace(spec, params=strong))


class MetersMotorsAsAStepEnds(PlantedInThePlane):
    class Defect(PymunkSimulation):
        powers = Simulation.powers


class ForgetsLimits(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def add_joint(self, joint: int, spec: JointSpec) -> None:
            super().add_joint(joint, replace(spec, params=replace(spec.params, limits=None)))


class HoldsOnToLimits(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def set_joint_params(self, joint: int, params: JointParams) -> None:
            super().set_joint_params(joint, replace(params, limits=self._joints[joint].params.limits))


class SpringsTooSoftly(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def add_joint(self, joint: int, spec: JointSpec) -> None:
            soft = replace(spec.params, stiffness=0.95 * spec.params.stiffness)
            super().add_joint(joint, replace(spec, params=soft))


class LosesItsScenery(PlantedInThePlane):
    def create(self, scene: SceneSpec) -> PymunkSimulation:
        return PymunkSimulation(replace(scene, boxes=()))


class ConfusesSwingAndTwist(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def add_joint(self, joint: int, spec: JointSpec) -> None:
            limits = spec.params.limits
            swapped = replace(spec.params, limits=None if limits is None else limits[::-1])
            super().add_joint(joint, replace(spec, params=swapped))


class ReadsSwingsAsTwists(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def joint_state(self, joint: int) -> JointState:
            return replace(super().joint_state(joint), position=self._joints[joint].measure()[0])


class SleepsOnInTheAir(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def remove_body(self, body: int) -> None:
            self.set_body_state(body, BodyState((1e5, 1e5, 0.0), (0.0, 0.0, 0.0, 1.0), ZERO, ZERO))
            asleep = [b.body for b in self._bodies.values() if b.number != body and not b.frozen]
            super().remove_body(body)
            for other in asleep:
                other.sleep()


class DrivesOnlyTheFirst(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def set_motor_targets(self, joints: Sequence[int], params: Sequence[JointParams], targets: Array) -> None:
            super().set_motor_targets(joints[:1], params[:1], targets[:1])


class ReadsManyInItsOwnOrder(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def joint_readings(self, joints: Sequence[int]) -> Array:
            return super().joint_readings(sorted(joints))


class FeelsOnlyTheGround(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def touching(self, bodies: Sequence[int]) -> Array:
            return np.array([float(any(c.other is None for c in self.contacts(body))) for body in bodies[::-1]])


class DampsSpinsAsMotion(PlantedInThePlane):
    def create(self, scene: SceneSpec) -> PymunkSimulation:
        return PymunkSimulation(replace(scene, angular_damping=scene.linear_damping))


class DampsOnlyFreeBodies(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def add_joint(self, joint: int, spec: JointSpec) -> None:
            super().add_joint(joint, spec)
            self._space.damping = 1.0


class KeepsAwakeByDamping(PlantedInThePlane):
    class Defect(PymunkSimulation):
        def step(self, substeps: int) -> None:
            for b in self._bodies.values():
                if not b.frozen:
                    b.body.velocity *= 1.0  # to set it is to wake the body
            super().step(substeps)


class ForgetsWhoIsFrozen(Planted):
    class Defect(BallisticSimulation):
        def members(self) -> tuple[dict[int, bool], dict[int, tuple[str, int, int]]]:
            bodies, joints = super().members()
            return dict.fromkeys(bodies, False), joints


class TakesUpWhatIsCut(Planted):
    class Defect(BallisticSimulation):
        def restore(self, snapshot: bytes) -> None:
            with suppress(WorldError):
                super().restore(snapshot)


class DrawsLyingDown(Planted):
    capabilities = Planted.capabilities | {"camera"}

    class Defect(BallisticSimulation):
        def draw(self, camera: CameraSpec, colors: Mapping[int, tuple[float, float, float, float]]) -> Image:
            (color,) = colors.values()
            return np.full((camera.width, camera.height, 3), [round(255 * part) for part in color[:3]], np.uint8)


class DrawsAllInGrey(DrawsLyingDown):
    class Defect(BallisticSimulation):
        def draw(self, camera: CameraSpec, colors: Mapping[int, tuple[float, float, float, float]]) -> Image:
            return np.full((camera.height, camera.width, 3), 99, np.uint8)


class HasNoArena(Planted):
    capabilities = Planted.capabilities | {"scene.arena"}


LACKED = {
    DrawsLyingDown: "draws_what_a_camera_sees",
    DrawsAllInGrey: "draws_what_a_camera_sees",
    HasNoArena: "makes_arenas",
}
"""Defects of what the engines without defects here do not promise."""
CAUGHT = {
    ForgetsWhoIsFrozen: "tells_its_members",
    TakesUpWhatIsCut: "survives_snapshots_of_anybody",
    DropsImpulses: "applies_forces_and_impulses",
    TurnsTheWrongWay: "applies_forces_and_impulses",
    KeepsOnlyTheLastForce: "applies_forces_and_impulses",
    NeverLetsGo: "applies_forces_and_impulses",
    KicksAtOnce: "applies_forces_and_impulses",
    AnswersFromAStaleCache: "gives_arrays_away",
    KeepsItsAnswers: "gives_arrays_away",
    AnswersInItsOwnOrder: "answers_states_as_rows",
    DigestsWithoutVelocity: "digests_every_bit",
    DigestsRounded: "digests_every_bit",
    DigestsWithoutForces: "digests_every_bit",
    DependsOnTheProcess: "repeats_itself_in_fresh_processes",
    SharesState: "repeats_itself",
    ChangesWhenAsked: "queries_change_nothing",
    DisturbsOthers: "leaves_alone_what_an_edit_does_not_touch",
    FallsFrozen: "freezes",
    PushesWhatWasFrozen: "drops_what_acts_on_a_body_that_is_frozen",
    FallsTooSlowly: "falls_along_the_parabola",
    StandsInTheGround: "rests_on_the_ground",
    BouncesHigher: "bounces",
    SlidesWithoutFriction: "slides_only_beyond_the_critical_slope",
    CutsToRest: "keeps_momentum_when_cut",
    JoinsLoosely: "holds_joints_together",
    AcceptsEveryJoint: "refuses_the_joints_it_does_not_promise",
    PromisesSleep: "sleeps_only_if_it_says_so",
    InventsACapability: "introduces_itself",
    PromisesWhatItLacks: "introduces_itself",
    SavesWithoutForces: "restores_snapshots",
    SavesRounded: "restores_snapshots",
    NeverFaults: "faults_when_it_diverges",
    ShowsTheFault: "faults_when_it_diverges",
    KeepsItsWorlds: "releases_what_it_holds",
    ReadsEffortWithoutSign: "drives_motors",
    ReadsJointsTheOtherWay: "reads_joints",
    ForgetsJointsOfTheFrozen: "keeps_joints_that_are_frozen_at_both_ends",
    DigestsOnlyMotorsThatDrive: "digests_targets_that_nothing_drives_towards",
    DrivesTooHard: "drives_motors",
    MetersMotorsAsAStepEnds: "power_is_what_the_motor_gives_to_the_scene",
    ForgetsLimits: "stops_at_limits",
    HoldsOnToLimits: "stops_at_limits",
    SpringsTooSoftly: "hangs_a_mass_on_a_spring",
    LosesItsScenery: "stands_on_scenery",
    ConfusesSwingAndTwist: "swings_and_twists_within_a_cone",
    ReadsSwingsAsTwists: "reads_twists",
    DrivesOnlyTheFirst: "drives_and_reads_many_joints_at_once",
    ReadsManyInItsOwnOrder: "drives_and_reads_many_joints_at_once",
    DampsSpinsAsMotion: "damps_free_bodies",
    DampsOnlyFreeBodies: "damps_joined_bodies",
    KeepsAwakeByDamping: "damped_bodies_sleep",
    FeelsOnlyTheGround: "drives_and_reads_many_joints_at_once",
    SleepsOnInTheAir: "sleeps_only_if_it_says_so",
}


def _contract(backend: type[Backend]) -> BackendContract:
    contract: type[BackendContract] = type("Contract", (BackendContract,), {"backend": backend, "programs": 1})
    return contract()


@pytest.mark.parametrize(
    ("backend", "check"), [*CAUGHT.items(), *LACKED.items()], ids=[backend.__name__ for backend in (*CAUGHT, *LACKED)]
)
def test_a_planted_defect_is_caught(backend: type[Backend], check: str) -> None:
    with pytest.raises(AssertionError):
        getattr(_contract(backend), f"test_{check}")()


@pytest.mark.parametrize("backend", [Planted, PlantedInThePlane])
def test_the_checks_pass_where_nothing_is_planted(backend: type[Backend]) -> None:
    for check in dict.fromkeys(check for planted, check in CAUGHT.items() if issubclass(planted, backend)):
        getattr(_contract(backend), f"test_{check}")()


def test_an_engine_is_checked_by_a_test_class_of_one_line() -> None:
    class TestMine(BackendContract):
        backend = BallisticBackend

    checks = [name for name in dir(TestMine) if name.startswith("test_")]
    assert len(checks) > 35
    assert all(getattr(TestMine, name).__doc__ for name in checks)
