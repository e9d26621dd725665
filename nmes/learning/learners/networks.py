"""Small networks of tanh units that learn by gradients: their sums, their derivatives, and Adam.

    network = Network((26, 64, 64, 8))
    parameters = network.initial(draw, last=0.01)
    pass_ = network.forward(parameters, rows)            # pass_.outputs: (n, 8)
    gradient = network.backward(parameters, pass_, sums)  # of sum(sums * outputs), by the parameters

Parameters are one flat array, layer by layer: the weights (units, inputs), then the biases. So whoever adds them up,
scales them or keeps them needs to know nothing of layers.

Sources: A. M. Saxe, J. L. McClelland and S. Ganguli, "Exact solutions to the nonlinear dynamics of learning in deep
linear neural networks", ICLR 2014 (orthogonal weights); D. P. Kingma and J. Ba, "Adam: a method for stochastic
optimization", ICLR 2015.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from nmes.brain.base import Array, JsonObject
from nmes.learning.learners.arithmetic import dot, gathered, spread, tanh, weighed
from nmes.variation.draw import Draw

__all__ = ["Adam", "Network", "Pass", "clipped", "read_layers", "together"]

_BETA1, _BETA2, _EPSILON = 0.9, 0.999, 1e-5  # Adam's; the last as Huang et al. (2022) found it


@dataclass(frozen=True, eq=False, slots=True)
class Pass:
    """Rows on their way through a network.

    Attributes:
        layers: What each layer is given, arrays (n, inputs); the rows first.
        outputs: Array (n, outputs).
    """

    layers: tuple[Array, ...]
    outputs: Array


class Network:
    """Layers of tanh units, and a last one of sums alone.

    Args:
        sizes: The number of inputs, of units of each layer between, and of outputs.
    """

    def __init__(self, sizes: Sequence[int]) -> None:
        self.sizes = tuple(sizes)
        shapes = list(zip(self.sizes[1:], self.sizes[:-1], strict=True))
        self.count = 0
        for units, inputs in shapes:
            self.count += units * (inputs + 1)
        self._shapes = shapes

    def initial(self, draw: Draw, last: float) -> Array:
        """Returns parameters to begin with: orthogonal weights, scaled by sqrt(2) but for the last layer's."""
        parameters = np.zeros(self.count)
        for number, ((weights, _), shape) in enumerate(zip(self.layers(parameters), self._shapes, strict=True)):
            scale = last if number == len(self._shapes) - 1 else sqrt(2.0)
            weights[...] = scale * _orthogonal(*shape, draw)
        return parameters

    def layers(self, parameters: Array) -> Iterator[tuple[Array, Array]]:
        """Yields weights (units, inputs) and biases (units,) of each layer, as views into the parameters."""
        begin = 0
        for units, inputs in self._shapes:
            middle, end = begin + units * inputs, begin + units * (inputs + 1)
            yield parameters[begin:middle].reshape(units, inputs), parameters[middle:end]
            begin = end

    def rescaled(self, parameters: Array, ratios: Array, shifts: Array) -> None:
        """Changes parameters so that rows (x - shift) / ratio come to what rows x came to before."""
        weights, biases = next(iter(self.layers(parameters)))
        biases += weighed(shifts[None], weights)[0]
        weights *= ratios

    def forward(self, parameters: Array, rows: Array) -> Pass:
        """Sends rows (n, inputs) through."""
        *hidden, (weights, biases) = self.layers(parameters)
        layers = [rows]
        for before, bias in hidden:
            layers.append(tanh(weighed(layers[-1], before) + bias))
        return Pass(tuple(layers), weighed(layers[-1], weights) + biases)

    def backward(self, parameters: Array, forward: Pass, slopes: Array) -> Array:
        """Returns the gradient of a sum over rows by the parameters, shape (count,).

        Args:
            parameters: Those of the pass.
            forward: The pass.
            slopes: The derivatives of the sum by the outputs, shape (n, outputs).
        """
        gradient = np.empty(self.count)
        layers = list(zip(self.layers(parameters), self.layers(gradient), forward.layers, strict=True))
        for number, ((weights, _), (weight_slopes, bias_slopes), rows) in reversed(list(enumerate(layers))):
            weight_slopes[...] = gathered(slopes, rows)
            bias_slopes[...] = np.add.reduce(slopes, axis=0)
            if number:
                slopes = spread(slopes, weights) * (1.0 - rows * rows)
        return gradient

    def document(self, parameters: Array, means: Array, scales: Array) -> JsonObject:
        """Returns the brain that sees what sensors read and does what the network does with (read - mean) / scale."""
        layers = []
        for number, (weights, biases) in enumerate(self.layers(parameters)):
            if number == 0:
                weights = weights / scales
                biases = biases - weighed(means[None], weights)[0]
            last = number == len(self._shapes) - 1
            layer = {"weights": weights.tolist(), "biases": biases.tolist()}
            layers.append({**layer, "activation": "identity" if last else "tanh"})
        return {"kind": "mlp", "layers": layers}


def read_layers(document: JsonObject, sensors: int) -> tuple[Network, Array] | None:
    """Returns the network and the parameters of a brain; None where it is no such network.

    Args:
        document: Of a brain, sound for its body.
        sensors: Of the body.
    """
    if document["kind"] != "mlp" or {"inputs", "outputs"} & {*document}:
        return None
    *hidden, last = [layer.get("activation", "tanh") for layer in document["layers"]]
    if last != "identity" or {*hidden} - {"tanh"}:
        return None
    network = Network((sensors, *(len(layer["biases"]) for layer in document["layers"])))
    parameters = np.empty(network.count)
    for (weights, biases), layer in zip(network.layers(parameters), document["layers"], strict=True):
        weights[...], biases[...] = layer["weights"], layer["biases"]
    return network, parameters


def _orthogonal(units: int, inputs: int, draw: Draw) -> Array:
    """Returns an orthogonal matrix: rows, or columns where there are fewer, at right angles and of length 1."""
    few, many = sorted((units, inputs))
    rows = draw.normals(few * many).reshape(few, many)
    for number, row in enumerate(rows):  # Gram and Schmidt, one after the other; twice is enough (Giraud et al. 2005)
        for _ in range(2):
            for before in rows[:number]:
                row -= dot(before, row) * before
        row /= sqrt(dot(row, row))
    return rows if units == few else np.ascontiguousarray(rows.T)


def clipped(gradient: Array, most: float) -> Array:
    """Returns a gradient that is no longer than this."""
    length = sqrt(dot(gradient, gradient))
    return gradient if length <= most else gradient * (most / length)


class Adam:
    """Steps along gradients, each parameter's in proportion to how surely its sign is known."""

    def __init__(self, count: int) -> None:
        self.means, self.squares, self.powers = np.zeros(count), np.zeros(count), np.ones(2)

    def step(self, parameters: Array, gradient: Array, rate: float) -> None:
        """Changes parameters so that what the gradient is of falls."""
        self.means += (1.0 - _BETA1) * (gradient - self.means)
        self.squares += (1.0 - _BETA2) * (gradient * gradient - self.squares)
        self.powers *= (_BETA1, _BETA2)
        first, second = (1.0 - self.powers).tolist()
        parameters -= (rate / first) * self.means / (np.sqrt(self.squares / second) + _EPSILON)

    def arrays(self) -> dict[str, Array]:
        """Returns all that it knows, which whoever goes on with it writes into."""
        return {"means": self.means, "squares": self.squares, "powers": self.powers}


def together(**parts: Mapping[str, Array]) -> dict[str, Array]:
    """Returns the arrays of several parts as those of one, each by the part's name, a point, and its own."""
    return {f"{part}.{name}": array for part, arrays in parts.items() for name, array in arrays.items()}
