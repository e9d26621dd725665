"""Brains that are neural networks: layers, continuous-time recurrent networks, and graphs of any topology.

In all of them a sum over many inputs is one row of a matrix times a buffer that holds, beside the inputs, a 1 for the
bias; what a wildcard stands for shares its column of the document's matrix, and a sensor that no entry names has a
column of zeros.

Literature: R. D. Beer, "On the dynamics of small continuous-time recurrent neural networks", Adaptive Behavior 3
(1995); K. O. Stanley and R. Miikkulainen, "Evolving neural networks through augmenting topologies", Evolutionary
Computation 10 (2002).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from typing import Final

import numpy as np

from nmes.brain.arithmetic import each, on_each, weigh
from nmes.brain.base import LIMIT, Array, Brain, Findings, Indices, JsonObject, Kernel
from nmes.brain.naming import Entries, Inputs, Outputs

__all__ = ["CtrnnBrain", "GraphBrain", "MlpBrain"]

# -- activations ------------------------------------------------------------------------------------------------------


# Each takes the sums, contiguous, and returns what writes their activations to the target, for arrays that stay where
# they are. What is in the sums may be lost.


def _tanh(sums: Array, target: Array) -> Callable[[], None]:
    return on_each(math.tanh, sums, target)


def _sigmoid(sums: Array, target: Array) -> Callable[[], None]:
    tanh = on_each(math.tanh, sums, sums)

    def apply() -> None:
        # exp(-s) would overflow; this is the same.
        np.multiply(sums, 0.5, out=sums)
        tanh()
        np.multiply(sums, 0.5, out=sums)
        np.add(sums, 0.5, out=target)

    return apply


def _sin(sums: Array, target: Array) -> Callable[[], None]:
    return on_each(math.sin, sums, target)


def _cos(sums: Array, target: Array) -> Callable[[], None]:
    return on_each(math.cos, sums, target)


def _gauss(sums: Array, target: Array) -> Callable[[], None]:
    exp = on_each(math.exp, sums, target)

    def apply() -> None:
        np.multiply(sums, sums, out=sums)
        np.multiply(sums, -1.0, out=sums)
        exp()

    return apply


def _step(sums: Array, target: Array) -> Callable[[], None]:
    def apply() -> None:
        np.greater_equal(sums, 0.0, out=target)

    return apply


def _relu(sums: Array, target: Array) -> Callable[[], None]:
    return _between(0.0, LIMIT, sums, target)


def _abs(sums: Array, target: Array) -> Callable[[], None]:
    def apply() -> None:
        np.absolute(sums, out=sums)
        np.minimum(sums, LIMIT, out=target)

    return apply


def _identity(sums: Array, target: Array) -> Callable[[], None]:
    return _between(-LIMIT, LIMIT, sums, target)


def _between(low: float, high: float, sums: Array, target: Array) -> Callable[[], None]:
    def apply() -> None:
        np.maximum(sums, low, out=sums)
        np.minimum(sums, high, out=target)

    return apply


_ACTIVATIONS: Final[Mapping[str, Callable[[Array, Array], Callable[[], None]]]] = {
    "tanh": _tanh,
    "sigmoid": _sigmoid,
    "sin": _sin,
    "cos": _cos,
    "gauss": _gauss,
    "step": _step,
    "relu": _relu,
    "abs": _abs,
    "identity": _identity,
}
_UNBOUNDED: Final = {"relu", "abs", "identity"}


# -- lengths ---------------------------------------------------------------------------------------------------------


def _same_length(findings: Findings, pointer: str, got: int, wanted: int, each: str, other: str) -> None:
    if got != wanted:
        findings.add(pointer, f"has {got} {each}, and there must be {wanted}, one for each {other}")


# -- layers -----------------------------------------------------------------------------------------------------------


class MlpKernel(Kernel):
    """Layer by layer, without a memory."""

    def __init__(
        self, activations: Sequence[str], owner: Sequence[int], inputs: int, matrices: Sequence[Array]
    ) -> None:
        """Takes for each layer a matrix (*lead, units, what is before + 1), whose last column are the biases."""
        *lead, _, columns = matrices[0].shape
        source = np.zeros((*lead, columns))
        self._inputs = Inputs(source, inputs)
        self._layers = []
        for name, matrix in zip(activations, matrices, strict=True):
            *lead, units, _ = matrix.shape
            row = np.ones((*lead, units + 1))
            sums, target = np.empty((*lead, units)), row[..., :units]
            self._layers.append((matrix, source, sums, _ACTIVATIONS[name](sums, target)))
            source = row
        self._last = target
        self._outputs = Outputs(owner, activations[-1] in _UNBOUNDED)

    def reset(self, seeds: Sequence[int], dt: float) -> None:
        """Has nothing to forget."""

    def step(self, inputs: Array) -> Array:
        """Goes one control step on."""
        self._inputs.read(inputs)
        for weights, source, sums, activate in self._layers:
            weigh(weights, source, sums)
            activate()
        return self._outputs.pick(self._last)


class MlpBrain(Brain):
    """A multilayer perceptron (`schemas/brain-mlp.json`)."""

    kind = "mlp"

    def _resolve(self, document: JsonObject, findings: Findings) -> None:
        self._entries = Entries(self, document, findings)
        layers = document["layers"]
        for number, layer in enumerate(layers):
            here = f"layers/{number}/"
            columns = layer["weights"].shape[1]
            if number == 0:
                self._entries.expect(findings, here + "weights", columns, "inputs", "columns")
            else:
                before = len(layers[number - 1]["weights"])
                _same_length(findings, here + "weights", columns, before, "columns", "unit of the layer before")
            units = len(layer["weights"])
            _same_length(findings, here + "biases", len(layer["biases"]), units, "numbers", "row of the weights")
        last = f"layers/{len(layers) - 1}/weights"
        self._entries.expect(findings, last, len(layers[-1]["weights"]), "outputs", "rows")

    def _arrays(self) -> tuple[Array, ...]:
        layers = self._document["layers"]
        matrices = [layer["weights"] for layer in layers]
        matrices[0] = self._entries.spread(matrices[0])
        return tuple(np.column_stack([m, layer["biases"]]) for m, layer in zip(matrices, layers, strict=True))

    def _run(self, *arrays: Array) -> Kernel:
        activations = [layer["activation"] for layer in self._document["layers"]]
        return MlpKernel(activations, self._entries.owners["outputs"], len(self.inputs), arrays)


# -- continuous-time recurrent networks -------------------------------------------------------------------------------


class CtrnnKernel(Kernel):
    """Neurons that follow their input with a delay, each exactly as if its input stood still during a step.

    With v = (y + bias) / 2 and u = tanh(v), sigmoid(y + bias) is (1 + u) / 2, and the equation becomes
    tau dv/dt = -v + (bias + sum weight (1 + u) / 2 + sum input weight x) / 2.
    """

    def __init__(self, owner: Sequence[int], taus: Array, biases: Array, weights: Array, input_weights: Array) -> None:
        """Takes taus, biases (*lead, n), weights (*lead, n, n) and input_weights (*lead, n, inputs)."""
        *lead, n, m = input_weights.shape
        self._lead = tuple(lead)
        self._taus = taus
        self._biases = biases
        self._drive = np.zeros((*lead, n, m + 1 + n))  # of [inputs, 1, u]
        self._drive[..., :m] = 0.5 * input_weights
        self._drive[..., m] = 0.5 * (biases + 0.5 * weights.sum(axis=-1))
        self._drive[..., m + 1 : m + 1 + n] = 0.25 * weights
        self._row = np.zeros((*lead, m + 1 + n))
        self._inputs = Inputs(self._row, m)
        self._u = self._row[..., m + 1 : m + 1 + n]
        self._v: Array
        self._v, self._sums, self._keep, self._take = np.empty((4, *biases.shape))
        self._fire = on_each(math.tanh, self._sums, self._u)
        self._outputs = Outputs(owner, unbounded=False)

    def reset(self, seeds: Sequence[int], dt: float) -> None:
        """Goes to the start, at which every y is 0."""
        np.divide(-dt, self._taus, out=self._keep)
        each(math.exp, self._keep)
        np.subtract(1.0, self._keep, out=self._take)
        np.multiply(0.5, self._biases, out=self._v)
        self._sums[...] = self._v
        self._fire()

    def memory(self) -> Array:
        """Returns the neurons' states."""
        states: Array = self._v.copy()
        return states

    def activity(self) -> Array:
        """Returns how each neuron fires."""
        fired: Array = self._u.copy()
        return fired

    def _take_up(self, memory: Array) -> None:
        self._v[...] = memory
        self._sums[...] = memory
        self._fire()

    def step(self, inputs: Array) -> Array:
        """Goes one control step on."""
        self._inputs.read(inputs)
        v, sums = self._v, self._sums
        weigh(self._drive, self._row, sums)
        np.multiply(sums, self._take, out=sums)
        np.multiply(v, self._keep, out=v)
        np.add(v, sums, out=v)
        sums[...] = v
        self._fire()
        return self._outputs.pick(self._u)


class CtrnnBrain(Brain):
    """A continuous-time recurrent neural network (`schemas/brain-ctrnn.json`)."""

    kind = "ctrnn"

    def _resolve(self, document: JsonObject, findings: Findings) -> None:
        self._entries = Entries(self, document, findings)
        n = len(document["time_constants"])
        other = "neuron, of which there are as many as time_constants"
        _same_length(findings, "biases", len(document["biases"]), n, "numbers", other)
        _same_length(findings, "weights", len(document["weights"]), n, "rows", other)
        _same_length(findings, "weights", document["weights"].shape[1], n, "columns", other)
        _same_length(findings, "input_weights", len(document["input_weights"]), n, "rows", other)
        columns = document["input_weights"].shape[1]
        self._entries.expect(findings, "input_weights", columns, "inputs", "columns")
        motors = self._entries.counts["outputs"]
        if n < motors:
            findings.add("time_constants", f"has {n} neurons, too few for {motors} outputs")

    def _arrays(self) -> tuple[Array, ...]:
        document = self._document
        spread = self._entries.spread(document["input_weights"])
        return document["time_constants"], document["biases"], document["weights"], spread

    def _run(self, *arrays: Array) -> Kernel:
        return CtrnnKernel(self._entries.owners["outputs"], *arrays)


# -- graphs -----------------------------------------------------------------------------------------------------------

_Group = tuple[slice, str]  # which nodes, by their places in the order, and their activation


class GraphKernel(Kernel):
    """Nodes in the order in which values flow, in groups of one activation whose nodes do not need each other."""

    def __init__(
        self, groups: Sequence[_Group], owner: Sequence[int], unbounded: bool, inputs: int, matrix: Array
    ) -> None:
        """Takes a matrix (*lead, nodes, columns) of [inputs, 1, the nodes now, the nodes a step before]."""
        *lead, n, columns = matrix.shape
        self._row = np.zeros((*lead, columns))
        self._inputs = Inputs(self._row, inputs)
        self._now = self._row[..., inputs + 1 : inputs + 1 + n]
        self._before = self._row[..., inputs + 1 + n : columns]
        self._groups = []
        for which, name in groups:
            sums = np.empty((*lead, which.stop - which.start))
            self._groups.append((matrix[..., which, :], sums, _ACTIVATIONS[name](sums, self._now[..., which])))
        self._outputs = Outputs(owner, unbounded)

    def reset(self, seeds: Sequence[int], dt: float) -> None:
        """Goes to the start, at which every node is 0."""
        self._now[...] = 0.0

    def memory(self) -> Array:
        """Returns the values of the nodes in the last step."""
        return self._now.copy()

    def activity(self) -> Array:
        """Returns the same as `memory`."""
        return self.memory()

    def _take_up(self, memory: Array) -> None:
        self._now[...] = memory

    def step(self, inputs: Array) -> Array:
        """Goes one control step on."""
        self._inputs.read(inputs)
        self._before[...] = self._now
        for weights, sums, activate in self._groups:
            weigh(weights, self._row, sums)
            activate()
        return self._outputs.pick(self._now)


class GraphBrain(Brain):
    """A network of any topology (`schemas/brain-graph.json`)."""

    kind = "graph"

    def _resolve(self, document: JsonObject, findings: Findings) -> None:
        nodes = document["nodes"]
        ids: dict[str, int] = {}
        for number, node in enumerate(nodes):
            if ids.setdefault(node["id"], number) != number:
                findings.add(f"nodes/{number}/id", f"there is another node {node['id']!r}")
        motored = [number for number, node in enumerate(nodes) if "motor" in node]
        if not motored:
            findings.add("nodes", "no node drives a motor: give one a 'motor'")
        entries, pointers = [nodes[number]["motor"] for number in motored], [f"nodes/{n}/motor" for n in motored]
        owners = findings.owners(entries, self.outputs, "motor", pointers)
        self._links = self._resolve_links(document, ids, findings)
        findings.check()
        order, self._groups, delayed = _flow(
            [node["activation"] for node in nodes], [(source, target) for source, target, _ in self._links]
        )
        self._place = np.empty(len(nodes), np.intp)  # of each node, in the order in which they are computed
        self._place[order] = np.arange(len(nodes))
        self._owner = [int(self._place[motored[owner]]) if owner >= 0 else -1 for owner in owners]
        self._unbounded = any(nodes[number]["activation"] in _UNBOUNDED for number in motored)
        self._delayed = delayed

    def _resolve_links(
        self, document: JsonObject, ids: Mapping[str, int], findings: Findings
    ) -> list[tuple[int, int, list[int]]]:
        """Returns of each link the node that it comes from (or -1), the node that it leads to, and its sensors."""
        links = []
        seen: dict[tuple[str, str, str], int] = {}
        for number, link in enumerate(document["links"]):
            here = f"links/{number}"
            if ("from" in link) == ("sensor" in link):
                findings.add(here, "must have either 'from' or 'sensor'")
                continue
            side = "from" if "from" in link else "sensor"
            first = seen.setdefault((side, link[side], link["to"]), number)
            if first != number:
                findings.add(here, f"links what link {first} does")
            for end in ("from", "to"):
                if end in link and link[end] not in ids:
                    findings.unknown(link[end], list(ids), "node", f"{here}/{end}")
            sensors: list[int] = []
            if "sensor" in link:
                sensors = findings.match(link["sensor"], self.inputs, "sensor", f"{here}/sensor")
            links.append((ids.get(link.get("from", ""), -1), ids.get(link["to"], -1), sensors))
        return links

    def _arrays(self) -> tuple[Array, ...]:
        nodes, m = self._document["nodes"], len(self.inputs)
        n = len(nodes)
        matrix = np.zeros((n, m + 1 + 2 * n))
        matrix[self._place, m] = [node["bias"] for node in nodes]
        for number, (source, target, sensors) in enumerate(self._links):
            weight = self._document["links"][number]["weight"]
            row = matrix[self._place[target]]
            if source < 0:
                row[sensors] += weight  # several wildcards may name one sensor
            else:
                row[m + 1 + self._place[source] + (n if number in self._delayed else 0)] = weight
        return (matrix,)

    def _run(self, *arrays: Array) -> Kernel:
        return GraphKernel(self._groups, self._owner, self._unbounded, len(self.inputs), *arrays)

    def activity(self) -> Array:
        """Returns the nodes' values, in the order of the document."""
        return super().activity()[..., self._place]


def _flow(activations: Sequence[str], links: Sequence[tuple[int, int]]) -> tuple[Indices, list[_Group], frozenset[int]]:
    """Returns the order of the nodes, its groups, and which links carry the value of the step before.

    A link whose two nodes can reach each other is part of a loop: it is delayed, and what remains has no loops.
    """
    n = len(activations)
    after: list[list[int]] = [[] for _ in range(n)]
    for source, target in links:
        if source >= 0:
            after[source].append(target)
    loop = _components(after)
    delayed = frozenset(i for i, (source, target) in enumerate(links) if source >= 0 and loop[source] == loop[target])
    level = [0] * n
    waiting = [0] * n
    for i, (source, target) in enumerate(links):
        if source >= 0 and i not in delayed:
            waiting[target] += 1
    ready = [node for node in range(n) if waiting[node] == 0]
    for node in ready:  # which grows meanwhile
        for target in after[node]:
            if loop[target] != loop[node]:
                level[target] = max(level[target], level[node] + 1)
                waiting[target] -= 1
                if waiting[target] == 0:
                    ready.append(target)

    def group(node: int) -> tuple[int, str]:
        return level[node], activations[node]

    order = sorted(range(n), key=lambda node: (*group(node), node))
    groups: list[_Group] = []
    start = 0
    for (_, name), members in groupby(order, key=group):
        end = start + len(list(members))
        groups.append((slice(start, end), name))
        start = end
    return np.array(order, np.intp), groups, delayed


def _components(after: Sequence[Sequence[int]]) -> list[int]:
    """Numbers the nodes so that two have the same number if and only if each can be reached from the other.

    R. Tarjan, "Depth-first search and linear graph algorithms", SIAM Journal on Computing 1 (1972), without recursion.
    """
    number: dict[int, int] = {}
    lowest: dict[int, int] = {}
    component = [-1] * len(after)
    open_nodes: list[int] = []
    for root in range(len(after)):
        if root in number:
            continue
        path = [(root, iter(after[root]))]
        number[root] = lowest[root] = len(number)
        open_nodes.append(root)
        while path:
            node, targets = path[-1]
            for target in targets:
                if target not in number:
                    number[target] = lowest[target] = len(number)
                    open_nodes.append(target)
                    path.append((target, iter(after[target])))
                    break
                if component[target] < 0:
                    lowest[node] = min(lowest[node], number[target])
            else:
                path.pop()
                if path:
                    lowest[path[-1][0]] = min(lowest[path[-1][0]], lowest[node])
                if lowest[node] == number[node]:
                    while component[node] < 0:
                        component[open_nodes.pop()] = node
    return component
