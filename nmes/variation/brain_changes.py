"""How brains are changed: each function makes one small change to a brain's document, in place.

Networks change their numbers (`weights`) and their structure (`topology`); oscillators their waves (`oscillators`) and
who listens to whom (`topology`). A node that splits a link is named after it, so that the same step, taken in two
lines of descent, has the same name in both: what K. O. Stanley and R. Miikkulainen, "Evolving Neural Networks through
Augmenting Topologies" (2002), number as innovations. Each returns False where the brain has nothing that it could
change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from hashlib import blake2b
from math import pi
from typing import Final

import numpy as np

from nmes.brain import load_brain
from nmes.genome.body import Body
from nmes.schemas.documents import JsonObject, fits
from nmes.variation.brains import motor_names, sensor_names
from nmes.variation.draw import Draw

__all__ = ["CHANGES", "splitting_node"]

_ACTIVATIONS: Final = ("tanh", "sigmoid", "sin", "cos", "gauss", "relu", "abs", "identity")
_MOST_NODES, _MOST_LINKS, _MOST_NEURONS, _MOST_TERMS = 1024, 16384, 512, 1024
_STEP: Final = 0.3  # standard deviation of a change of a weight; of a large one, a third of itself
_WAVES: Final = {"frequency": (1.0, 0.0, 100.0), "amplitude": (0.5, -10.0, 10.0), "phase": (0.0, -100.0, 100.0)}
_WAVES_MORE: Final = {"step": (0.0, -100.0, 100.0), "offset": (0.0, -10.0, 10.0)}
_SPREAD: Final = {"amplitude": 0.15, "phase": 0.5, "step": 0.3, "offset": 0.15}


def _bounded(value: float, low: float, high: float) -> float:
    return round(min(max(value, low), high), 6)


def _weights(brain: JsonObject, body: Body, draw: Draw) -> bool:
    """Shifts some of a network's numbers, at least one."""
    if brain["kind"] in ("sine", "cpg"):
        return False
    read = load_brain(brain, sensor_names(body), motor_names(body))
    vector = read.to_vector()
    if not len(vector):
        return False
    part = draw.one_of((1.0 / len(vector), 0.1, 0.5))
    chosen = [i for i in range(len(vector)) if draw.chance(part)] or [draw.count(0, len(vector) - 1)]
    for i in chosen:
        vector[i] = round(vector[i] + draw.normal(_STEP * max(1.0, abs(float(vector[i])) / 3.0)), 6)
    changed = read.with_vector(np.asarray(vector)).document
    brain.clear()
    brain.update(changed)
    return True


def _oscillators(brain: JsonObject, body: Body, draw: Draw) -> bool:
    """Changes one number of an oscillator, the frequency of all, or one of how they pull at each other."""
    if brain["kind"] not in ("sine", "cpg"):
        return False
    terms = [(name, term) for name in ("links", "chains", "feedback") for term in brain.get(name, ())]
    if terms and draw.chance(0.25):
        name, term = draw.one_of(terms)
        _change_term(name, term, draw)
        return True
    names = {**_WAVES, **_WAVES_MORE}
    what = draw.one_of(tuple(names), (0.2, 0.25, 0.25, 0.1, 0.2))
    oscillators = brain["oscillators"]
    together = what == "frequency" and draw.chance(0.6)
    factor, shift = draw.factor(0.15), draw.normal(_SPREAD.get(what, 0.0))
    default, low, high = names[what]
    for each in oscillators if together else [draw.one_of(oscillators)]:
        value = each.get(what, default)
        each[what] = _bounded(value * factor if what == "frequency" else value + shift, low, high)
    return True


def _change_term(name: str, term: JsonObject, draw: Draw) -> None:
    if name == "feedback":
        what = draw.one_of(("rate", "offset"))
        term[what] = _bounded(term.get(what, 0.0) + draw.normal(0.5), -1000.0, 1000.0)
    elif draw.chance(0.5):
        term["lag"] = _bounded(term.get("lag", 0.0) + draw.normal(0.4), -100.0, 100.0)
    else:
        term["weight"] = _bounded(term.get("weight", 4.0) * draw.factor(0.3), -100.0, 100.0)


def _topology(brain: JsonObject, body: Body, draw: Draw) -> bool:
    """Changes the structure of a brain."""
    change = _STRUCTURES.get(brain["kind"])
    return change is not None and change(brain, body, draw)


def _waves_structure(brain: JsonObject, body: Body, draw: Draw) -> bool:
    """Gives one motor an oscillator of its own; of a cpg also adds or takes away a link or a feedback."""
    what = draw.one_of(("own", "link", "feedback", "less")) if brain["kind"] == "cpg" else "own"
    motors, sensors = motor_names(body), sensor_names(body)
    if what == "own":
        return _own_oscillator(brain, motors, draw)
    if what == "less":
        names = [name for name in ("links", "chains", "feedback") if brain.get(name)]
        if not names:
            return False
        terms = brain[draw.one_of(names)]
        terms.remove(draw.one_of(terms))
        return True
    terms = brain.setdefault("links" if what == "link" else "feedback", [])
    driven = [name for name in motors if any(_stands(each["motor"], name) for each in brain["oscillators"])]
    if len(terms) >= _MOST_TERMS or len(driven) < 2 or (what == "feedback" and not sensors):
        return False
    if what == "link":
        source = draw.one_of(driven)
        target = draw.one_of([name for name in driven if name != source])
        terms.append({"from": source, "to": target, "weight": 4.0, "lag": round(draw.uniform(-pi, pi), 6)})
    else:
        term = {"sensor": draw.one_of(sensors), "motor": draw.one_of(driven)}
        terms.append({**term, draw.one_of(("rate", "offset")): round(draw.normal(), 6)})
    return True


def _own_oscillator(brain: JsonObject, motors: list[str], draw: Draw) -> bool:
    """Gives a motor that shares an oscillator a copy of it for itself."""
    own = {each["motor"] for each in brain["oscillators"]}
    shared = [name for name in motors if name not in own]
    if not shared or len(brain["oscillators"]) >= _MOST_TERMS:
        return False
    motor = draw.one_of(shared)
    like = [each for each in brain["oscillators"] if _stands(each["motor"], motor)] or brain["oscillators"]
    phase = _bounded(like[0].get("phase", 0.0) + draw.normal(0.5), -100.0, 100.0)
    brain["oscillators"].append({**like[0], "motor": motor, "phase": phase})
    return True


def _stands(entry: str, name: str) -> bool:
    return entry == name or (bool(set(entry) & set("*?")) and fits(entry)(name))


def _mlp_structure(brain: JsonObject, body: Body, draw: Draw) -> bool:
    """Adds a hidden unit, takes one away, or changes an activation."""
    layers = brain["layers"]
    if len(layers) < 2 or draw.chance(0.2):
        draw.one_of(layers)["activation"] = draw.one_of(_ACTIVATIONS)
        return True
    number = draw.count(0, len(layers) - 2)
    layer, onward = layers[number], layers[number + 1]
    units = len(layer["biases"])
    if units > 1 and draw.chance(0.4):
        gone = draw.count(0, units - 1)
        for name in ("weights", "biases"):
            del layer[name][gone]
        for row in onward["weights"]:
            del row[gone]
        return True
    if units >= _MOST_NODES:
        return False
    layer["weights"].append([round(draw.normal(), 6) for _ in layer["weights"][0]])
    layer["biases"].append(0.0)
    for row in onward["weights"]:
        row.append(round(draw.normal(_STEP), 6))
    return True


def _ctrnn_structure(brain: JsonObject, body: Body, draw: Draw) -> bool:
    """Adds a neuron behind those of the motors, or takes one away there."""
    motors, neurons = len(brain.get("outputs", motor_names(body))), len(brain["biases"])
    if neurons > motors and draw.chance(0.4):
        gone = draw.count(motors, neurons - 1)
        for name in ("time_constants", "biases", "weights", "input_weights"):
            del brain[name][gone]
        for row in brain["weights"]:
            del row[gone]
        return True
    if neurons >= _MOST_NEURONS:
        return False
    brain["time_constants"].append(round(0.05 * 20.0 ** draw.uniform(0.0, 1.0), 6))
    brain["biases"].append(round(draw.normal(), 6))
    for row in brain["weights"]:
        row.append(round(draw.normal(_STEP), 6))
    brain["weights"].append([round(draw.normal(), 6) for _ in range(neurons + 1)])
    brain["input_weights"].append([round(draw.normal(_STEP), 6) for _ in brain["input_weights"][0]])
    return True


def _graph_structure(brain: JsonObject, body: Body, draw: Draw) -> bool:
    """Adds a link, splits one by a node, takes a link or a node away, or changes an activation."""
    brain.setdefault("links", [])
    change = draw.one_of((_add_link, _split_link, _remove_link, _remove_node, _activate), (0.4, 0.25, 0.15, 0.05, 0.15))
    return change(brain, body, draw)


def _add_link(brain: JsonObject, body: Body, draw: Draw) -> bool:
    sources = [("from", node["id"]) for node in brain["nodes"]] + [("sensor", name) for name in sensor_names(body)]
    end, source = draw.one_of(sources)
    target = draw.one_of(brain["nodes"])["id"]
    known = any(link.get(end) == source and link["to"] == target for link in brain["links"])
    if known or len(brain["links"]) >= _MOST_LINKS:
        return False
    brain["links"].append({end: source, "to": target, "weight": round(draw.normal(), 6)})
    return True


def _split_link(brain: JsonObject, body: Body, draw: Draw) -> bool:
    """Puts a node into a link: 1 on the way in and the old weight on the way out, as NEAT does."""
    if not brain["links"] or len(brain["nodes"]) >= _MOST_NODES or len(brain["links"]) >= _MOST_LINKS - 1:
        return False
    link = draw.one_of(brain["links"])
    source = {end: link[end] for end in ("from", "sensor") if end in link}
    node = splitting_node(source, link["to"])
    if any(each["id"] == node for each in brain["nodes"]):
        return False  # it was split before
    brain["nodes"].append({"id": node, "activation": draw.one_of(_ACTIVATIONS), "bias": 0.0})
    brain["links"].remove(link)
    brain["links"] += [{**source, "to": node}, {"from": node, "to": link["to"], "weight": link.get("weight", 1.0)}]
    return True


def splitting_node(source: Mapping[str, str], target: str) -> str:
    """Returns the id of the node that splits a link, the same in every line of descent.

    Args:
        source: Where the link comes from, as it says: `from` a node, or a `sensor`.
        target: The node that it goes to.
    """
    return "split." + blake2b(f"{source} {target}".encode(), digest_size=6).hexdigest()


def _remove_link(brain: JsonObject, body: Body, draw: Draw) -> bool:
    if not brain["links"]:
        return False
    brain["links"].remove(draw.one_of(brain["links"]))
    return True


def _remove_node(brain: JsonObject, body: Body, draw: Draw) -> bool:
    hidden = [node for node in brain["nodes"] if "motor" not in node]
    if not hidden:
        return False
    node = draw.one_of(hidden)
    brain["nodes"].remove(node)
    brain["links"] = [link for link in brain["links"] if node["id"] not in (link.get("from"), link["to"])]
    return True


def _activate(brain: JsonObject, body: Body, draw: Draw) -> bool:
    draw.one_of(brain["nodes"])["activation"] = draw.one_of(_ACTIVATIONS)
    return True


_Change = Callable[[JsonObject, Body, Draw], bool]

_STRUCTURES: Final[Mapping[str, _Change]] = {
    "sine": _waves_structure,
    "cpg": _waves_structure,
    "mlp": _mlp_structure,
    "ctrnn": _ctrnn_structure,
    "graph": _graph_structure,
}

CHANGES: Final[Mapping[str, _Change]] = {
    "weights": _weights,
    "oscillators": _oscillators,
    "topology": _topology,
}
"""The changes of a brain by name: functions of its document, the body that it drives, and a draw."""
