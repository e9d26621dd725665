"""Random creatures: genomes drawn from a seed over all that a genome may say, many of their numbers extreme.

A genome is drawn in two parts. The seed alone decides the structure: parts, joints, sensors, the kind of brain. The
numbers (sizes, limits, efforts, weights) follow from an array with one entry from 0 to 1 each, which the seed draws
too, so that a search may change the numbers of a structure. Not all that is drawn is a good genome; `valid_genomes`
leaves out what is not, and counts why.
"""

from __future__ import annotations

from base64 import b64encode
from collections import Counter
from collections.abc import Iterator, Sequence
from copy import deepcopy
from random import Random
from typing import Any

import numpy as np

from brain_documents import ACTIVATIONS
from nmes.backend import Array
from nmes.backend.shapes import SHAPES, Shape, fitted
from nmes.errors import DocumentError
from nmes.genome import Genome
from onnx_models import layer

Json = dict[str, Any]
Bounds = tuple[float, float]

FACES = ["+x", "-x", "+y", "-y", "+z", "-z"]
_PLACES = ("size", "position", "rotation", "anchor", "axis", "at", "color")
INERT = ("no brain", "no motors", "no effort", "zero", "constant")
"""The ways in which a creature does nothing."""


class Draw:
    """The choices of a structure, from a seed, and its numbers, from an array or the seed.

    Attributes:
        numbers: Those that were used, each from 0 to 1.
    """

    def __init__(self, seed: int, numbers: Array | None) -> None:
        self._choose, self._fill = (np.random.default_rng([seed, stream]) for stream in (0, 1))
        self._given = numbers
        self.numbers: list[float] = []
        self._wild = 0.0 if self.chance(0.5) else 0.15  # the part of the numbers that are from the whole range

    def chance(self, part: float) -> bool:
        return bool(self._choose.random() < part)

    def count(self, low: int, high: int) -> int:
        return int(self._choose.integers(low, high + 1))

    def one_of(self, values: Sequence[Any], weights: Sequence[float] | None = None) -> Any:
        return values[int(self._choose.choice(len(values), p=weights))]

    def number(self, usual: Bounds, whole: Bounds | None = None) -> float:
        """Draws a number between bounds, or sometimes anywhere between wider ones, their ends most of all.

        Positive bounds are ratios: 0.1 to 1 is as likely as 1 to 10.
        """
        wild = whole is not None and self.chance(self._wild)
        place = len(self.numbers)
        part = float(self._fill.random() if self._given is None else self._given[place])
        self.numbers.append(part)
        low, high = whole if whole is not None and wild else usual
        if wild:
            part = min(max(1.2 * part - 0.1, 0.0), 1.0)
        if low > 0.0:
            return float(min(max(low * (high / low) ** part, low), high))
        if wild and low < 0.0:
            return float(high * (2.0 * part - 1.0) ** 5)
        return low + part * (high - low)

    def vector(self, bound: float = 1.0) -> list[float]:
        return [self.number((-bound, bound)) for _ in range(3)]

    def table(self, rows: int, columns: int) -> list[list[float]]:
        return [[self.number((-3.0, 3.0), (-1e5, 1e5)) for _ in range(columns)] for _ in range(rows)]


def draw_genome(seed: int, numbers: Array | None = None, *, planar: bool = False) -> tuple[Json, Array]:
    """Draws a genome, good or not.

    Args:
        seed: Decides the structure.
        numbers: From 0 to 1, as many as a draw without them returned; drawn from the seed too if None.
        planar: Whether the body lies and moves in the plane z = 0.

    Returns:
        The document, and the numbers that it was made of.

    Raises:
        DocumentError: The body is none that a brain could be made for.
    """
    draw = Draw(seed, numbers)
    body = _graph(draw, planar) if draw.chance(0.5) else _cubes(draw, planar)
    document: Json = {"format": "nmes-genome/1", "name": f"random-{seed}", "body": body}
    if draw.chance(0.3):
        document["sensors"] = _sensors(draw)
    grown = Genome(document).body
    motors, sensors = [motor.id for motor in grown.motors], [sensor.id for sensor in grown.sensors]
    if motors and draw.chance(0.95):
        kinds = [kind for kind in _BRAINS if sensors or kind in ("sine", "cpg", "graph")]
        document["brain"] = _BRAINS[draw.one_of(kinds)](draw, sensors, motors)
    return document, np.array(draw.numbers)


def vary_genome(name: str, numbers: Array | None = None) -> tuple[Json, Array]:
    """Changes the numbers of a shipped genome, but for where its parts are and how large.

    Args:
        name: The genome's.
        numbers: From 0 to 1, as many as a draw without them returned: from a tenth of what it was to ten times that,
            0.5 being what it was.

    Returns:
        The document, and the numbers that it was made of.
    """
    document = Genome.load(name).document
    places = list(_numbers_of([document["body"], document.get("brain")]))
    numbers = np.full(len(places), 0.5) if numbers is None else numbers
    for (container, key), part in zip(places, numbers.tolist(), strict=True):
        container[key] *= 10.0 ** (2.0 * part - 1.0)
    return document, numbers


def _numbers_of(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yields where in a document there are numbers that may change, as pairs of a container and a key."""
    for key, item in value.items() if isinstance(value, dict) else enumerate(value):
        if isinstance(item, float | int) and not isinstance(item, bool) and key != "recursive_limit":
            yield value, key
        elif isinstance(item, dict | list) and key not in _PLACES:
            yield from _numbers_of(item)


def unit(draw: Random) -> tuple[float, float, float]:
    """Returns a random direction, of length 1."""
    x, y, z = (draw.gauss(0.0, 1.0) for _ in range(3))
    length = (x * x + y * y + z * z) ** 0.5
    return (x / length, y / length, z / length)


def valid_genomes(seeds: Iterator[int], refused: Counter[str], *, planar: bool = False) -> Iterator[tuple[int, Json]]:
    """Yields the seeds that draw a good genome, with the genome; counts in `refused` why others do not."""
    for seed in seeds:
        try:
            document, _ = draw_genome(seed, planar=planar)
            Genome(document)
        except DocumentError as error:
            refused[_reason(error.message)] += 1
        else:
            yield seed, document


def _reason(message: str) -> str:
    """Returns the words of a refusal that do not name a part or a number."""
    first = message.split(";")[0].split(": ", 1)[-1]
    return " ".join(word for word in first.split() if word.isalpha())[:60]


def still(document: Json, way: str) -> Json:
    """Returns the same creature without anything to move it, in one of the ways of `INERT`."""
    changed = deepcopy(document)
    joints = [joint for joint in _joints(changed) if "motor" in joint]
    brain = changed.pop("brain", None)
    if way == "no motors" or not Genome(changed).body.motors:
        for joint in joints:
            del joint["motor"]
        changed.pop("sensors", None)  # which may be of motors
        return changed
    if way == "no effort":
        for joint in joints:
            joint["motor"]["max_effort"] = 0
        return {**changed, "brain": brain} if brain is not None else changed
    oscillator: Json = {"motor": "*", "amplitude": 0.0}
    if way == "constant":  # aims at rest, which is not the middle of the range
        oscillator["offset"] = -0.5
    for joint in joints:
        wide = max(map(abs, joint["motor"]["range"])) or 1.0
        joint["motor"]["range"] = [-wide, wide] if way != "constant" else [-wide / 3.0, wide]
    return changed if way == "no brain" else {**changed, "brain": {"kind": "sine", "oscillators": [oscillator]}}


def rounded(document: Json, seed: int) -> Json:
    """Returns a creature some of whose parts are balls, capsules or cylinders; the same one where that is none."""
    draw, changed = Random(seed), deepcopy(document)
    body = changed["body"]
    for part in body["graph"]["parts"] if "graph" in body else body["cubes"]:
        shape: Shape = draw.choice(SHAPES)
        x, y, z = part["size"]
        if shape != "box":
            part |= {"shape": shape, "size": list(fitted(shape, (x, y, z)))}
    try:
        Genome(changed)
    except DocumentError:
        return document
    return changed


def _joints(document: Json) -> list[Json]:
    body = document["body"]
    if "graph" in body:
        return [part["joint"] for part in body["graph"]["parts"] if "joint" in part]
    joints: list[Json] = body.get("joints", [])
    return joints


# -- bodies -----------------------------------------------------------------------------------------------------------


def _size(draw: Draw, *, root: bool) -> list[float]:
    usual = (0.1, 0.7) if root else (0.05, 0.4)
    return [draw.number(usual, (0.01, 3.0)) for _ in range(3)]


def _surface(draw: Draw) -> Json:
    surface: Json = {}
    if draw.chance(0.4):
        surface["friction"] = draw.number((0.5, 2.0), (0.0, 10.0))
    if draw.chance(0.2):
        surface["restitution"] = draw.number((0.0, 0.5), (0.0, 1.0))
    return surface


def _joint(draw: Draw, planar: bool) -> Json:
    """Draws what a joint is, but for where."""
    kinds, weights = ["hinge", "slide", "fixed", "pin", "conetwist"], [0.58, 0.18, 0.1, 0.07, 0.07]
    kind = draw.one_of(kinds[:4], [0.6, 0.2, 0.1, 0.1]) if planar else draw.one_of(kinds, weights)
    joint: Json = {"type": kind}
    if kind in ("hinge", "slide", "conetwist") and (draw.chance(0.5) or (planar and kind == "slide")):
        axis = draw.one_of([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], None])
        joint["axis"] = draw.vector() if axis is None else axis
        if planar:
            joint["axis"] = [0.0, 0.0, 1.0] if kind == "hinge" else [*joint["axis"][:2], 0.0]
        if not any(joint["axis"]):
            joint["axis"] = [1.0, 0.0, 0.0]
    if kind == "conetwist" and draw.chance(0.7):
        joint["limits"] = [draw.number((0.0, 1.5), (0.0, 1000.0)), draw.number((0.0, 1.5), (0.0, 1000.0))]
    if kind not in ("hinge", "slide"):
        return joint
    unit = 1.0 if kind == "hinge" else 0.2
    if draw.chance(0.5):
        ends = draw.number((-1.5 * unit, 0.0), (-1000.0, 1000.0)), draw.number((0.0, 1.5 * unit), (-1000.0, 1000.0))
        joint["limits"] = sorted(ends)
    if draw.chance(0.3):
        joint["stiffness"] = draw.number((0.1, 500.0), (1e-3, 1e6))
    if draw.chance(0.3):
        joint["damping"] = draw.number((0.01, 20.0), (1e-3, 1e6))
    if draw.chance(0.85):
        joint["motor"] = _motor(draw, unit)
    return joint


def _motor(draw: Draw, unit: float) -> Json:
    mode = draw.one_of(["position", "velocity"])
    wide = draw.number((0.2 * unit, 1.5 * unit) if mode == "position" else (0.5 * unit, 15.0 * unit), (0.001, 1000.0))
    low = -wide if draw.chance(0.8) else draw.number((-wide, 0.9 * wide))
    return {"mode": mode, "range": [low, wide], "max_effort": draw.number((1.0, 300.0), (1e-3, 1e6))}


def _graph(draw: Draw, planar: bool) -> Json:
    """Draws parts that grow on each other, again and again or mirrored."""
    faces = ["+x", "+y", "-y"] if planar else FACES
    parts: list[Json] = []
    connections: list[Json] = []
    for i in range(draw.count(2, 5)):
        part = {"id": f"p{i}", "size": _size(draw, root=i == 0), "density": draw.number((100.0, 2000.0), (1.0, 1e5))}
        part |= _surface(draw)
        if i:
            part["joint"] = _joint(draw, planar)
            connections.append(_connection(draw, f"p{draw.count(0, i - 1)}", f"p{i}", faces, planar))
        if draw.chance(0.3):
            part["recursive_limit"] = draw.one_of([2, 3, 4, 6])
            connections.append(_connection(draw, f"p{i}", f"p{draw.count(0, i)}", faces, planar))
        parts.append(part)
    return {"graph": {"root": "p0", "parts": parts, "connections": connections}}


def _connection(draw: Draw, parent: str, child: str, faces: Sequence[str], planar: bool) -> Json:
    at = [draw.number((-1.0, 1.0)), 0.0 if planar else draw.number((-1.0, 1.0))]
    connection: Json = {"from": parent, "to": child, "face": draw.one_of(faces), "at": at}
    if draw.chance(0.3):
        angles = draw.vector(1.5)
        connection["rotation"] = [0.0, 0.0, angles[2]] if planar else angles
    if draw.chance(0.3):
        connection["scale"] = draw.number((0.6, 1.5), (0.1, 10.0))
    if draw.chance(0.3):
        connection["mirror"] = draw.one_of(["x", "y"] if planar else ["x", "y", "z"])
    if draw.chance(0.15):
        connection["terminal"] = True
    return connection


def _cubes(draw: Draw, planar: bool) -> Json:
    """Draws cubes that hang on each other's faces, and sometimes a loop of them."""
    sizes: list[Array] = []
    places: list[Array] = []
    cubes: list[Json] = []
    joints: list[Json] = []
    for i in range(draw.one_of([1, 2, 3, 3, 4, 5, 6, 8, 12])):
        size, place = np.array(_size(draw, root=i == 0)), np.zeros(3)
        if i:
            parent = i - 1 if draw.chance(0.6) else draw.count(0, i - 1)
            axis, sign = draw.count(0, 1 if planar else 2), draw.one_of([-1.0, 1.0])
            shift = np.array(draw.vector(0.5)) * sizes[parent]
            shift[axis] = sign * (sizes[parent][axis] / 2.0 + draw.number((0.0, 0.05), (-0.3, 0.3)))
            if planar:
                shift[2] = 0.0
            anchor = places[parent] + shift
            place = anchor.copy()
            place[axis] += sign * size[axis] / 2.0
            joints.append({"cube1": f"c{parent}", "cube2": f"c{i}", "anchor": _anchor(draw, anchor, planar)})
        cube = {"id": f"c{i}", "mass": _mass(draw, size), **_surface(draw)}
        if draw.chance(0.2):
            angles = draw.vector(3.0)
            cube["rotation"] = [0.0, 0.0, angles[2]] if planar else angles
        sizes.append(size)
        places.append(place)
        cubes.append(cube)
    if len(cubes) > 2 and draw.chance(0.15):
        anchor = (places[0] + places[-1]) / 2.0
        joints.append({"cube1": "c0", "cube2": f"c{len(cubes) - 1}", "anchor": anchor.tolist()})
    for i, joint in enumerate(joints):
        joint |= {"id": f"j{i}", **_joint(draw, planar)}
    lowest = min(_bottom(cube, size, place) for cube, size, place in zip(cubes, sizes, places, strict=True))
    up = np.array([0.0, -lowest, 0.0])
    for cube, size, place in zip(cubes, sizes, places, strict=True):
        cube |= {"size": size.tolist(), "position": (place + up).tolist()}
    for joint in joints:
        joint["anchor"] = np.clip(joint["anchor"] + up, -1000.0, 1000.0).tolist()
    return {"cubes": cubes, "joints": joints}


def _anchor(draw: Draw, place: Array, planar: bool) -> Array:
    """Draws where a joint is: at a place, or sometimes far from it."""
    x, y, z = (draw.number((0.0, 0.0), (-1000.0, 1000.0)) for _ in range(3))
    return np.array([place[0] + x, place[1] + y, place[2] + (0.0 if planar else z)])


def _mass(draw: Draw, size: Array) -> float:
    density = draw.number((100.0, 2000.0), (1.0, 1e5))
    return float(min(max(density * size.prod(), 0.001), 10_000.0))


def _bottom(cube: Json, size: Array, place: Array) -> float:
    """Returns a height that nothing of a cube is below."""
    return float(place[1] - (np.sqrt(size @ size) if "rotation" in cube else size[1]) / 2.0)


# -- sensors and brains -----------------------------------------------------------------------------------------------


def _sensors(draw: Draw) -> list[Json]:
    of_cubes = ["height", "up", "velocity", "spin", "touch", "target_direction", "target_distance", "target_velocity"]
    return [{"type": kind, "cube": draw.one_of(["*", "?0"])} for kind in of_cubes if draw.chance(0.4)]


def _oscillators(draw: Draw, motors: Sequence[str]) -> list[Json]:
    return [
        {
            "motor": motor,
            "frequency": draw.number((0.3, 4.0), (0.01, 100.0)),
            "amplitude": draw.number((0.1, 1.0), (-10.0, 10.0)),
            "phase": draw.number((-3.2, 3.2), (-100.0, 100.0)),
            "step": draw.number((-3.2, 3.2), (-100.0, 100.0)),
            "offset": draw.number((-0.5, 0.5), (-10.0, 10.0)),
        }
        for motor in (["*"] if draw.chance(0.2) else motors[:12])
    ]


def _sine(draw: Draw, sensors: list[str], motors: list[str]) -> Json:
    return {"kind": "sine", "oscillators": _oscillators(draw, motors)}


def _cpg(draw: Draw, sensors: list[str], motors: list[str]) -> Json:
    brain: Json = {"kind": "cpg", "oscillators": _oscillators(draw, motors)}
    brain["start_jitter"] = draw.number((0.0, 1.0), (0.0, 4.0))
    if draw.chance(0.6):
        chain = {"motors": "*", "weight": draw.number((0.5, 8.0), (-100.0, 100.0)), "lag": draw.number((-3.2, 3.2))}
        brain["chains"] = [chain]
    if sensors and draw.chance(0.4):
        rate = draw.number((-5.0, 5.0), (-1000.0, 1000.0))
        brain["feedback"] = [{"sensor": draw.one_of(sensors), "motor": "*", "rate": rate}]
    return brain


def _mlp(draw: Draw, sensors: list[str], motors: list[str]) -> Json:
    inputs, outputs, hidden = sensors[:6], motors[:8], draw.count(1, 4)
    layers = [
        {
            "weights": draw.table(units, before),
            "biases": draw.table(1, units)[0],
            "activation": draw.one_of(ACTIVATIONS),
        }
        for units, before in ((hidden, len(inputs)), (len(outputs), hidden))
    ]
    return {"kind": "mlp", "inputs": inputs, "outputs": outputs, "layers": layers}


def _ctrnn(draw: Draw, sensors: list[str], motors: list[str]) -> Json:
    inputs, outputs = sensors[:4], motors[:5]
    n = len(outputs) + draw.count(0, 1)
    return {
        "kind": "ctrnn",
        "inputs": inputs,
        "outputs": outputs,
        "time_constants": [draw.number((0.02, 1.0), (0.001, 1000.0)) for _ in range(n)],
        "biases": draw.table(1, n)[0],
        "weights": draw.table(n, n),
        "input_weights": draw.table(n, len(inputs)),
    }


def _network(draw: Draw, sensors: list[str], motors: list[str]) -> Json:
    nodes: list[Json] = [
        {"id": f"n{i}", "motor": motor, "activation": draw.one_of(ACTIVATIONS), "bias": draw.table(1, 1)[0][0]}
        for i, motor in enumerate(motors[:8])
    ]
    nodes.append({"id": "clock", "activation": "sin", "bias": draw.number((0.02, 0.5))})
    links: list[Json] = [{"from": "clock", "to": "clock"}]
    for node in nodes[:-1]:
        links.append({"from": "clock", "to": node["id"], "weight": draw.table(1, 1)[0][0]})
        if sensors:
            weight = draw.table(1, 1)[0][0]
            links.append({"sensor": draw.one_of(sensors), "to": node["id"], "weight": weight})
    return {"kind": "graph", "nodes": nodes, "links": links}


def _onnx(draw: Draw, sensors: list[str], motors: list[str]) -> Json:
    inputs, outputs = sensors[:4], motors[:4]
    weights, biases = draw.table(len(inputs), len(outputs)), draw.table(1, len(outputs))
    model = b64encode(layer(weights, biases)).decode()
    return {"kind": "onnx", "inputs": inputs, "outputs": outputs, "model": model}


_BRAINS = {"sine": _sine, "cpg": _cpg, "mlp": _mlp, "ctrnn": _ctrnn, "graph": _network, "onnx": _onnx}
