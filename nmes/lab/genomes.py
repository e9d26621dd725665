"""Genomes for the builder: everything that is wrong with one, its body to draw, and its mutants."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Any

from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.genome.body import Body
from nmes.genome.inspection import inspect_body, inspect_brain
from nmes.lab.folder import LabError
from nmes.schemas.documents import JsonObject
from nmes.variation import ANY, Draw, mutate

__all__ = ["checked", "mutated"]


def checked(document: Any) -> JsonObject:
    """Returns all that `nmes genome check` finds in a document, and its body as far as there is one."""
    inspection = inspect_body(document)
    problems = [*inspection.problems, *inspect_brain(document, inspection)]
    return {
        "problems": [{"path": path, "message": message} for path, message in problems],
        "hash": None if problems else Genome(document).hash,
        "body": None if inspection.body is None else _drawn(inspection.body),
    }


def _drawn(body: Body) -> JsonObject:
    """Returns a body as boxes and joints."""
    places = {cube.id: place for place, cube in enumerate(body.cubes)}
    cubes = [
        {
            "id": cube.id,
            "size": cube.size,
            "mass": cube.mass,
            "position": cube.position,
            "quaternion": cube.quaternion,
            "color": cube.color,
            "shape": cube.shape,
            "later": cube.id in body.later,
        }
        for cube in body.cubes
    ]
    joints = [
        {
            "id": joint.id,
            "a": places[joint.cube1],
            "b": places[joint.cube2],
            "kind": joint.kind,
            "anchor": joint.anchor,
            "axis": joint.axis,
            "limits": joint.limits,
            "motor": joint.motor is not None,
        }
        for joint in body.joints
        if joint.cube1 in places and joint.cube2 in places  # else it is among the problems
    ]
    low, high = body.bounds
    return {
        "cubes": cubes,
        "joints": joints,
        "sensors": [{"id": one.id, "type": one.type, "of": one.target} for one in body.sensors],
        "outputs": list(body.outputs),
        "mass": body.mass,
        "bounds": [low, high],
    }


def mutated(asked: Mapping[str, Any], task: str | None) -> JsonObject:
    """Returns the genome that `nmes genome mutate` would make.

    Args:
        asked: `genome`, a document; and perhaps `seed` and `kind`.
        task: What means the task that it is to suit; None: any.

    Raises:
        DocumentError: It is no good genome.
        VariationError: There is no such kind, or nothing to change.
    """
    seed, kind = asked.get("seed", 0), asked.get("kind")
    if type(seed) is not int or not 0 <= seed < 1 << 63 or not (kind is None or isinstance(kind, str)):
        raise LabError("invalid", "a seed is a whole number from 0 on, and a kind of mutation a text", "seed")
    genome = Genome(asked.get("genome") or {})
    needs = ANY if task is None else Task.load(task).requirements
    mutant = mutate(genome, Draw(seed, "genome", 0), kind=kind, requirements=needs)
    options = [] if kind is None else ["--kind", kind]
    options += [] if task is None else ["--task", task]
    command = ["nmes", "genome", "mutate", f"{genome.name}.json", *options, "--seed", str(seed)]
    return {"genome": mutant.genome.document, "kind": mutant.kind, "command": shlex.join(command)}
