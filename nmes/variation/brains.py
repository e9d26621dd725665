"""How a brain goes along when its body changes: by the names of sensors and motors.

What still has its name keeps its weights; what is gone is taken out of the document; a motor that is new gets a part of
the brain of its own, drawn at random, and a new sensor is there to be listened to. A brain that knows its body by
wildcards goes along by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import pi, sqrt
from typing import Any, Final

from nmes.genome.body import Body
from nmes.schemas.documents import JsonObject, fits
from nmes.variation.draw import Draw

__all__ = ["carry_over", "draw_oscillator", "motor_names", "sensor_names"]

_NEURON_TIME = 0.3  # s: of a neuron that comes with a motor


def sensor_names(body: Body) -> list[str]:
    """Returns the names of a body's sensors, in the order of a brain's inputs."""
    return [sensor.id for sensor in body.sensors]


def motor_names(body: Body) -> list[str]:
    """Returns the names of a body's motors and voices, in the order of a brain's outputs."""
    return list(body.outputs)


def carry_over(document: JsonObject, before: Body, after: Body, draw: Draw) -> JsonObject:
    """Returns the brain of a body that has changed.

    Args:
        document: The brain as it was: a good one for the body before.
        before: The body before.
        after: The body now.
        draw: What is new.

    Returns:
        A brain of the same kind. It may be none for this body: if there is no motor left, or it is an ONNX model that
        names what is gone.
    """
    return _CARRY[document["kind"]](document, before, after, draw)


def _dealt(entries: Sequence[str], names: Sequence[str]) -> tuple[list[int], list[str]]:
    """Deals names out to entries as brains do; returns which entries have some, and which names have none."""
    free = dict.fromkeys(names)
    owning = []
    exact = [number for number, entry in enumerate(entries) if entry in free]
    others = [number for number, entry in enumerate(entries) if entry not in free]
    for number in exact + others:
        entry = entries[number]
        own = [entry] if entry in names else list(filter(fits(entry), names)) if set(entry) & set("*?") else []
        taken = [name for name in own if name in free]
        if taken:
            owning.append(number)
        for name in taken:
            del free[name]
    return sorted(owning), list(free)


def _any(entry: str, names: Sequence[str]) -> bool:
    """Tells whether an entry stands for anything."""
    return entry in names or (bool(set(entry) & set("*?")) and any(map(fits(entry), names)))


def draw_oscillator(motor: str, like: Sequence[JsonObject], draw: Draw) -> JsonObject:
    """Draws an oscillator for a motor, of the frequency of one of those that are there."""
    frequency = draw.one_of(like).get("frequency", 1.0) if like else round(0.5 * 6.0 ** draw.uniform(0.0, 1.0), 6)
    amplitude, phase = round(draw.uniform(0.3, 1.0), 6), round(draw.uniform(-pi, pi), 6)
    return {"motor": motor, "frequency": frequency, "amplitude": amplitude, "phase": phase}


def _waves(document: JsonObject, before: Body, after: Body, draw: Draw) -> JsonObject:
    """Of `sine` and `cpg`."""
    sensors, motors = sensor_names(after), motor_names(after)
    oscillators = document["oscillators"]
    owning, free = _dealt([each["motor"] for each in oscillators], motors)
    new = [name for name in free if name not in motor_names(before)]
    changed = {**document, "oscillators": [oscillators[number] for number in owning]}
    changed["oscillators"] += [draw_oscillator(name, changed["oscillators"], draw) for name in new]
    driven = [name for name in motors if name not in free or name in new]
    if "links" in document:
        changed["links"] = [each for each in document["links"] if _links_two(each, driven)]
    if "chains" in document:
        changed["chains"] = [each for each in document["chains"] if _any(each["motors"], driven)]
    if "feedback" in document:
        heard = [each for each in document["feedback"] if _any(each["sensor"], sensors)]
        changed["feedback"] = [each for each in heard if _any(each["motor"], driven)]
    return changed


def _links_two(link: JsonObject, motors: Sequence[str]) -> bool:
    ends = [[name for name in motors if _any(link[end], [name])] for end in ("from", "to")]
    return all(ends) and not (len(ends[0]) == 1 and ends[0] == ends[1])


def _columns(document: JsonObject, before: Body, after: Body) -> tuple[list[str], list[int | None]]:
    """Returns a network's inputs in the body now and, for each, the column that it had; None for one that is new."""
    names = sensor_names(before)
    entries = document.get("inputs", names)
    owning, free = _dealt(entries, sensor_names(after))
    new = [name for name in free if name not in names]
    columns: list[int | None] = [*owning, *(None for _ in new)]
    kept = [entries[number] for number in owning] + new
    if not kept and free:
        kept, columns = free[:1], [None]
    return kept, columns


def _outputs(document: JsonObject, before: Body, after: Body) -> tuple[list[str], list[int | None]]:
    """Returns a network's outputs in the body now and, for each, the row that it had; None for one that is new."""
    names = motor_names(before)
    entries = document.get("outputs", names)
    owning, free = _dealt(entries, motor_names(after))
    new = [name for name in free if name not in names]
    return [entries[number] for number in owning] + new, [*owning, *(None for _ in new)]


def _taken(row: Sequence[float], columns: Sequence[int | None]) -> list[float]:
    """Returns a row's numbers in other columns, with zeros in those that are new."""
    return [0.0 if column is None else row[column] for column in columns]


def _weak(count: int, draw: Draw) -> list[float]:
    """Draws the weights of a new unit, the weaker the more it listens to."""
    return [round(draw.normal(1.0 / sqrt(max(count, 1))), 6) for _ in range(count)]


def _mlp(document: JsonObject, before: Body, after: Body, draw: Draw) -> JsonObject:
    inputs, columns = _columns(document, before, after)
    outputs, rows = _outputs(document, before, after)
    layers = [dict(layer) for layer in document["layers"]]
    layers[0]["weights"] = [_taken(row, columns) for row in layers[0]["weights"]]
    last = layers[-1]
    width = len(last["weights"][0])
    weights, biases = last["weights"], last["biases"]
    last["weights"] = [_weak(width, draw) if row is None else weights[row] for row in rows]
    last["biases"] = [0.0 if row is None else biases[row] for row in rows]
    return {**document, "inputs": inputs, "outputs": outputs, "layers": layers}


def _ctrnn(document: JsonObject, before: Body, after: Body, draw: Draw) -> JsonObject:
    inputs, columns = _columns(document, before, after)
    outputs, rows = _outputs(document, before, after)
    motors = len(document.get("outputs", motor_names(before)))
    order = [*rows, *range(motors, len(document["biases"]))]  # the neurons behind those of motors stay as they are

    def neurons(name: str, new: float) -> list[float]:
        return [new if row is None else document[name][row] for row in order]

    return {
        **document,
        "inputs": inputs,
        "outputs": outputs,
        "time_constants": neurons("time_constants", _NEURON_TIME),
        "biases": neurons("biases", 0.0),
        "weights": [
            _weak(len(order), draw) if row is None else _taken(document["weights"][row], order) for row in order
        ],
        "input_weights": [
            _weak(len(columns), draw) if row is None else _taken(document["input_weights"][row], columns)
            for row in order
        ],
    }


def _graph(document: JsonObject, before: Body, after: Body, draw: Draw) -> JsonObject:
    sensors = sensor_names(after)
    driving = [node for node in document["nodes"] if "motor" in node]
    owning, free = _dealt([node["motor"] for node in driving], motor_names(after))
    kept = {driving[number]["id"] for number in owning}
    nodes = [node for node in document["nodes"] if "motor" not in node or node["id"] in kept]
    ids = [node["id"] for node in nodes]
    links = [
        link
        for link in document.get("links", ())
        if link["to"] in ids and (link["from"] in ids if "from" in link else _any(link["sensor"], sensors))
    ]
    for motor in free:
        if motor not in motor_names(before):
            node: JsonObject = {"id": _free_id(motor, ids), "motor": motor, "activation": "tanh", "bias": 0.0}
            links += _first_links(node["id"], ids, sensors, draw)
            nodes.append(node)
            ids.append(node["id"])
    return {**document, "nodes": nodes, "links": links}


def _first_links(node: str, ids: Sequence[str], sensors: Sequence[str], draw: Draw) -> list[JsonObject]:
    """Draws what a new node listens to: a sensor and another node, where there are any."""
    links: list[JsonObject] = []
    if ids:
        links.append({"from": draw.one_of(ids), "to": node, "weight": round(draw.normal(), 6)})
    if sensors:
        links.append({"sensor": draw.one_of(sensors), "to": node, "weight": round(draw.normal(), 6)})
    return links


def _free_id(name: str, ids: Sequence[str]) -> str:
    number, free = 1, name
    while free in ids:
        number += 1
        free = f"{name}.{number}"
    return free


def _model(document: JsonObject, before: Body, after: Body, draw: Draw) -> JsonObject:
    """An ONNX model stays as it is, with the names that it was made for."""
    return {"inputs": sensor_names(before), "outputs": motor_names(before), **document}


_CARRY: Final[Mapping[str, Callable[[JsonObject, Body, Body, Draw], dict[str, Any]]]] = {
    "sine": _waves,
    "cpg": _waves,
    "mlp": _mlp,
    "ctrnn": _ctrnn,
    "graph": _graph,
    "onnx": _model,
}
