"""NEAT: brains that begin small and grow nodes and links, in species, on a body that stays as it is.

After K. O. Stanley and R. Miikkulainen, "Evolving Neural Networks through Augmenting Topologies", Evolutionary
Computation 10 (2002), with its parameters; docs/evolution.md says what is otherwise. The body is the start genome's:
where bodies change too, `ga` and `afpo` change topologies among all else, and distances between networks of other
bodies would mean little. Champions of species are kept without being evaluated again, since their scores would be the
same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nmes.errors import DocumentError
from nmes.evolution.algorithm import Algorithm, Candidate, Problem, Score
from nmes.evolution.algorithms.best import Best
from nmes.evolution.algorithms.bounds import within_bounds
from nmes.evolution.algorithms.neat_networks import Network, add_link, cross_networks, perturb, split_link
from nmes.evolution.algorithms.requirements import check_problem
from nmes.evolution.algorithms.species import Individual, Species, divided, speciate
from nmes.genome import Genome
from nmes.schemas.documents import JsonObject
from nmes.variation.brains import motor_names, sensor_names
from nmes.variation.draw import Draw

__all__ = ["Neat"]

_CHAMPIONS = 5  # members from which on a species keeps its champion
_ANEW = 0.1  # part of the numbers of a mutated network that are drawn anew


class Neat(Algorithm):
    """A generational algorithm over brains of kind `graph`.

    Args:
        problem: What the run is about: with one genome to begin with. Of another kind of brain, or none, NEAT begins
            with nodes for the motors that listen to all sensors.
        options: See `Options`.

    Raises:
        DocumentError: There is not one genome to begin with, or it has no motors; or there are objectives or measures.
    """

    @dataclass(frozen=True)
    class Options:
        """The options; the defaults are those of the paper.

        Attributes:
            population: How many candidates a generation has.
            threshold: The compatibility distance within which networks are of one species.
            weights: How much the mean difference of numbers counts in that distance.
            step: How far a number is shifted by a mutation at most, and a new one is from 0.
            perturbed: In which part of the offspring without a new node or link numbers are mutated.
            nodes: The chance of a new node.
            links: The chance of a new link.
            crossover: The part of the offspring that have two parents.
            outside: The part of those with two parents of which one is of another species.
            survivors: The part of a species, the best, who may be parents.
            patience: For how many generations a species without progress has offspring.
            recurrent: Whether links may close loops.
        """

        population: int = 150
        threshold: float = 3.0
        weights: float = 0.4
        step: float = 2.5
        perturbed: float = 0.8
        nodes: float = 0.03
        links: float = 0.05
        crossover: float = 0.75
        outside: float = 0.001
        survivors: float = 0.2
        patience: int = 15
        recurrent: bool = True

        def __post_init__(self) -> None:
            """Raises a DocumentError where an option is out of its bounds."""
            parts = ("perturbed", "nodes", "links", "crossover", "outside", "survivors")
            bounds = {"population": (2, 100_000), "threshold": (0, 1_000), "weights": (0, 1_000), "step": (0, 100)}
            within_bounds(self, {**bounds, "patience": (1, 100_000), **dict.fromkeys(parts, (0, 1))})

    def __init__(self, problem: Problem, options: Options) -> None:
        check_problem(problem, start=True)
        self._problem, self._options, self._start = problem, options, problem.starts[0]
        self._sensors = sensor_names(self._start.body)
        self._first = _first_network(self._start, self._sensors)
        self._species: list[Species] = []
        self._heirs: list[tuple[Species, int]] = []
        self._told: list[Individual] = []  # of this generation, and the champions of the one before
        self._best = Best()

    def needs(self, index: int) -> int:
        """Returns the first index of the generation."""
        return index - index % self._options.population

    def ask(self, index: int) -> Candidate:
        """Returns the candidate of this index; see `Algorithm`."""
        generation, place = divmod(index, self._options.population)
        draw = self._problem.draw("candidate", index)
        for species, count in self._heirs:
            if place < count:
                return self._offspring(species, draw, generation)
            place -= count
        if index == 0:
            return self._candidate(self._first, "start", (), 0, "0")
        network = perturb(self._first, draw, self._options.step, 0.0)
        return self._candidate(network, "weights", (), generation, "0")

    def _offspring(self, species: Species, draw: Draw, generation: int) -> Candidate:
        options = self._options
        able = species.members[: max(1, round(options.survivors * len(species.members)))]
        parents, operators = [draw.one_of(able)], list[str]()
        network = parents[0].network
        if draw.chance(options.crossover):
            other = draw.one_of(able)
            if draw.chance(options.outside):
                other = draw.one_of(draw.one_of(self._heirs)[0].members)
            if other is not parents[0]:
                parents = sorted([parents[0], other], key=lambda each: (-each.score, each.index))
                network = cross_networks(parents[0].network, parents[1].network, draw)
                operators.append("cross")
        network, kind = self._mutated(network, draw, not operators)
        operators += kind
        return self._candidate(network, "+".join(operators), parents, generation, str(species.name))

    def _mutated(self, network: Network, draw: Draw, surely: bool) -> tuple[Network, list[str]]:
        """Returns a network with a new node, a new link, or other numbers, and which of these; or as it is."""
        options = self._options
        grown: Network | None = None
        if draw.chance(options.nodes):
            grown = split_link(network, draw, "tanh")
        elif draw.chance(options.links):
            grown = add_link(network, self._sensors, draw, options.step, options.recurrent)
        if grown is not None:
            return grown, ["topology"]
        if surely or draw.chance(options.perturbed):
            return perturb(network, draw, options.step, _ANEW), ["weights"]
        return network, []

    def _candidate(
        self, network: Network, operator: str, parents: Sequence[Individual], generation: int, group: str
    ) -> Candidate:
        document = {**self._start.document, "brain": network.document}
        indices = tuple(parent.index for parent in parents)
        if operator != "start":
            hashes = [parent.hash for parent in parents]
            indices = indices or (0,)  # the first generation comes of the start genome
            document["parents"] = list(dict.fromkeys(hashes or [self._start.hash]))
        return Candidate(Genome(document), operator, indices, generation, group)

    def tell(self, index: int, candidate: Candidate, score: Score) -> None:
        """Takes a candidate's score in; the last of a generation makes the next one's species."""
        if score.score is not None:
            self._best.add(index, score.score)
            network = Network.of(candidate.genome.document["brain"])
            self._told.append(Individual(index, candidate.genome.hash, network, score.score))
        generation, place = divmod(index + 1, self._options.population)
        if place == 0 and self._told:
            self._renew(generation)

    def _renew(self, generation: int) -> None:
        options, draw = self._options, self._problem.draw("species", generation)
        self._species = speciate(self._told, self._species, generation, options.threshold, options.weights, draw)
        self._heirs = divided(self._species, options.population, generation, options.patience)
        self._told = [species.members[0] for species, _ in self._heirs if len(species.members) >= _CHAMPIONS]

    def elites(self) -> Sequence[int]:
        """Returns the best of all, of equals those told first."""
        return self._best.indices

    def figures(self) -> Mapping[str, float]:
        """Returns how many species there are, and how many hidden nodes the champion of all has."""
        hidden = len(_leader(self._species).network.hidden) if self._species else 0
        return {"species": len(self._species), "hidden": hidden}


def _leader(species: Sequence[Species]) -> Individual:
    return max((each.members[0] for each in species), key=lambda each: each.score)


def _first_network(genome: Genome, sensors: Sequence[str]) -> Network:
    """Returns the network to begin with: the genome's own, or one in which each motor listens to all sensors.

    Raises:
        DocumentError: The genome's brain is none for its body, or it has no motors.
    """
    brain: JsonObject = genome.document.get("brain", {})
    genome.check_brain()
    if brain.get("kind") == "graph":
        return Network.of(brain)
    motors = motor_names(genome.body)
    if not motors:
        raise DocumentError([("starts/0", "the body has no motors for a brain to drive")])
    genes = {("bias", "", motor): 0.0 for motor in motors}
    genes |= {("sensor", sensor, motor): 0.0 for motor in motors for sensor in sensors}
    return Network({motor: {"motor": motor, "activation": "tanh"} for motor in motors}, genes)
