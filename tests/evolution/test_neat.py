"""NEAT on problems that its authors published figures of, and on a creature; how networks vary and how species form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest

from nmes.brain import load_brain
from nmes.errors import DocumentError
from nmes.evaluation import Task
from nmes.evolution.algorithm import Algorithm, Problem, Score
from nmes.evolution.algorithms import load_algorithm
from nmes.evolution.algorithms.neat_networks import Network, add_link, cross_networks, distance, perturb, split_link
from nmes.evolution.algorithms.species import Individual, Species, divided, speciate
from nmes.genome import Genome
from nmes.variation.draw import Draw

Json = dict[str, Any]


def body_with(sensors: Sequence[str]) -> Genome:
    """Returns a hinge between two cubes: its sensors stand for the inputs of a problem, its motor for the output."""
    cubes = [{"id": name, "size": 0.2, "mass": 1, "position": [x, 0.1, 0]} for name, x in (("one", 0.0), ("two", 0.2))]
    motor = {"mode": "position", "range": [-1, 1], "max_effort": 1}
    hinge = {"id": "out", "cube1": "one", "cube2": "two", "type": "hinge", "anchor": [0.1, 0.1, 0], "motor": motor}
    read = [{"id": name, "type": "spin", "cube": "one", "axis": "x"} for name in sensors]
    body = {"cubes": cubes, "joints": [hinge]}
    return Genome({"format": "nmes-genome/1", "name": "problem", "body": body, "sensors": read})


def neat(start: Genome, seed: int, **options: Any) -> Algorithm:
    return load_algorithm("neat", Problem(Task.load("walk"), seed, (start,)), options)


def solved(algorithm: Algorithm, fitness: Callable[[Json], tuple[float, bool]], most: int) -> tuple[int, Json]:
    """Has brains scored until one solves the problem; returns how many were scored, and the last."""
    for index in range(most):
        candidate = algorithm.ask(index)
        brain = candidate.genome.document["brain"]
        score, over = fitness(brain)
        algorithm.tell(index, candidate, Score(score))
        if over:
            assert score > 0.0 or index == 0
            return index + 1, brain
    raise AssertionError(f"not solved in {most} evaluations")


# -- exclusive or -----------------------------------------------------------------------------------------------------

PATTERNS = {(0.0, 0.0): 0.0, (0.0, 1.0): 1.0, (1.0, 0.0): 1.0, (1.0, 1.0): 0.0}


def exclusive_or(brain: Json) -> tuple[float, bool]:
    """As in the paper: the square of 4 less the errors; solved when each output is on the right side of a half."""
    network = load_brain(brain, ["a", "b"], ["out"])
    outputs = []
    for pattern in PATTERNS:
        network.reset(0, 1 / 60)
        outputs.append((float(network.step(np.array(pattern))[0]) + 1.0) / 2.0)
    wanted = list(PATTERNS.values())
    error = sum(abs(output - value) for output, value in zip(outputs, wanted, strict=True))
    right = all((output > 0.5) == (value > 0.5) for output, value in zip(outputs, wanted, strict=True))
    return (4.0 - error) ** 2, right


def test_it_solves_exclusive_or_which_takes_a_hidden_node() -> None:
    for seed in (0, 3):
        evaluations, brain = solved(neat(body_with("ab"), seed, recurrent=False), exclusive_or, 12_000)
        assert evaluations > 150 and len(brain["nodes"]) >= 2


@pytest.mark.long
@pytest.mark.timeout(3_000)
def test_exclusive_or_takes_no_longer_than_published() -> None:
    """Stanley and Miikkulainen: 100 runs, all solved, 32 generations of 150 in the mean, 2.35 hidden nodes."""
    runs = [solved(neat(body_with("ab"), seed, recurrent=False), exclusive_or, 100 * 150) for seed in range(100)]
    assert np.mean([evaluations for evaluations, _ in runs]) <= 32 * 150
    assert np.mean([len(brain["nodes"]) - 1 for _, brain in runs]) <= 2.6


# -- two poles on a cart, with velocities -----------------------------------------------------------------------------

STATE = ("x", "speed", "long", "long_speed", "short", "short_speed")
SCALES = np.array([4.8, 2.0, 0.52, 2.0, 0.52, 2.0])
GRAVITY, CART, FRICTION, HINGES, STEP = -9.8, 1.0, 0.0, 0.000002, 0.01
POLES = ((0.5, 0.1), (0.05, 0.01))  # half the length, m, and the mass, kg
FALLEN, EDGE, LASTING = 36.0 * pi / 180.0, 2.4, 100_000


def accelerations(state: list[float], force: float) -> list[float]:
    """A. P. Wieland, "Evolving neural network controllers for unstable systems" (1991)."""
    pushes = masses = 0.0
    turning = []
    for number, (half, mass) in enumerate(POLES):
        angle, speed = state[2 + 2 * number], state[3 + 2 * number]
        hinge = HINGES * speed / (mass * half)
        turning.append((angle, hinge, half))
        pushes += mass * half * speed**2 * sin(angle)
        pushes += 0.75 * mass * cos(angle) * (hinge + GRAVITY * sin(angle))
        masses += mass * (1.0 - 0.75 * cos(angle) ** 2)
    cart = (force + pushes) / (masses + CART)
    rates = [state[1], cart]
    for number, (angle, hinge, half) in enumerate(turning):
        rates += [state[3 + 2 * number], -0.75 * (cart * cos(angle) + GRAVITY * sin(angle) + hinge) / half]
    return rates


def moved(state: list[float], force: float) -> list[float]:
    """A step of the Runge-Kutta method of fourth order."""
    first = accelerations(state, force)
    second = accelerations([x + STEP / 2.0 * v for x, v in zip(state, first, strict=True)], force)
    third = accelerations([x + STEP / 2.0 * v for x, v in zip(state, second, strict=True)], force)
    fourth = accelerations([x + STEP * v for x, v in zip(state, third, strict=True)], force)
    slopes = zip(state, first, second, third, fourth, strict=True)
    return [x + STEP / 6.0 * (a + 2.0 * b + 2.0 * c + d) for x, a, b, c, d in slopes]


def double_poles(brain: Json) -> tuple[float, bool]:
    """For how many steps of 0.02 s both poles stand; 100,000 are a solution."""
    network = load_brain(brain, STATE, ["out"])
    network.reset(0, 0.02)
    state = [0.0, 0.0, 0.07, 0.0, 0.0, 0.0]
    for steps in range(LASTING):
        force = 10.0 * float(network.step(np.array(state) / SCALES)[0])
        state = moved(moved(state, force), force)
        if abs(state[0]) > EDGE or abs(state[2]) > FALLEN or abs(state[4]) > FALLEN:
            return float(steps + 1), False
    return float(LASTING), True


@pytest.mark.long
@pytest.mark.timeout(20_000)
def test_double_poles_take_no_longer_than_published() -> None:
    """Stanley and Miikkulainen: 3,600 evaluations in the mean of 120 runs, all solved, standard deviation 2,704.

    What is asserted is that the mean of our runs is no greater, by more than two of its standard errors.
    """
    runs = [solved(neat(body_with(STATE), seed), double_poles, 30_000)[0] for seed in range(20)]
    assert np.mean(runs) <= 3_600 + 2.0 * 2_704 / len(runs) ** 0.5


# -- networks and species ---------------------------------------------------------------------------------------------


def smallest() -> Network:
    return Network.of(neat(body_with("ab"), 1).ask(0).genome.document["brain"])


def test_it_begins_with_motors_that_listen_to_all_sensors() -> None:
    network = smallest()
    assert network.genes == {("bias", "", "out"): 0.0, ("sensor", "a", "out"): 0.0, ("sensor", "b", "out"): 0.0}
    roller = Genome.load("roller")  # or with the brain that there is
    assert neat(roller, 1).ask(0).genome.brain().document == {**roller.document["brain"]}


def test_the_first_generation_comes_of_the_start_genome() -> None:
    start = Genome.load("roller")
    algorithm = neat(start, 1, population=5)
    candidates = [algorithm.ask(index) for index in range(5)]
    assert [candidate.parents for candidate in candidates] == [(), (0,), (0,), (0,), (0,)]
    assert all(candidate.genome.body == start.body for candidate in candidates)
    assert all(candidate.genome.document["parents"] == [start.hash] for candidate in candidates[1:])


def test_a_split_link_gives_way_to_a_node_that_is_named_after_it() -> None:
    network = smallest()
    network = Network(network.nodes, {gene: 0.5 for gene in network.genes})
    one, other = (split_link(network, Draw(seed), "tanh") for seed in (1, 2))
    assert one is not None and other is not None
    node = one.hidden[0]
    (end, source, _), *_ = (gene for gene in network.genes if gene not in one.genes)
    assert one.genes[end, source, node] == 1.0 and one.genes["from", node, "out"] == 0.5
    splits = [split_link(network, Draw(seed), "tanh") for seed in range(20)]
    names = {split.hidden[0] for split in splits if split is not None}
    assert len(names) == 2  # one for each link, whoever splits it


def test_distances_count_links_that_only_one_has_and_differences_of_numbers() -> None:
    network = smallest()
    assert distance(network, network, 0.4) == 0.0
    linked = add_link(network, ["a", "b"], Draw(1), 1.0, recurrent=True)
    split = split_link(network, Draw(1), "tanh")
    shifted = Network(network.nodes, {gene: value + 2.0 for gene, value in network.genes.items()})
    assert linked is not None and split is not None
    assert distance(network, linked, 0.4) == distance(linked, network, 0.4) == 1.0
    assert distance(network, split, 0.4) == distance(split, network, 0.4) == 2.0  # the split link is in both
    assert distance(network, shifted, 0.4) == pytest.approx(0.8)


def test_a_child_is_built_as_the_fitter_and_has_numbers_of_both() -> None:
    fitter = split_link(smallest(), Draw(1), "tanh")
    assert fitter is not None
    other = perturb(smallest(), Draw(2), 2.0, 0.0)
    children = [cross_networks(fitter, other, Draw(seed)) for seed in range(20)]
    assert all(child.nodes == fitter.nodes and child.genes.keys() == fitter.genes.keys() for child in children)
    for gene, value in fitter.genes.items():
        assert {child.genes[gene] for child in children} == {value, other.genes.get(gene, value)}


@pytest.mark.parametrize("recurrent", [True, False])
def test_links_close_loops_only_where_they_may(recurrent: bool) -> None:
    network, loops = smallest(), False
    for number in range(60):
        split = split_link(network, Draw(1, number), "tanh") if number % 4 == 0 else None
        linked = add_link(network, ["a", "b"], Draw(2, number), 1.0, recurrent)
        network = split or linked or network
        load_brain(network.document, ["a", "b"], ["out"])
        loops = loops or _has_loop(network)
    assert loops == recurrent and len(network.nodes) > 8


def _has_loop(network: Network) -> bool:
    """Takes nodes away that listen to none that is left: what remains is in loops, or behind them."""
    left = set(network.nodes)
    while True:
        heard = {to for end, source, to in network.links if end == "from" and source in left and to in left}
        if heard == left:
            return bool(left)
        left = heard


def individual(index: int, value: float, score: float) -> Individual:
    network = smallest()
    return Individual(index, str(index), Network(network.nodes, dict.fromkeys(network.genes, value)), score)


def test_networks_that_are_alike_are_of_one_species() -> None:
    far, near = [individual(0, 0.0, 1.0), individual(1, 9.0, 5.0)], [individual(2, 0.5, 3.0), individual(3, 9.5, 2.0)]
    species = speciate([*far, *near], [], 0, 3.0, 0.4, Draw(1))
    assert [[member.index for member in each.members] for each in species] == [[2, 0], [1, 3]]
    again = speciate([individual(7, 9.0, 4.0), individual(8, 30.0, 1.0)], species, 1, 3.0, 0.4, Draw(1))
    assert [(each.name, each.best, each.since) for each in again] == [(1, 5.0, 0), (8, 1.0, 1)]


def test_offspring_are_shared_by_the_mean_of_a_species_and_none_are_for_those_without_progress() -> None:
    crowd = Species(0, tuple(individual(index, 0.0, 4.0) for index in range(8)), 4.0, 20)
    loner = Species(8, (individual(8, 9.0, 12.0),), 12.0, 3)
    idle = Species(9, (individual(9, 30.0, 8.0),), 8.0, 5)
    shares = {each.name: share for each, share in divided([crowd, loner, idle], 100, 20, 15)}
    assert shares == {0: 25, 8: 75}  # the loner is the best of all, and so has time without end
    loss = Species(1, (individual(1, 0.0, -5.0),), -5.0, 20)
    assert divided([loss], 10, 20, 15) == [(loss, 10)]


def test_the_species_of_the_best_network_has_offspring_however_few_there_are() -> None:
    uneven = Species(0, (individual(0, 0.0, 5.0), individual(1, 0.0, -90.0), individual(2, 0.0, -100.0)), 5.0, 20)
    others = [Species(number, (individual(number, 9.0 * number, 4.0),), 4.0, 20) for number in (3, 4, 5)]
    shares = {each.name: share for each, share in divided([uneven, *others], 3, 20, 15)}
    assert shares[0] == 1 and sum(shares.values()) == 3
    huge = [Species(number, (individual(number, 9.0 * number, 1.7e308),), 1.7e308, 20) for number in (0, 1)]
    assert divided(huge, 4, 20, 15) == [(huge[0], 2), (huge[1], 2)]


def test_it_takes_one_genome_with_a_motor_to_begin_with() -> None:
    task, walker = Task.load("walk"), Genome.load("walker")
    statue = {name: value for name, value in walker.document.items() if name in ("format", "name")}
    stone = Genome({**statue, "body": {"cubes": [{"id": "it", "size": 0.2, "mass": 1, "position": [0, 0.1, 0]}]}})
    for starts, path in (((), "starts"), ((walker, walker), "starts"), ((stone,), "starts/0")):
        with pytest.raises(DocumentError) as caught:
            load_algorithm("neat", Problem(task, 1, starts))
        assert caught.value.problems[0][0] == path
