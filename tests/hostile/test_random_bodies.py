"""The generator of random creatures: it says everything that a genome may say, and the same for a seed every time."""

from __future__ import annotations

import re
from collections import Counter
from itertools import count, islice

import numpy as np

from nmes.brain import KINDS
from nmes.genome import Genome
from nmes.schemas.documents import write_json
from random_bodies import INERT, draw_genome, still, valid_genomes

BODIES = 160
WORDS = (
    [f'"type":"{kind}"' for kind in ("fixed", "hinge", "slide", "pin", "conetwist", "touch", "target_direction")]
    + [f'"kind":"{kind}"' for kind in KINDS]
    + [f'"mode":"{mode}"' for mode in ("position", "velocity")]
    + [f'"{word}":' for word in ("graph", "cubes", "mirror", "scale", "terminal", "recursive_limit", "rotation")]
    + [f'"{word}":' for word in ("limits", "stiffness", "damping", "friction", "restitution", "sensors", "axis")]
)


def test_the_creatures_say_everything_and_most_of_it_is_extreme_somewhere() -> None:
    refused: Counter[str] = Counter()
    drawn = [document for _, document in islice(valid_genomes(count(), refused), BODIES)]
    texts = [write_json(document).decode().replace(" ", "") for document in drawn]
    missing = [word for word in WORDS if sum(word in text for text in texts) < 3]
    assert not missing
    assert sum(refused.values()) < 4 * BODIES
    bodies = [Genome(document).body for document in drawn]
    edges = [edge for body in bodies for cube in body.cubes for edge in cube.size]
    efforts = [motor.max_effort for body in bodies for motor in body.motors]
    assert min(edges) == 0.01 and max(edges) >= 3.0 and min(efforts) < 0.01 and max(efforts) > 1e5
    assert max(len(body.cubes) for body in bodies) > 12
    assert any(re.search(r"\.mirror", cube.id) for body in bodies for cube in body.cubes)


def test_a_seed_and_its_numbers_draw_the_same_creature_and_other_numbers_the_same_structure() -> None:
    for seed, document in islice(valid_genomes(count(), Counter()), 40):
        again, numbers = draw_genome(seed)
        assert again == document == draw_genome(seed, numbers)[0]
        changed, others = draw_genome(seed, np.clip(numbers + 0.001, 0.0, 1.0))
        assert len(others) == len(numbers) and changed != document
        names = [[cube.id for cube in Genome(each).body.cubes] for each in (document, changed)]
        assert names[0] == names[1]


def test_planar_bodies_lie_in_the_plane() -> None:
    assert all(
        Genome(document).body.planar for _, document in islice(valid_genomes(count(), Counter(), planar=True), 60)
    )


def test_what_does_nothing_is_a_creature_still() -> None:
    for _, document in islice(valid_genomes(count(), Counter()), 30):
        for way in INERT:
            genome = Genome(still(document, way))
            efforts = [motor.max_effort for motor in genome.body.motors]
            assert {"no motors": not efforts, "no effort": not any(efforts)}.get(way, True)
            if "brain" in genome.document:
                genome.brain()
