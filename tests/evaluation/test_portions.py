"""How work is cut: everything once, like with like, what takes longest first, little at the end."""

from __future__ import annotations

import json

from creatures import mlp, snake
from nmes.evaluation.portions import cut


def document(segments: int, seed: int = 0) -> bytes:
    return json.dumps(snake(mlp(segments, hidden=2, seed=seed), segments=segments, name=f"{seed}")).encode()


def test_every_genome_is_in_one_portion_of_its_kind() -> None:
    genomes = [document(3 + i % 2, seed=i) for i in range(100)] + [b"no genome", b"[1]"]
    for jobs, seeds in ((1, 1), (2, 1), (3, 5), (8, 100)):
        portions = cut(genomes, seeds, jobs)
        assert sorted(index for portion in portions for index in portion) == list(range(102))
        for portion in portions:
            assert len({index % 2 if index < 100 else "none" for index in portion}) == 1
            assert len(portion) <= max(1, 64 // seeds)


def test_the_largest_bodies_come_first_and_portions_become_small() -> None:
    portions = cut([document(2, seed=i) for i in range(200)] + [document(9)], 1, 2)
    assert portions[0] == [200]
    sizes = [len(portion) for portion in portions[1:]]
    assert sizes == sorted(sizes, reverse=True) and sizes[0] > 40 and sizes[-1] <= 4


def test_few_genomes_are_shared_among_the_processes() -> None:
    assert cut([document(2, seed=i) for i in range(3)], 3, 2) == [[0, 1], [2]]
    assert cut([document(2, seed=i) for i in range(3)], 3, 4) == [[0], [1], [2]]
    assert cut([], 1, 2) == []


def test_one_that_takes_ten_times_longer_leaves_no_core_idle_for_a_twentieth() -> None:
    costs = [1.0] * 255 + [10.0]  # a body of more cubes takes longer, and nothing else is known before
    genomes = [document(3, seed=i) for i in range(255)] + [document(12)]
    for jobs in (2, 3):
        free = [0.0] * jobs  # when each is
        for portion in cut(genomes, 1, jobs):
            earliest = free.index(min(free))
            free[earliest] += sum(costs[index] for index in portion)
        end = max(free)
        assert sum(end - at for at in free) / (jobs * end) < 0.05
