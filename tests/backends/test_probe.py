"""The probe sees what an engine computes, through what it promises."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import pytest

from nmes.backend import Backend, SceneSpec, Simulation, load_backend
from nmes.backend.fingerprint import differences, fingerprint
from nmes.backend.probe import probe
from nmes.backends.ballistic import BallisticBackend, BallisticSimulation
from nmes.errors import SimulationFault


def test_an_engine_that_computes_otherwise_in_one_bit_has_another_probe() -> None:
    class Twin(BallisticBackend):
        pass

    class Heavier(BallisticBackend):
        def create(self, scene: SceneSpec) -> BallisticSimulation:
            x, y, z = scene.gravity
            return super().create(replace(scene, gravity=(x, math.nextafter(y, 0.0), z)))

    assert probe(Twin()) == probe(BallisticBackend())
    assert list(differences(fingerprint(BallisticBackend()), fingerprint(Heavier()))) == ["probe"]


def test_an_engine_that_faults_in_the_probe_still_has_one() -> None:
    class Faulty(BallisticBackend):
        def create(self, scene: SceneSpec) -> BallisticSimulation:
            raise SimulationFault("diverged", "always")

    assert len(probe(Faulty())) == 32 and probe(Faulty()) != probe(BallisticBackend())


def test_a_probe_asks_for_nothing_that_is_not_promised(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Simulation] = []

    class Bare(BallisticBackend):
        capabilities = frozenset[str]()

        def create(self, scene: SceneSpec) -> BallisticSimulation:
            assert not (scene.boxes or scene.planets or scene.heightfield or scene.arena or scene.options)
            simulation = super().create(scene)
            for name in ("add_joint", "contacts", "hits", "proper_accelerations", "snapshot", "draw"):
                monkeypatch.setattr(type(simulation), name, refuse)
            made.append(simulation)
            return simulation

    def refuse(*arguments: Any) -> None:
        raise AssertionError("this was never promised")

    assert len(probe(Bare())) == 32 and len(made) == 3


@pytest.mark.parametrize("name", ["mujoco", "pymunk"])
def test_a_probe_depends_on_no_thread_and_on_no_world_before_it(name: str) -> None:
    engine = type(load_backend(name))

    def again() -> str:
        fresh: Backend = type("Fresh", (engine,), {})()
        return probe(fresh)

    with ThreadPoolExecutor(3) as pool:
        assert {*pool.map(lambda _: again(), range(3)), again()} == {probe(engine())}


def test_a_library_that_another_version_left_in_the_package_is_not_in_the_fingerprint(tmp_path: Path) -> None:
    package = tmp_path / "mujoco"
    package.mkdir()
    for path in Path(mujoco.__file__).parent.iterdir():
        (package / path.name).symlink_to(path)
    (package / "libmujoco.so.4.0.0").write_bytes(b"left when 3.17.0 was installed again")
    program = (
        "import json, mujoco; from nmes.backend import load_backend; backend = load_backend('mujoco'); "
        "print(json.dumps([mujoco.__file__, backend.fingerprint()]))"
    )
    run = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    loaded, found = json.loads(run.stdout)
    assert loaded == str(package / "__init__.py")
    assert found == load_backend("mujoco").fingerprint()
    assert len(found["engine_sha256"]) == 64
