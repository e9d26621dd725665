"""Structures of the MuJoCo engine while they change; and programs run twice, with and without looking, and restored."""

from __future__ import annotations

import random
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_mujoco import NONE, STEP, box, grid, kinetic_energy, momentum, scene, vector

import programs
from layout import SUPPORT
from nmes import World
from nmes.backend import Array, JointParams, JointSpec, SceneSpec, Vector
from nmes.backend.shapes import SHAPES, Shape, fitted
from nmes.backends.mujoco3d import MujocoSimulation, compiler, rebuild
from nmes.backends.mujoco3d.compiler import compile_lone_body, compile_model
from nmes.backends.mujoco3d.forest import Body, spanning_forest
from nmes.backends.mujoco3d.model import SPARE, CompiledModel, occupy, set_mean_inertia
from nmes.backends.mujoco3d.scenery import Scenery
from nmes.errors import SimulationFault
from nmes.playback import replay
from nmes.recording import Recorder
from nmes.world.journal import Journal

# -- structural change -----------------------------------------------------------------------------------------------


def test_cutting_a_structure_conserves_momentum_and_motion() -> None:
    simulation = scene(gravity=0)
    grid(simulation, height=20.0)
    masses = dict.fromkeys(range(1, 10), 1.0)
    simulation.apply(1, NONE, NONE, (0.5, 1.0, 0.0), (0.1, 0.2, 0.3))
    simulation.apply(6, NONE, NONE, (0.5, -1.0, 1.0), NONE)
    for _ in range(120):
        simulation.step(4)
    before = momentum(simulation, masses)
    poses = simulation.states(range(1, 10))
    for joint in (1, 4, 7):
        simulation.remove_joint(joint)
    simulation.snapshot()  # takes up the edits without a step
    after, now = momentum(simulation, masses), simulation.states(range(1, 10))
    assert after[0] == pytest.approx(before[0], abs=1e-5) and after[1] == pytest.approx(before[1], abs=1e-4)
    assert now[:, :7] == pytest.approx(poses[:, :7], abs=1e-9)
    assert now[:, 7:] == pytest.approx(poses[:, 7:], abs=1e-4)  # what a soft loop lets through


@pytest.mark.parametrize("kind", ["fixed", "hinge", "slide", "pin", "conetwist"])
def test_joining_two_moving_cubes_catches_them_with_their_momentum(kind: str) -> None:
    simulation = scene(gravity=0)
    masses = {1: 1.0, 2: 3.0}
    simulation.add_body(1, box((0.0, 5.0, 0.0), velocity=(1.0, 0.5, 0.0), spin=(0.0, 2.0, 1.0)))
    simulation.add_body(2, box((1.5, 5.0, 0.3), mass=3.0, velocity=(-1.0, 0.0, 0.7), spin=(1.0, 0.0, 0.0)))
    simulation.step(4)
    before, energy = momentum(simulation, masses), kinetic_energy(simulation, masses)
    simulation.add_joint(1, JointSpec(kind, 1, 2, (0.7, 5.0, 0.1), vector(np.array([1.0, 2.0, 2.0]) / 3)))
    simulation.snapshot()
    after = momentum(simulation, masses)
    assert after[0] == pytest.approx(before[0], abs=1e-9) and after[1] == pytest.approx(before[1], abs=1e-9)
    assert kinetic_energy(simulation, masses) < energy


@given(st.integers(0, 10_000))
def test_an_edit_keeps_the_pose_and_velocity_of_a_tree(number: int) -> None:
    """A chain under motors; then its root freezes, so that the tree runs the other way: nothing may jump."""
    source = np.random.default_rng(number)
    simulation = scene()
    kinds = source.choice(["hinge", "slide", "pin", "fixed", "conetwist"], 4)
    for i in range(5):
        simulation.add_body(i + 1, box((1.2 * i, 9.0, 0.0)))
    for i, kind in enumerate(kinds.tolist()):
        axis = source.normal(size=3)
        params = JointParams(motor="velocity", target_velocity=float(source.uniform(-2, 2)), max_effort=20.0)
        simulation.add_joint(
            i + 1,
            JointSpec(
                kind,
                i + 1,
                i + 2,
                (1.2 * i + 0.6, 9.0, 0.0),
                vector(axis / np.linalg.norm(axis)),
                {"hinge": params, "slide": params, "conetwist": JointParams(limits=(0.6, 0.4))}.get(
                    kind, JointParams()
                ),
            ),
        )
    for _ in range(20):
        simulation.step(4)
    readings = [simulation.joint_state(joint) for joint in range(1, 5)]
    poses = simulation.states(range(1, 6))
    simulation.add_body(9, box((0.0, 20.0, 0.0), frozen=True))
    simulation.add_joint(9, JointSpec("pin", 9, 5, (4.8, 9.0, 0.0), (1.0, 0.0, 0.0)))
    simulation.remove_joint(9)
    simulation.snapshot()
    assert simulation.states(range(1, 6)) == pytest.approx(poses, abs=1e-9)
    # The last cube becomes the root: joints keep their sign and their zero.
    simulation.set_frozen(5, True)
    simulation.snapshot()
    assert simulation.states(range(1, 6))[:, :7] == pytest.approx(poses[:, :7], abs=1e-9)
    for joint, before in zip(range(1, 5), readings, strict=True):
        assert simulation.joint_state(joint).position == pytest.approx(before.position, abs=1e-12)


def test_a_bent_loop_that_was_frozen_as_a_whole_is_released_as_it_was() -> None:
    """Four cubes in a ring of hinges, which is moved while no joint of it moves, and saved."""
    simulation = scene(gravity=0)
    corners = {1: (0.0, 5.0, 0.0), 2: (2.0, 5.0, 0.0), 3: (2.0, 7.0, 0.0), 4: (0.0, 7.0, 0.0)}
    for body, corner in corners.items():
        simulation.add_body(body, box(corner))
    motor = JointParams("velocity", target_velocity=1.0, max_effort=50.0)
    for joint, (one, two) in enumerate([(1, 2), (2, 3), (3, 4), (4, 1)], 1):
        middle = vector(np.add(corners[one], corners[two]) / 2)
        params = motor if joint == 1 else JointParams()
        simulation.add_joint(joint, JointSpec("hinge", one, two, middle, (0.0, 0.0, 1.0), params))
    for _ in range(30):
        simulation.step(4)
    simulation.set_joint_params(1, JointParams())
    bent = simulation.joint_readings([1, 2, 3, 4])[:, 0]
    assert (abs(bent) > 0.3).all()
    for body in corners:
        simulation.set_frozen(body, True)
    simulation.step(4)
    for body in corners:
        state = simulation.body_state(body)
        simulation.set_body_state(body, replace(state, position=vector(np.add(state.position, (9.0, 0.0, 0.0)))))
    simulation.step(4)
    poses = simulation.states([*corners])[:, :7]
    restored = scene(gravity=0)
    restored.restore(simulation.snapshot())
    for each in (simulation, restored):
        for body in corners:
            each.set_frozen(body, False)
        each.step(4)
        assert each.states([*corners])[:, :7] == pytest.approx(poses, abs=1e-4)  # what a soft loop lets through
        assert each.joint_readings([1, 2, 3, 4])[:, 0] == pytest.approx(bent, abs=1e-4)
    assert restored.digest() == simulation.digest()


def test_an_edit_leaves_other_structures_bit_for_bit() -> None:
    def settle(edit: bool) -> Array:
        simulation = scene()
        for i in range(4):
            simulation.add_body(i + 1, box((3.0 * i, 2.0, 0.0), euler=(0.1 * i, 0.2, 0.3)))
        simulation.add_joint(1, JointSpec("hinge", 1, 2, (1.5, 2.0, 0.0), (0.0, 0.0, 1.0)))
        for _ in range(45):
            simulation.step(4)
        if edit:
            simulation.add_body(9, box((90.0, 2.0, 0.0)))
            simulation.add_joint(9, JointSpec("fixed", 9, 4, (50.0, 2.0, 0.0), (1.0, 0.0, 0.0)))
        simulation.snapshot()
        return simulation.states([1, 2, 3])

    assert settle(edit=True).tobytes() == settle(edit=False).tobytes()


def test_an_edit_leaves_a_heap_that_slides_elsewhere_bit_for_bit() -> None:
    """Its contacts are solved from where the solver left off, as if there had been no edit."""

    def slide(edit: bool) -> list[bytes]:
        simulation = scene()
        simulation.add_body(1, box((0.0, 0.5, 0.0), euler=(0.3, 0.2, 0.3)))
        simulation.add_body(2, box((0.2, 1.9, 0.1), euler=(0.1, 0.2, 0.3)))
        simulation.add_body(3, box((90.0, 2.0, 0.0)))
        simulation.step(48)
        if edit:
            simulation.add_body(4, box((92.0, 2.0, 0.0)))
            simulation.add_joint(1, JointSpec("fixed", 4, 3, (91.0, 2.0, 0.0), (1.0, 0.0, 0.0)))
        after = []
        for _ in range(8):
            simulation.step(1)
            after.append(simulation.states([1, 2]).tobytes())
        return after

    undisturbed = slide(edit=False)
    assert len({*undisturbed}) == 8
    assert slide(edit=True) == undisturbed


def test_sleepers_wake_when_touched_pushed_joined_or_undermined() -> None:
    def asleep() -> MujocoSimulation:
        simulation = scene()
        simulation.add_body(1, box((0.0, 0.5, 0.0), frozen=True))
        simulation.add_body(2, box((0.0, 1.5, 0.0)))
        simulation.add_body(3, box((5.0, 0.5, 0.0)))
        for _ in range(120):
            simulation.step(4)
        assert simulation.sleeping(2) and simulation.sleeping(3) and not simulation.sleeping(1)
        return simulation

    simulation = asleep()
    simulation.remove_body(1)
    simulation.step(4)
    assert not simulation.sleeping(2) and simulation.body_state(2).linear_velocity[1] < 0

    simulation = asleep()
    simulation.set_frozen(1, False)
    simulation.step(4)
    assert not simulation.sleeping(2)

    simulation = asleep()
    simulation.apply(3, (0.0, 0.0, 20.0), NONE, NONE, NONE)
    simulation.step(4)
    assert not simulation.sleeping(3) and simulation.sleeping(2)

    simulation = asleep()
    simulation.add_body(4, box((5.0, 3.0, 0.0)))
    simulation.step(4)
    assert simulation.sleeping(3) and simulation.sleeping(2)
    woken = False
    for _ in range(60):
        simulation.step(4)
        woken |= not simulation.sleeping(3)
    assert woken

    simulation = asleep()
    simulation.add_joint(1, JointSpec("hinge", 2, 3, (2.5, 1.0, 0.0), (0.0, 0.0, 1.0)))
    simulation.step(4)
    assert not simulation.sleeping(2) and not simulation.sleeping(3)


@pytest.mark.parametrize("count", [2, 20, 100])
def test_cubes_spawned_at_one_point_come_apart_at_bounded_speed(count: int) -> None:
    simulation = scene()
    cubes = range(1, count + 1)
    for body in cubes:
        simulation.add_body(body, box((0.0, 3.0, 0.0)))
    fastest = 0.0
    for _ in range(240):
        simulation.step(4)
        fastest = max(fastest, float(np.linalg.norm(simulation.states(cubes)[:, 7:10], axis=1).max()))
    assert 3.0 < fastest < 15.0
    where = simulation.states(cubes)[:, :3]
    apart = np.linalg.norm(where[:, None] - where, axis=2) + np.eye(count) * 9
    assert apart.min() > 0.9


@pytest.mark.parametrize(
    ("room", "code"), [(100, "contact_overflow"), (300, "constraint_overflow"), (500, "arena_exhausted")]
)
def test_an_engine_out_of_memory_faults_its_world(room: int, code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler, "arena_bytes", lambda bodies: room << 10)
    monkeypatch.setattr(compiler, "_SMALL", -1)  # neither models with more room from before, nor these for others
    monkeypatch.setattr("nmes.backends.mujoco3d.crowds._CROWD", 99)  # nobody glides away
    crowded, quiet = World({"mode": "lockstep"}), World({"mode": "lockstep"})
    client, other = crowded.join(), quiet.join()
    quiet.execute(other, {"type": "spawn_cube", "position": [0, 3, 0]})
    quiet.execute(other, {"type": "step", "ticks": 10})
    alone = quiet.digest()
    for _ in range(12):
        crowded.execute(client, {"type": "spawn_cube", "position": [0, 3, 0]})
    assert crowded.execute(client, {"type": "step"})["code"] == "world_faulted"
    assert crowded.fault is not None and (crowded.fault.code, crowded.fault.frame) == (code, 0)
    assert (crowded.fault.cube is None) == (code == "arena_exhausted")  # which breaks off whatever it is in
    assert quiet.digest() == alone and quiet.execute(other, {"type": "step"})["frame"] == 11
    crowded.execute(client, {"type": "reset"})
    crowded.execute(client, {"type": "spawn_cube", "position": [0, 3, 0]})
    assert crowded.execute(client, {"type": "step"})["frame"] == 1


@pytest.mark.parametrize(("room", "code"), [(60, "contact_overflow"), (120, "constraint_overflow")])
def test_an_engine_without_room_for_contacts_names_the_cube_that_has_most(
    room: int, code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "arena_bytes", lambda bodies: room << 10)
    monkeypatch.setattr(compiler, "_SMALL", -1)
    world = World({"mode": "lockstep"})
    client = world.join()
    places = [(x, z) for x in range(-2, 3) for z in range(-2, 3)]
    for i, (x, z) in enumerate(places):
        world.execute(client, {"type": "spawn_cube", "position": [0.5 * x, 1.2, 0.5 * z], "size": 0.4})
        if i == 11:
            world.execute(
                client, {"type": "spawn_cube", "cube_name": "plate", "position": [0, 0.5, 0], "size": [4, 1, 4]}
            )
    assert world.execute(client, {"type": "step"})["code"] == "world_faulted"
    assert world.fault is not None and (world.fault.code, world.fault.cube) == (code, "plate")
    assert world.fault.message.endswith("(cube plate)")


def test_a_divergence_names_its_body() -> None:
    simulation = scene()
    simulation.add_body(1, box((0.0, 0.5, 0.0)))
    simulation.add_body(7, box((4.0, 0.5, 0.0)))
    simulation.step(4)
    simulation.apply(7, (1e14, 0.0, 0.0), NONE, NONE, NONE)
    with pytest.raises(SimulationFault) as fault:
        simulation.step(4)
    assert (fault.value.code, fault.value.body) == ("diverged", 7)


def test_a_divergence_names_the_body_with_which_it_began() -> None:
    """By the end of the step those are no numbers, too, that the engine computed beside it, or that it has struck."""
    simulation = scene()
    for body, place in ((1, (0.0, 0.5, 0.0)), (7, (4.0, 0.5, 0.0)), (9, (5.05, 0.5, 0.0))):
        simulation.add_body(body, box(place))
    simulation.step(4)
    simulation.apply(9, NONE, NONE, (0.0, 9e3, 0.0), NONE)  # as fast as it is, it goes on as it did
    simulation.step(4)
    simulation.apply(7, (1e200, 0.0, 0.0), NONE, NONE, NONE)
    with pytest.raises(SimulationFault) as fault:
        simulation.step(4)
    assert (fault.value.code, fault.value.body) == ("diverged", 7)


def test_a_step_that_failed_leaves_a_scene_as_it_was() -> None:
    """In the failing step the crowd begins to come apart, which is seen by whom of it the engine watches."""
    simulation = scene()
    simulation.add_body(99, box((30.0, 5.0, 0.0)))
    for body in range(12):
        simulation.add_body(body, box((0.0, 3.0, 0.0)))
    simulation.snapshot()  # takes up the edits
    simulation.apply(99, NONE, NONE, (1e14, 0.0, 0.0), NONE)
    before = simulation.snapshot()
    with pytest.raises(SimulationFault):
        simulation.step(4)
    assert simulation.recover()
    assert simulation.snapshot() == before


# -- determinism -----------------------------------------------------------------------------------------------------


def numbers(first: int, short: int, long: int) -> list[Any]:
    """Returns the numbers of drawn programs: so many of them, and more in the long tests."""
    later = (pytest.param(number, marks=pytest.mark.long) for number in range(first + short, first + long))
    return [*range(first, first + short), *later]


def world(number: int) -> World:
    return World({"mode": "lockstep", "seed": number})


@pytest.mark.parametrize("number", numbers(0, 15, 40))
def test_a_program_gives_the_same_world_again_with_or_without_queries(number: int) -> None:
    program = programs.draw(number, 60)
    replies, digests = programs.play(world(number), program)
    again = programs.play(world(number), program)
    assert again == (replies, digests)
    assert programs.play(world(number), program, queries=False)[1] == digests
    assert not [reply for reply in replies if reply.get("code") in ("internal", "world_faulted")]


class Onlooker(Journal):
    """A journal that looks at all poses after some ticks, as a recorder does, and keeps nothing."""

    def __init__(self, watched: World) -> None:
        self.watched = watched

    def ticked(self, frame: int, digest: bytes) -> None:
        if frame % 6 == 0:
            self.watched.poses()


@pytest.mark.parametrize(
    "number", [*numbers(130, 10, 20), 1527]
)  # 1527: a branch of a frozen root wakes between readings
def test_queries_change_no_later_state(number: int) -> None:
    program, watched = programs.draw(number, 100), world(number)
    watched.journal = Onlooker(watched)
    assert programs.play(watched, program) == programs.play(world(number), program)


@pytest.mark.parametrize("number", numbers(40, 15, 30))
def test_a_restored_world_continues_like_the_saved_one(number: int) -> None:
    program = programs.draw(number, 80)
    first, second = world(number), world(number)
    programs.play(first, program[:40])
    programs.play(second, program[:40])
    assert first.fault is None
    snapshot = first.simulation.snapshot()
    second.simulation.snapshot()
    second.simulation.restore(snapshot)
    assert first.digest() == second.digest()
    assert programs.play(first, program[40:]) == programs.play(second, program[40:])


@pytest.mark.parametrize("number", range(70, 90))
def test_the_grouping_of_edits_within_a_tick_does_not_matter(number: int) -> None:
    """Whatever comes between two ticks may come in one message or in many."""
    alone, grouped = world(number), world(number)
    client, other = alone.join(), grouped.join()
    source, waiting = random.Random(number), list[dict[str, Any]]()

    def send() -> None:
        while waiting:
            size = source.randint(1, len(waiting))
            grouped.execute(other, {"type": "batch", "commands": waiting[:size]})
            del waiting[:size]

    for step in programs.draw(number, 80):
        for command in programs.commands(alone, step, queries=False):
            alone.execute(client, command)
            if command["type"] == "step":
                send()
                grouped.execute(other, command)
                assert grouped.digest() == alone.digest()
            else:
                waiting.append(command)


@pytest.mark.long
@pytest.mark.parametrize("hundred", range(10))
def test_a_thousand_programs_run_twice_and_replayed(hundred: int, tmp_path: Path) -> None:
    for number in range(1000 + 100 * hundred, 1100 + 100 * hundred):
        program = programs.draw(number, 100)
        recorded = world(number)
        path = tmp_path / f"{number}.mcap"
        recorder = recorded.journal = Recorder(path, recorded)
        played = programs.play(recorded, program)
        recorder.close()
        assert programs.play(world(number), program) == played, number
        assert replay(path).verdict == "reproduced", number


PLAY = """
import sys
import programs
from nmes import World
world = World({"mode": "lockstep", "seed": 3})
replies, digests = programs.play(world, programs.draw(int(sys.argv[1]), 120))
print(digests[-1].hex(), len(replies), replies[-1])
"""


def test_fresh_processes_reach_the_same_digests() -> None:
    here = SUPPORT

    def run(number: int, seed: str) -> str:
        return subprocess.run(
            [sys.executable, "-c", PLAY, str(number)],
            cwd=here,
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": str(here)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout

    assert run(5, "1") == run(5, "2") != run(6, "1")


# -- models that are kept --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", range(200, 215))
def test_worlds_of_kept_models_do_what_worlds_of_their_own_models_do(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same program with models compiled anew each time, and twice with those that were kept."""
    program = programs.draw(number, 60)
    with monkeypatch.context() as patch:
        patch.setattr(compiler, "_SMALL", -1)
        alone = programs.play(world(number), program)
    for _ in range(2):
        assert programs.play(world(number), program) == alone


# -- parked bodies ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", numbers(100, 15, 30))
def test_parked_bodies_do_not_affect_the_world(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same programs with parked bodies from the second cube on: repeatable, and restored exactly."""
    monkeypatch.setattr(rebuild, "PARKING_FROM", 2)
    program = programs.draw(number, 80)
    first, second = world(number), world(number)
    played = programs.play(first, program[:40])
    assert programs.play(second, program[:40]) == played
    snapshot = first.simulation.snapshot()
    second.simulation.snapshot()
    second.simulation.restore(snapshot)
    assert programs.play(first, program[40:]) == programs.play(second, program[40:])


@given(
    st.tuples(*[st.floats(0.01, 10)] * 3),
    st.floats(0.001, 1000),
    st.floats(0, 2),
    st.floats(0, 1),
    st.integers(1, 3),
    st.sampled_from(SHAPES),
)
def test_a_body_that_takes_a_parked_place_acts_like_a_compiled_one(
    size: Vector, mass: float, friction: float, restitution: float, before: int, shape: Shape
) -> None:
    flat = SceneSpec(timestep=STEP)
    size = fitted(shape, size)

    def laid(count: int, spares: int) -> CompiledModel:
        bodies = {n: Body(n, (1.0, 0.5, 0.25), 2.0, 0.7, 0.0, False) for n in range(1, before + 1)}
        if count:
            bodies[9] = Body(9, size, mass, friction, restitution, False, shape=shape)
        forest = spanning_forest(bodies, ())
        return compile_model(flat, Scenery(flat), bodies, {}, forest, {}, [*forest.trees, *[SPARE] * spares])

    compiled, filled = laid(1, 1), laid(0, 2)
    body = Body(9, size, mass, friction, restitution, False, shape=shape)
    occupy(filled, body, compile_lone_body(SceneSpec(timestep=STEP), body))
    set_mean_inertia(filled)
    for name in dir(compiled.model):
        one, other = getattr(compiled.model, name), getattr(filled.model, name)
        if isinstance(one, np.ndarray) and not name.startswith("name"):
            if name == "body_subtreemass":  # the world's own is for show
                one, other = one[1:], other[1:]
            assert np.array_equal(one, other), name
    assert compiled.model.stat.meaninertia == filled.model.stat.meaninertia


def test_free_cubes_are_added_and_removed_without_compiling(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rebuild, "PARKING_FROM", 8)
    simulation = scene()
    for i in range(20):
        simulation.add_body(i + 1, box((1.5 * i, 0.5, 0.0)))
    simulation.step(4)
    compiled: list[int] = []

    def count(*args: Any) -> CompiledModel:
        compiled.append(1)
        return compile_model(*args)

    monkeypatch.setattr(rebuild, "compile_model", count)
    for i in range(20, 36):
        simulation.add_body(i + 1, box((1.5 * (i - 20), 3.0, 0.0), mass=0.5 + i))
        simulation.step(4)
    assert not compiled
    for body in range(5, 25):
        simulation.remove_body(body)
        simulation.add_body(body + 100, box((1.5 * body, 6.0, 3.0)))
        simulation.step(4)
    assert not compiled
    for i in range(20):
        simulation.add_body(i + 500, box((1.5 * i, 9.0, 9.0)))
        simulation.step(4)
    assert len(compiled) == 2  # all places were taken: one more cube makes room for sixteen more
    for _ in range(240):
        simulation.step(4)
    bodies = [*range(1, 5), *range(25, 37), *range(105, 125), *range(500, 520)]
    heights = simulation.states(bodies)[:, 1]
    assert (heights > 0.49).all() and (heights < 3.6).all()
