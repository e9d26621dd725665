"""What it costs that creatures share a world: twenty of them far apart in one, against twenty worlds of one each."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

from measure import Figure, in_turns, ratio, summary
from nmes import World
from nmes.genome import Genome

CREATURES = 20
APART = 50.0  # m
TICKS = 60
ROUNDS = 7
AT_MOST = 1.3
SOCIAL = {
    "sensors": [
        *({"type": f"other_{what}", "cube": "chassis"} for what in ("direction", "distance", "velocity")),
        {"type": "hear", "cube": "chassis", "channel": "lead"},
    ],
    "voices": [{"channel": "lead"}],
}


def bodies() -> dict[str, tuple[str, dict[str, Any]]]:
    """Returns the engine and the genome of each comparison, by name."""
    block = {"id": "a", "size": 0.5, "mass": 1, "position": [0, 0.25, 0]}
    arm = {"id": "b", "size": 0.2, "mass": 0.1, "position": [0.4, 0.25, 0]}
    bond = {"id": "j", "cube1": "a", "cube2": "b", "type": "fixed", "anchor": [0.3, 0.25, 0]}
    pair = {"format": "nmes-genome/1", "name": "pair", "body": {"cubes": [block, arm], "joints": [bond]}, "sensors": []}
    roller = Genome.load("roller").document
    return {
        "mujoco, walkers": ("mujoco", Genome.load("walker").document),
        "mujoco, centipedes": ("mujoco", Genome.load("centipede").document),
        "mujoco, rollers that see and talk": ("mujoco", {**roller, **SOCIAL}),
        "pymunk, inchworms": ("pymunk", Genome.load("inchworm").document),
        "ballistic, pairs of cubes": ("ballistic", pair),
    }


class Company:
    """Creatures in a world, each driven by its brain at every tick, after a second of doing so."""

    def __init__(self, backend: str, document: dict[str, Any], count: int) -> None:
        """Sets them down, far apart."""
        self._world = World({"mode": "lockstep", "backend": backend, "channels": {"lead": {}}})
        self._client = self._world.join()
        genome = Genome(document)
        brains = [genome.brain() if "brain" in document else None for _ in range(count)]
        self._players = [(f"c{number}", brain) for number, brain in enumerate(brains)]
        for number, (name, brain) in enumerate(self._players):
            place = {"name": name, "position": [APART * number, 0, 0]}
            reply = self._world.execute(self._client, {"type": "spawn_creature", "genome": document, **place})
            assert reply["type"] == "creature_spawned", reply
            if brain is not None:
                brain.reset(number, 1 / 60)
        self.run(TICKS)

    def run(self, ticks: int) -> None:
        """Senses, drives and ticks."""
        for _ in range(ticks):
            for name, brain in self._players:
                sensed = self._world.creature(name).sense()
                if brain is not None:
                    self._world.drive(self._client, name, brain.step(sensed))
            self._world.tick()


def trial(companies: list[Company]) -> Callable[[], float]:
    """Returns what runs them all for a second and tells the CPU time that it took, s."""

    def seconds() -> float:
        began = time.process_time()
        for company in companies:
            company.run(TICKS)
        return time.process_time() - began

    return seconds


def figures() -> Iterator[Figure]:
    """Compares one world with as many worlds as creatures, on each engine."""
    for name, (backend, document) in bodies().items():
        together = [Company(backend, document, CREATURES)]
        alone = [Company(backend, document, 1) for _ in range(CREATURES)]
        samples = in_turns({"together": trial(together), "alone": trial(alone)}, ROUNDS)
        what = f"{CREATURES} creatures in one world against {CREATURES} worlds ({name})"
        yield Figure(what, ratio(samples, "together", "alone"), "x", at_most=AT_MOST, details=summary(samples, 1.0))
