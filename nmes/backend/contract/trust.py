"""What makes a backend fit to be recorded and repeated: honesty, determinism, digests, snapshots, faults."""

from __future__ import annotations

import math
import os
import random
import subprocess
import sys
import threading
import unittest
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from nmes.backend import CAPABILITIES, BodySpec, JointParams, JointSpec, SceneSpec, Simulation
from nmes.backend.contract.base import (
    KINDS,
    SUBSTEPS,
    TICK,
    TIMESTEP,
    ZERO,
    Checks,
    about_z,
    assert_close,
    box,
    joint,
    run,
    vector,
)
from nmes.backend.contract.programs import all_states, execute, program_digest, random_program
from nmes.backend.shapes import ROUND
from nmes.errors import SimulationFault, WorldError


class TrustChecks(Checks):
    """Checks of what recordings and replays build on."""

    def test_introduces_itself(self) -> None:
        """Name, version, dims, capabilities and fingerprint are there, and stay."""
        first, second = self.backend(), self.backend()
        assert first.name and first.name.split() == [first.name], f"name: {first.name!r}"
        assert first.dims in (2, 3), f"dims: {first.dims}"
        unknown = (first.capabilities | first.lacking.keys()) - CAPABILITIES
        assert not unknown, f"unknown capabilities: {sorted(unknown)}"
        both = first.capabilities & first.lacking.keys()
        assert not both, f"promised and lacking: {sorted(both)}"
        assert first.version()
        fingerprint = first.fingerprint()
        assert fingerprint, "an empty fingerprint makes every two runs comparable"
        assert all(isinstance(text, str) for pair in fingerprint.items() for text in pair), fingerprint
        assert fingerprint == second.fingerprint(), "the fingerprint changes within one process"

    def test_refuses_the_joints_it_does_not_promise(self) -> None:
        """And a refused joint leaves no trace."""
        for kind in KINDS:
            sim = self.pair()
            before = sim.digest()
            if self.can(f"joint.{kind}"):
                sim.add_joint(0, joint(kind))
                assert sim.joint_state(0).position == 0.0
                continue
            try:
                sim.add_joint(0, joint(kind))
            except WorldError as error:
                assert error.code == "unsupported", f"{kind}: refused with {error.code!r}"
            else:
                raise AssertionError(f"made a {kind} joint, which is not among its capabilities")
            assert sim.digest() == before, f"{kind}: the refused joint changed the world"

    def test_has_snapshots_only_if_it_says_so(self) -> None:
        """Without the capability, `snapshot` and `restore` raise."""
        if self.can("snapshot"):
            return
        asks: tuple[Callable[[Simulation], object], ...] = (lambda s: s.snapshot(), lambda s: s.restore(b""))
        for ask in asks:
            try:
                ask(self.pair())
            except (NotImplementedError, WorldError):
                continue
            raise AssertionError("has snapshots, which are not among its capabilities")

    def test_sleeps_only_if_it_says_so(self) -> None:
        """Without the capability nobody sleeps; with it, a body at rest does, and wakes for each good reason."""
        sim = self.sim()
        sim.add_body(0, box((0.0, 0.5, 0.0)))
        sim.add_body(1, box((5.0, 0.25, 0.0), size=(1.0, 0.5, 1.0), frozen=True))
        sim.add_body(2, box((5.0, 1.0, 0.0)))
        run(sim, 10.0)
        assert not sim.sleeping(1), "a frozen body does not sleep"
        if not self.can("sleep"):
            assert not sim.sleeping(0) and not sim.sleeping(2), "sleeps, which is not among its capabilities"
            return
        assert sim.sleeping(0), "a body at rest for 10 s is awake"
        sim.apply(0, ZERO, ZERO, (1.0, 0.0, 0.0), ZERO)
        sim.step(SUBSTEPS)
        assert not sim.sleeping(0) and sim.body_state(0).linear_velocity[0] > 0.5, "a push does not wake it"
        if self.can("collisions"):
            assert sim.sleeping(2), "a body at rest on a frozen one is awake"
            sim.remove_body(1)
            run(sim, 1.0)
            height = sim.body_state(2).position[1]
            assert height < 0.6, f"sleeps on in the air, {height} m high, when what it rests on goes"

    def test_repeats_itself(self) -> None:
        """The same calls give the same digests; another world running between them changes nothing."""
        for seed in range(3):
            program = random_program(self.backend(), seed)
            first, second = self.sim(), self.sim()
            for number, (name, arguments) in enumerate(program):
                getattr(first, name)(*arguments)
                getattr(second, name)(*arguments)
                assert first.digest() == second.digest(), f"program {seed} differs from step {number}: {name}"
            assert program_digest(self.backend(), program) == program_digest(self.backend(), program)

    def test_repeats_itself_in_fresh_processes(self) -> None:
        """Random programs give the same digests in processes with other hash seeds and other memory."""
        self.check_fresh_processes(0, self.programs)

    def check_fresh_processes(self, first: int, count: int) -> None:
        """Compares the digests of programs `first` to `first + count - 1` in two fresh processes."""
        target = f"{self.backend.__module__}:{self.backend.__qualname__}"
        command = [sys.executable, "-P", "-m", "nmes.backend.contract.programs", target, str(first), str(count)]
        paths = os.pathsep.join(path for path in sys.path if path)
        runs = []
        for settings in ({"PYTHONHASHSEED": "1"}, {"PYTHONHASHSEED": "2", "PYTHONMALLOC": "malloc"}):
            environment = {**os.environ, "PYTHONPATH": paths, **settings}
            process = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
            assert process.returncode == 0, f"{' '.join(command)}\n{process.stderr}"
            runs.append(process.stdout.splitlines())
        assert len(runs[0]) == count, runs[0]
        different = [first + i for i, (one, two) in enumerate(zip(*runs, strict=True)) if one != two]
        assert not different, f"programs {different} give other digests in another process"

    def test_digests_every_bit(self) -> None:
        """Worlds that differ in one bit of a body, of what acts on it or of a joint have different digests."""
        digests: dict[bytes, str] = {}
        for name, sim in self._variants():
            digest = sim.digest()
            assert len(digest) == 16, f"{name}: not 16 bytes: {digest!r}"
            assert digest == sim.digest(), f"{name}: asked twice, two digests"
            assert digest not in digests, f"the digest does not see {name} (it is that of {digests[digest]})"
            digests[digest] = name

    def test_digests_targets_that_nothing_drives_towards(self) -> None:
        """Of motors that are off or have no strength, or whose bodies are frozen: they count once that changes."""
        self.need("motor")
        kind = self.a_joint("hinge", "slide")
        idle: tuple[tuple[Literal["off", "velocity"], float, bool], ...]
        idle = (("off", 1.0, False), ("velocity", 0.0, False), ("velocity", 1.0, True))
        for motor, effort, frozen in idle:
            digests = []
            for target in (0.0, 1.0, math.nextafter(1.0, 2.0)):
                sim = self.machine(kind, JointParams(motor, max_effort=effort))
                sim.set_frozen(1, frozen)
                sim.step(SUBSTEPS)
                sim.set_joint_params(0, JointParams(motor, target_velocity=target, max_effort=effort))
                sim.step(SUBSTEPS)
                digests.append(sim.digest())
            what = "between frozen bodies" if frozen else f"that is {motor}, of {effort:g} N m"
            assert len(set(digests)) == len(digests), f"the digest does not see the target of a motor {what}"

    def test_digests_every_tick(self) -> None:
        """While something moves, no two ticks have the same digest."""
        sim = self.mixed()
        digests = [sim.digest()]
        for _ in range(30):
            sim.step(SUBSTEPS)
            digests.append(sim.digest())
        assert len(set(digests)) == len(digests)

    def test_restores_snapshots(self) -> None:
        """A restored world, the same or a fresh one, is the one that was saved, and has the same future."""
        self.need("snapshot")
        for seed in range(3):
            program = random_program(self.backend(), seed)
            # Right after forces were applied: what waits for the next step is state too.
            applied = [number + 1 for number, (name, _) in enumerate(program) if name == "apply"]
            for cut in (*applied[1:3], len(program) * 2 // 3):
                sim = self.sim()
                execute(sim, program[:cut])
                saved, digest = sim.snapshot(), sim.digest()
                assert isinstance(saved, bytes)
                execute(sim, program[cut:])
                future, rows = sim.digest(), all_states(sim, program)
                for again in (sim, self.sim()):
                    again.restore(saved)
                    assert again.digest() == digest, f"program {seed}: restored at {cut}, it is another world"
                    assert again.snapshot() == saved, f"program {seed}: restored at {cut}, it saves differently"
                    execute(again, program[cut:])
                    assert again.digest() == future, f"program {seed}: restored at {cut}, another future"
                    assert np.array_equal(all_states(again, program), rows)

    def test_tells_its_members(self) -> None:
        """Bodies and joints are those that were added and not taken away, in a restored world too."""
        self.need("snapshot")
        for seed in range(3):
            sim = self.sim()
            bodies: dict[int, bool] = {}
            joints: dict[int, tuple[str, int, int]] = {}
            for name, arguments in random_program(self.backend(), seed):
                execute(sim, [(name, arguments)])
                number = arguments[0]
                if name == "add_body":
                    bodies[number] = arguments[1].frozen
                elif name == "set_frozen":
                    bodies[number] = arguments[1]
                elif name == "add_joint":
                    joints[number] = (arguments[1].kind, arguments[1].body1, arguments[1].body2)
                elif name in ("remove_body", "remove_joint"):
                    del (bodies if name == "remove_body" else joints)[number]
                else:
                    continue
                assert sim.members() == (bodies, joints), f"program {seed}: after {name}"
            again = self.sim()
            again.restore(sim.snapshot())
            assert again.members() == (bodies, joints), f"program {seed}: restored"

    def test_survives_snapshots_of_anybody(self) -> None:
        """Bytes that are cut are refused as `bad_snapshot`; those with another bit too, or are a world that goes on."""
        self.need("snapshot")
        program, draw = random_program(self.backend(), 0), random.Random(0)
        sim = self.sim()
        execute(sim, program[: len(program) * 2 // 3])
        saved = sim.snapshot()
        harmed = {f"the first {length} bytes": saved[:length] for length in (0, 1, len(saved) // 2, len(saved) - 1)}
        for bit in draw.sample(range(8 * len(saved)), min(100, 8 * len(saved))):
            at, mask = bit // 8, 1 << bit % 8
            harmed[f"bit {bit}"] = saved[:at] + bytes([saved[at] ^ mask]) + saved[at + 1 :]
        for what, snapshot in harmed.items():
            again = self.sim()
            try:
                again.restore(snapshot)
            except WorldError as error:
                assert error.code == "bad_snapshot", f"{what}: refused with {error.code!r}"
                continue
            assert what.startswith("bit"), f"takes {what} for a whole snapshot"
            try:
                again.step(SUBSTEPS)
            except SimulationFault:
                continue  # loud, as of any world that cannot go on
            assert np.isfinite(again.states(list(again.members()[0]))).all(), f"{what}: shows what is no number"

    def test_faults_when_it_diverges(self) -> None:
        """A world that cannot go on says so, shows the state before, and takes no other world with it."""
        sim, other, reference = self.mixed(), self.mixed(), self.mixed()
        for push in (1e15, 1e30, 1e60):
            before = sim.states([0, 1, 2])
            sim.apply(1, ZERO, ZERO, (push, push, 0.0), ZERO)
            try:
                for _ in range(10):
                    before = sim.states([0, 1, 2])
                    sim.step(SUBSTEPS)
            except SimulationFault as fault:
                assert fault.code and fault.message
                assert fault.body in (None, 1), f"blames body {fault.body}"
                break
        else:
            raise AssertionError("an impulse of 1e60 N s does not make it fault")
        after = sim.states([0, 1, 2])
        assert np.isfinite(after).all(), "shows infinities"
        assert np.array_equal(after, before), "does not show the state before the fault"
        assert sim.body_state(0).position == tuple(before[0, :3])
        for _ in range(30):
            other.step(SUBSTEPS)
            reference.step(SUBSTEPS)
        assert other.digest() == reference.digest()

    def test_goes_on_without_what_made_it_fault(self) -> None:
        """Where it can recover, a world goes on from the state before, exactly, once the body is taken away."""
        saved = "snapshot" in self.backend.capabilities
        sim, again = self.mixed(), self.mixed()
        for each in (sim, again):
            for push in (1e15, 1e30, 1e60):
                each.apply(1, ZERO, ZERO, (push, push, 0.0), ZERO)
                try:
                    for _ in range(10):
                        each.step(SUBSTEPS)
                except SimulationFault:
                    break
            if not each.recover():
                raise unittest.SkipTest("does not recover")
            before = each.states([0, 2])
            each.remove_body(1)
            assert np.array_equal(each.states([0, 2]), before), "does not show the state before the fault"
        for _ in range(30):
            sim.step(SUBSTEPS)
            again.step(SUBSTEPS)
        assert sim.digest() == again.digest(), "goes on in two ways"
        assert np.isfinite(sim.states([0, 2])).all()
        if saved:
            restored = self.mixed()
            restored.restore(sim.snapshot())
            for each in (sim, restored):
                for _ in range(30):
                    each.step(SUBSTEPS)
            assert restored.digest() == sim.digest(), "saved and restored, it has another future"

    def test_keeps_what_acts_when_a_step_fails(self) -> None:
        """Where it can recover, what acted on others in the step that failed acts in the one in its place, and once."""
        sim = self.space()
        for body in (0, 1):
            sim.add_body(body, box((9.0 * body, 0.0, 0.0)))
        for pushes in range(1, 4):
            sim.apply(0, (0.0, 1.0, 0.0), ZERO, (1.0, 0.0, 0.0), ZERO)
            sim.apply(1, ZERO, ZERO, (10.0 ** (15 * pushes), 0.0, 0.0), ZERO)
            try:
                sim.step(SUBSTEPS)
            except SimulationFault:
                break
        if not sim.recover():
            raise unittest.SkipTest("does not recover")
        sim.remove_body(1)
        for when in ("in the step", "after it"):
            sim.step(SUBSTEPS)
            assert_close(sim.body_state(0).linear_velocity, (pushes, pushes * TICK, 0.0), 1e-9, f"velocity {when}")

    def test_releases_what_it_holds(self) -> None:
        """Worlds that come and go leave no memory, files or threads behind."""
        status = Path("/proc/self")
        if not status.exists():
            raise unittest.SkipTest("needs /proc")
        program = random_program(self.backend(), 1)[:40]
        threads, files, size = 0, 0, 0
        for i in range(60):
            sim = self.backend().create(SceneSpec(TIMESTEP))
            execute(sim, program)
            sim.close()
            if i == 20:  # by then pools and caches have their size
                threads, files, size = threading.active_count(), len(list((status / "fd").iterdir())), resident()
        assert threading.active_count() <= threads, "threads are left"
        assert len(list((status / "fd").iterdir())) <= files + 1, "files are left open"
        grown = resident() - size
        assert grown < 40 * 100_000, f"40 worlds left {grown / 1e6:.1f} MB"

    def _variants(self) -> Iterator[tuple[str, Simulation]]:
        """Yields worlds by name; each differs from the first in one bit."""
        flat = self.dims == 2
        spec = box((1.0, 2.0, 0.0 if flat else 3.0), linear_velocity=(0.1, 0.2, 0.0 if flat else 0.3))
        spec = replace(spec, angular_velocity=(0.0, 0.0, 0.4) if flat else (0.2, 0.3, 0.4))

        def world(spec: BodySpec = spec) -> Simulation:
            sim = self.space()
            sim.add_body(0, spec)
            return sim

        yield "nothing", world()
        places: tuple[int, ...] = (0, 1) if flat else (0, 1, 2)
        parts: dict[str, tuple[int, ...]] = {"position": places, "size": places, "linear_velocity": places}
        parts["angular_velocity"] = (2,) if flat else (0, 1, 2)
        for name, axes in parts.items():
            for axis in axes:
                values = list(getattr(spec, name))
                values[axis] = math.nextafter(values[axis], math.inf)
                changed: dict[str, Any] = {name: tuple(values)}
                yield f"{name}[{axis}]", world(replace(spec, **changed))
        for name in ("mass", "friction", "restitution"):
            changed = {name: math.nextafter(getattr(spec, name), math.inf)}
            yield name, world(replace(spec, **changed))
        yield "quaternion", world(replace(spec, quaternion=about_z(1e-12)))
        for shape in ROUND:
            if self.can(f"shape.{shape}"):
                length = {"cylinder": 0.5, "capsule": 1.5}.get(shape, 1.0)
                yield f"a {shape}", world(replace(spec, size=(1.0, length, 1.0), shape=shape))
        yield "frozen", world(replace(spec, frozen=True))
        two = world()
        two.add_body(1, replace(spec, position=(9.0, 9.0, 0.0)))
        yield "a second body", two
        for name, number in (("force", 0), ("torque", 1), ("impulse", 2), ("angular_impulse", 3)):
            for axis in parts["angular_velocity"] if number % 2 else places:
                for amount in (1.0, math.nextafter(1.0, 2.0)):
                    acting = [ZERO, ZERO, ZERO, ZERO]
                    acting[number] = vector(amount * (np.arange(3) == axis))
                    pushed = world()
                    pushed.apply(0, *acting)
                    yield f"{name}[{axis}] of {amount!r}", pushed
        kind = next((kind for kind in ("hinge", "fixed") if self.can(f"joint.{kind}")), None)
        if kind is None:
            return
        for name, params in self._param_variants(kind):
            joined = world()
            joined.add_body(1, replace(spec, position=(9.0, 9.0, 0.0)))
            joined.add_joint(0, JointSpec(kind, 0, 1, (1.0, 2.0, 0.0), (0.0, 0.0, 1.0), params))
            yield f"a joint with {name}", joined

    def _param_variants(self, kind: str) -> Iterator[tuple[str, JointParams]]:
        yield "nothing", JointParams()
        if kind != "hinge":
            return
        more = math.nextafter(1.0, 2.0)
        if self.can("motor"):
            for speed, effort in ((1.0, 1.0), (more, 1.0), (1.0, more)):
                params = JointParams("velocity", target_velocity=speed, max_effort=effort)
                yield f"a motor of {speed!r}, {effort!r}", params
        if self.can("servo"):
            for target in (1.0, more):
                yield f"a servo at {target!r}", JointParams("position", target_position=target, max_effort=1.0)
        if self.can("spring"):
            for stiffness, damping in ((1.0, 1.0), (more, 1.0), (1.0, more)):
                yield f"a spring of {stiffness!r}, {damping!r}", JointParams(stiffness=stiffness, damping=damping)
        if self.can("limits"):
            for upper in (1.0, more):
                yield f"a limit of {upper!r}", JointParams(limits=(-1.0, upper))


def resident() -> int:
    """Returns this process's resident memory in bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
