"""From a document whose body was changed to a genome: sensors, rules and brain go along, and all of it is judged.

Hides what a child keeps of its parent's document besides the body: its name and licence, but neither its author nor
what was said about it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nmes.errors import DocumentError
from nmes.genome import Genome
from nmes.genome.body import Body
from nmes.schemas.documents import JsonObject, fits
from nmes.variation.brains import carry_over, motor_names, sensor_names
from nmes.variation.development_changes import carry_over_development
from nmes.variation.draw import Draw
from nmes.variation.requirements import Requirements

__all__ = ["admitted", "offspring", "written_sensors"]


def offspring(
    document: JsonObject, before: Body, parents: Sequence[Genome], draw: Draw, requirements: Requirements
) -> Genome:
    """Returns the genome that a changed document becomes.

    Args:
        document: Its body was changed; its sensors, its development and its brain are still those of the body before.
        before: That body.
        parents: Of whom it comes.
        draw: What is new in the brain.
        requirements: What the genome's body must be like.

    Raises:
        DocumentError: It is no good genome, its brain is none for its body, or it does not meet the requirements.
    """
    child = {name: value for name, value in document.items() if name not in ("author", "description")}
    child["parents"] = list(dict.fromkeys(parent.hash for parent in parents))
    after = _body_of(child)
    carry_over_development(child, after)
    if "brain" in child and _names(before) != _names(after):
        child["brain"] = carry_over(child["brain"], before, after, draw)
    return admitted(child, requirements)


def admitted(document: JsonObject, requirements: Requirements) -> Genome:
    """Returns the genome of a document.

    Args:
        document: It, whole.
        requirements: What its body must be like.

    Raises:
        DocumentError: It is no good genome, its brain is none for its body, or it does not meet the requirements.
    """
    genome = Genome(document)
    genome.check_brain()
    reasons = requirements.check(genome.body)
    if reasons:
        raise DocumentError([("body", reason) for reason in reasons])
    return genome


def _names(body: Body) -> tuple[list[str], list[str]]:
    return sensor_names(body), motor_names(body)


def _body_of(document: JsonObject) -> Body:
    """Returns the body of a document, whose sensors are taken away where it has nothing that they could be on."""
    bare: JsonObject = {name: document[name] for name in ("format", "name", "body", "voices") if name in document}
    if "sensors" not in document:
        return Genome(bare).body
    body = Genome({**bare, "sensors": []}).body
    document["sensors"] = [sensor for sensor in document["sensors"] if _readable(sensor, body)]
    return Genome({**bare, "sensors": document["sensors"]}).body


def _readable(sensor: Mapping[str, Any], body: Body) -> bool:
    """Tells whether there is what a sensor of a document is on."""
    if "cube" in sensor:
        names = [cube.id for cube in body.cubes]
    elif sensor["type"] == "effort":
        names = [joint.id for joint in body.joints if joint.motor is not None]
    else:
        names = [joint.id for joint in body.joints if joint.kind in ("hinge", "slide")]
    return any(map(fits(sensor["cube" if "cube" in sensor else "joint"]), names))


def written_sensors(body: Body) -> list[JsonObject]:
    """Returns the sensors that a body has by default as a document names them."""
    written: dict[tuple[str, str], JsonObject] = {}
    for sensor in body.sensors:
        written[sensor.type, sensor.target] = {"type": sensor.type, sensor.of: sensor.target}
    return list(written.values())
