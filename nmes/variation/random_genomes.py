"""Random creatures to begin evolution with: trunks with limbs, symmetric or in segments, that swing.

Bodies are graphs of parts as K. Sims, "Evolving Virtual Creatures" (SIGGRAPH 1994), draws them: a trunk that may repeat
itself as segments do, and limbs on it, mostly mirrored, some of them with several links. Brains are mostly oscillators
of one frequency, since those move from the first tick on; some are small networks. Invariants: what is drawn is a good
genome that meets the requirements, and follows from the draw and the requirements alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import cos, pi, prod, sin
from typing import Final

from nmes.backend.rotation import total
from nmes.errors import DocumentError, VariationError
from nmes.genome import Genome
from nmes.genome.body import PALETTE, Body
from nmes.genome.development import hanging
from nmes.schemas.documents import JsonObject, fits
from nmes.variation.brains import motor_names, sensor_names
from nmes.variation.development_changes import delay
from nmes.variation.draw import Draw
from nmes.variation.joints import draw_joint
from nmes.variation.offspring import admitted
from nmes.variation.requirements import Requirements

__all__ = ["random_genome"]

_TRIES: Final = 150
_SMALLER: Final = 0.98  # from try to try, so that limits of mass and size are met in the end
_TRUNK: Final = "trunk"
_LARGEST: Final = 4.0  # m: the size for which bodies are drawn where there is no limit
_THINNEST: Final = 0.02  # m
_DENSITY: Final = (200.0, 1500.0)  # kg/m^3
_LIMBS: Final = 4
_FACES: Final = ("+z", "-z", "-y", "+y", "+x", "-x")
_FACING: Final = (0.35, 0.1, 0.25, 0.05, 0.15, 0.1)
_SWING: Final = (0.4, 1.4)  # rad: how far a limb swings to each side
_STRENGTH: Final = (0.2, 4.0)  # of a motor, of what lifts the whole body at the end of the limb
_GRAVITY: Final = 9.81
_FREQUENCY: Final = (0.5, 4.0)  # Hz
_RATE: Final = 60.0  # control steps a second, for which clocks of networks are drawn
_GAIN: Final = 1.1  # of a clock: above 1 it goes on by itself
_HEEDED: Final = 4  # sensors that a network listens to
_DEVELOPING: Final = 0.5  # of those that may develop
_BORN: Final = 3  # cubes that are there at birth, at most, of one that develops
_GROWN: Final = (0.1, 2.0)  # s: ages at which limbs grow


def random_genome(draw: Draw, requirements: Requirements, name: str) -> Genome:
    """Draws a creature.

    Args:
        draw: All choices.
        requirements: What its body must be like.
        name: The genome's.

    Raises:
        VariationError: `no_offspring`: none of many tries meets the requirements, as when they allow one cube.
    """
    planar, reason = requirements.planar, "its parts are in each other's way"
    most = min(requirements.limits.size or _LARGEST, _LARGEST)
    for number in range(_TRIES):
        graph = _graph(draw, most * _SMALLER**number, planar)
        document: JsonObject = {"format": "nmes-genome/1", "name": name, "body": {"graph": graph}}
        try:
            body = Genome(document).body
        except DocumentError:
            continue
        if not body.motors:
            reason = "it has no motor"
            continue
        document["brain"] = draw.one_of(tuple(_BRAINS), tuple(_BRAINS.values()))(body, draw)
        if requirements.development and draw.chance(_DEVELOPING):
            _delay_limbs(document, body, draw)
        try:
            return admitted(document, requirements)
        except DocumentError as error:
            reason = error.problems[0][1]
    raise VariationError("no_offspring", f"no try gave a random creature: the last: {reason}")


# -- bodies -----------------------------------------------------------------------------------------------------------


def _graph(draw: Draw, most: float, planar: bool) -> JsonObject:
    """Draws a graph of parts, good or not, with a trunk that is no longer than a part of `most`, in m."""
    trunk = _part(_TRUNK, most * _between(draw, 0.08, 0.3), _between(draw, *_DENSITY), draw)
    parts, connections = [trunk], list[JsonObject]()
    if draw.chance(0.3):
        trunk["recursive_limit"] = draw.count(2, 4)
        scale = round(draw.uniform(0.8, 1.1), 6)
        connections.append({"from": _TRUNK, "to": _TRUNK, "face": "+x", "scale": scale})
    for number in range(draw.count(1, _LIMBS)):
        _grow_limb(parts, connections, f"limb{number + 1}", draw, planar)
    for number, part in enumerate(parts):
        part["color"] = list(PALETTE[number % len(PALETTE)])
    weight = 2.0 * total(part["density"] * prod(part["size"]) for part in parts)  # for many are mirrored
    for part in parts:
        if part is not trunk or "recursive_limit" in trunk:
            part["joint"] = _joint(draw, weight, max(part["size"]), planar)
    return {"root": _TRUNK, "parts": parts, "connections": connections}


def _joint(draw: Draw, weight: float, length: float, planar: bool) -> JsonObject:
    """Draws a joint: mostly a hinge by which its part swings, rather than spins about its own length, to and fro.

    Others hardly move a body by themselves; mutation finds them where they are of use.
    """
    if draw.chance(0.15):
        return draw_joint(draw, weight, length, planar)
    reach = round(draw.uniform(*_SWING), 6)
    effort = round(_GRAVITY * weight * length * _between(draw, *_STRENGTH), 6)
    return {
        "type": "hinge",
        "axis": [0.0, 0.0, 1.0] if planar or draw.chance(0.5) else [0.0, 1.0, 0.0],
        "limits": [-reach, reach],
        "motor": {"mode": "position", "range": [-reach, reach], "max_effort": effort},
    }


def _part(name: str, length: float, density: float, draw: Draw) -> JsonObject:
    """Draws a part: as long as told along its x, and mostly slimmer along y and z."""
    edges = [length, *(max(length * _between(draw, 0.15, 0.9), _THINNEST) for _ in range(2))]
    return {"id": name, "size": [round(edge, 6) for edge in edges], "density": round(density, 3)}


def _between(draw: Draw, low: float, high: float) -> float:
    """Draws a positive number, evenly by its logarithm: from 1 to 2 as often as from 2 to 4."""
    return float(low * (high / low) ** draw.uniform(0.0, 1.0))


def _grow_limb(parts: list[JsonObject], connections: list[JsonObject], name: str, draw: Draw, planar: bool) -> None:
    """Lets a limb grow on the trunk or, less often, on another part: of one link, of one again and again, or of two."""
    parent = parts[0] if draw.chance(0.8) else draw.one_of(parts)
    length = max(parent["size"][0] * _between(draw, 0.25, 1.0), _THINNEST)
    limb = _part(name, length, parent["density"], draw)
    parts.append(limb)
    connections.append(_connection(parent["id"], name, draw, planar))
    links = draw.one_of(("one", "again", "two"), (0.5, 0.2, 0.3))
    if links == "again":
        limb["recursive_limit"] = draw.count(2, 3)
        connections.append({"from": name, "to": name, "face": "+x", "scale": round(draw.uniform(0.6, 1.0), 6)})
    elif links == "two":
        tip = name.replace("limb", "tip")
        length = max(length * draw.uniform(0.5, 1.2), _THINNEST)
        parts.append(_part(tip, length, parent["density"], draw))
        connections.append({"from": name, "to": tip, "face": "+x"})
        if draw.chance(0.5):
            connections[-1]["rotation"] = [0.0, 0.0, round(draw.normal(0.6), 6)]


def _connection(parent: str, child: str, draw: Draw, planar: bool) -> JsonObject:
    """Draws where a limb grows: most are on the sides, point down, and have a mirror image on the other side."""
    face = draw.one_of(_FACES[2:] if planar else _FACES, _FACING[2:] if planar else _FACING)
    at = [round(draw.uniform(-0.9, 0.9), 6), 0.0 if planar else round(draw.uniform(-0.9, 0.9), 6)]
    connection: JsonObject = {"from": parent, "to": child, "face": face, "at": at}
    if draw.chance(0.8):
        down = draw.normal(0.4) if face[1] == "y" else -draw.uniform(0.0, 1.3)
        turn = [0.0, 0.0, down] if planar else [draw.normal(0.2), draw.normal(0.3), down]
        connection["rotation"] = [round(angle, 6) for angle in turn]
    if draw.chance(0.65):
        connection["mirror"] = draw.one_of("xy") if planar else draw.one_of("zx", (0.8, 0.2))
    return connection


def _delay_limbs(document: JsonObject, body: Body, draw: Draw) -> None:
    """Has a creature be born with few of its cubes; each limb on these grows at an age of its own."""
    parts = list(hanging(body))
    for part in parts[draw.count(0, min(len(parts), _BORN) - 1) :]:
        if part not in document.get("later", ()):
            delay(document, body, part, _between(draw, *_GROWN))


# -- brains -----------------------------------------------------------------------------------------------------------


def _groups(body: Body) -> list[tuple[str, bool]]:
    """Returns the outputs of a brain: of each part one for the motors that grew of it, and one for their mirror images.

    Each is a pattern, and whether it is of mirror images; those come first, for what they fit the other fits too.
    """
    names = motor_names(body)
    groups = []
    for part in dict.fromkeys(name.partition(".")[0] for name in names):
        patterns = ((f"{part}*.mirror", True), (f"{part}*", False))
        images = [name for name in names if fits(patterns[0][0])(name)]
        others = [name for name in names if fits(patterns[1][0])(name) and name not in images]
        groups += [pattern for pattern, fitting in zip(patterns, (images, others), strict=True) if fitting]
    return groups


def _sine(body: Body, draw: Draw) -> JsonObject:
    """Draws oscillators of one frequency; those of mirror images swing with their twins or against them."""
    frequency, oscillators = round(_between(draw, *_FREQUENCY), 6), list[JsonObject]()
    twin: JsonObject = {}
    for pattern, _ in _groups(body):
        phase, shift = draw.uniform(-pi, pi), draw.one_of((0.0, pi))
        if pattern.partition("*")[0] == twin.get("motor", "").partition("*")[0]:
            oscillators.append({**twin, "motor": pattern, "phase": round(twin["phase"] + shift, 6)})
            continue
        twin = {"motor": pattern, "frequency": frequency, "amplitude": round(draw.uniform(0.3, 1.0), 6)}
        twin["phase"] = round(phase, 6)
        twin["step"] = draw.one_of((0.0, round(pi, 6), round(draw.uniform(-pi, pi), 6)))
        twin["offset"] = round(draw.normal(0.25), 6)
        oscillators.append(twin)
    return {"kind": "sine", "oscillators": oscillators}


def _cpg(body: Body, draw: Draw) -> JsonObject:
    """Draws the oscillators of `_sine`, with one or two terms of feedback from a sensor."""
    brain = {**_sine(body, draw), "kind": "cpg"}
    brain["feedback"] = [
        {
            "sensor": draw.one_of(sensor_names(body)),
            "motor": draw.one_of(brain["oscillators"])["motor"],
            draw.one_of(("rate", "offset")): round(draw.normal(), 6),
        }
        for _ in range(draw.count(1, 2))
    ]
    return brain


def _network(body: Body, draw: Draw) -> JsonObject:
    """Draws a network in which two nodes that turn about each other are the clock, and each output heeds a sensor.

    They are the oscillator of F. Pasemann, M. Hild and K. Zahedi, "SO(2)-networks as neural oscillators" (2003).
    """
    turn = 2.0 * pi * _between(draw, *_FREQUENCY) / _RATE
    nodes: list[JsonObject] = [{"id": "clock1", "bias": 0.05}, {"id": "clock2"}]
    links: list[JsonObject] = [
        {"from": source, "to": target, "weight": round(_GAIN * weight, 6)}
        for source, target, weight in (
            ("clock1", "clock1", cos(turn)),
            ("clock1", "clock2", sin(turn)),
            ("clock2", "clock1", -sin(turn)),
            ("clock2", "clock2", cos(turn)),
        )
    ]
    for number, (pattern, _) in enumerate(_groups(body), 1):
        node = f"out{number}"
        nodes.append({"id": node, "motor": pattern, "bias": round(draw.normal(0.25), 6)})
        links += [{"from": clock, "to": node, "weight": round(draw.normal(), 6)} for clock in ("clock1", "clock2")]
        links.append({"sensor": draw.one_of(sensor_names(body)), "to": node, "weight": round(draw.normal(0.5), 6)})
    return {"kind": "graph", "nodes": nodes, "links": links}


def _ctrnn(body: Body, draw: Draw) -> JsonObject:
    """Draws a continuous-time network that is likely to oscillate, since all its neurons can be half awake at once.

    That is "center-crossing" in B. Mathayomchan and R. D. Beer, "Center-crossing recurrent neural networks for the
    evolution of rhythmic behavior" (2002).
    """
    outputs = [pattern for pattern, _ in _groups(body)]
    count, names = len(outputs) + 2, sensor_names(body)
    inputs = list(dict.fromkeys(draw.one_of(names) for _ in range(_HEEDED)))
    weights = [[round(draw.normal(5.0), 6) for _ in range(count)] for _ in range(count)]
    return {
        "kind": "ctrnn",
        "inputs": inputs,
        "outputs": outputs,
        "time_constants": [round(_between(draw, 0.03, 0.5), 6) for _ in range(count)],
        "biases": [round(-total(row) / 2.0, 6) for row in weights],
        "weights": weights,
        "input_weights": [[round(draw.normal(), 6) for _ in inputs] for _ in range(count)],
    }


_BRAINS: Final[Mapping[Callable[[Body, Draw], JsonObject], float]] = {
    _sine: 0.5,
    _cpg: 0.3,
    _network: 0.1,
    _ctrnn: 0.1,
}
"""How brains are drawn, each with how often."""
