"""How work is cut: everything once, like with like, what takes longest first, little at the end."""

from __future__ import annotations

import json
from collections import Counter

from creatures import mlp, snake
from nmes.evaluation.portions import cut


def document(segments: int, seed: int = 0) -> bytes:
    return json.dumps(snake(mlp(segments, hidden=2, seed=seed), segments=segments, name=f"{seed}")).encode()


def test_every_genome_is_in_one_portion_of_its_kind() -> None:
    genomes = [document(3 + i % 2, seed=i) for i in range(100)] + [b"no genome", b"[1]"]
    for jobs, seeds in ((1, 1), (2, 1), (3, 5), (8, 100)):
        portions = cut(genomes, seeds, 600, jobs)
        done = Counter((index, seed) for portion in portions for index in portion.genomes for seed in portion.seeds)
        assert done == Counter((index, seed) for index in range(102) for seed in range(seeds))
        for portion in portions:
            assert len({index % 2 if index < 100 else "none" for index in portion.genomes}) == 1
            assert len(portion.genomes) <= max(1, 64 // seeds)
            assert len(portion.genomes) == 1 or portion.seeds == range(seeds)


def test_the_largest_bodies_come_first_and_portions_become_small() -> None:
    portions = cut([document(2, seed=i) for i in range(200)] + [document(9)], 1, 600, 2)
    assert portions[0].genomes == [200]
    sizes = [len(portion.genomes) for portion in portions[1:]]
    assert sizes == sorted(sizes, reverse=True) and sizes[0] > 40 and sizes[-1] <= 4


def test_few_genomes_are_shared_among_the_processes() -> None:
    few = [document(2, seed=i) for i in range(3)]
    assert [portion.genomes for portion in cut(few, 3, 600, 2)] == [[0, 1], [2]]
    assert [portion.genomes for portion in cut(few, 3, 600, 4)] == [[0], [1], [2]]
    assert [portion.genomes for portion in cut(few, 3, 600, 1, together=False)] == [[0], [1], [2]]
    assert cut([], 1, 600, 2) == []


def test_the_seeds_of_few_genomes_are_shared_in_pieces_that_are_worth_a_process() -> None:
    one = [document(2)]
    for jobs, seeds, ticks, sizes in (
        (2, 60, 600, [15, 15, 15, 15]),
        (8, 60, 600, [8, 9, 8, 9, 8, 9, 9]),
        (2, 3, 600, [3]),
        (2, 3, 12_000, [1, 1, 1]),
        (1, 60, 600, [60]),
        (1, 130, 600, [65, 65]),
        (2, 0, 600, [0]),
    ):
        portions = cut(one, seeds, ticks, jobs)
        assert [len(portion.seeds) for portion in portions] == sizes
        assert [place for portion in portions for place in portion.seeds] == list(range(seeds))
    portions = cut([document(2), document(2, seed=1)], 60, 600, 2)
    for genome in range(2):
        shared = [place for portion in portions if portion.genomes == [genome] for place in portion.seeds]
        assert shared == list(range(60))


def test_one_that_takes_ten_times_longer_leaves_no_core_idle_for_a_twentieth() -> None:
    costs = [1.0] * 255 + [10.0]  # a body of more cubes takes longer, and nothing else is known before
    genomes = [document(3, seed=i) for i in range(255)] + [document(12)]
    for jobs in (2, 3):
        free = [0.0] * jobs  # when each is
        for portion in cut(genomes, 1, 600, jobs):
            earliest = free.index(min(free))
            free[earliest] += sum(costs[index] for index in portion.genomes)
        end = max(free)
        assert sum(end - at for at in free) / (jobs * end) < 0.05
