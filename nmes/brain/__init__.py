"""Brains: the controllers of creatures, as documents that people share and as programs that run.

    brain = load_brain({"kind": "sine", "oscillators": [{"motor": "*"}]}, inputs=[], outputs=["hip", "knee"])
    brain.reset(seed=0, dt=1 / 60)
    controls = brain.step(sensors)

Each kind has a schema, `schemas/brain-KIND.json`; `docs/brains.md` describes them. This package hides how a document
becomes arrays and how those are run; a caller knows names, one vector of parameters, and steps.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

from nmes.brain.base import Brain, BrainBatch, stack
from nmes.brain.models import OnnxBrain
from nmes.brain.networks import CtrnnBrain, GraphBrain, MlpBrain
from nmes.brain.oscillators import CpgBrain, SineBrain
from nmes.errors import DocumentError
from nmes.schemas.documents import did_you_mean

__all__ = ["KINDS", "Brain", "BrainBatch", "load_brain", "stack"]

KINDS: Final[Mapping[str, type[Brain]]] = {
    kind.kind: kind for kind in (SineBrain, CpgBrain, MlpBrain, CtrnnBrain, GraphBrain, OnnxBrain)
}
"""Every kind of brain."""


def load_brain(
    document: Any, inputs: Sequence[str], outputs: Sequence[str], where: str = "brain", unsure: Collection[str] = ()
) -> Brain:
    """Returns the brain that a document describes, for a body with these sensors and motors.

    Args:
        document: Plain JSON data, or arrays of numpy's in the place of arrays of numbers.
        inputs: Names of the body's sensors, in the order in which they will be read.
        outputs: Names of the body's motors, in the order in which they will be driven.
        where: JSON Pointer of the brain, without its leading slash, to tell where something is wrong.
        unsure: `sensors` or `motors`, where the body, which is wrong itself, may have more of them than are named: a
            brain that names others is not blamed.

    Raises:
        DocumentError: It is none, or does not fit the body; `problems` are all that was found.
        MissingPackage: It needs a package that is not installed.
    """
    kind = document.get("kind") if isinstance(document, Mapping) else None
    if kind is None:
        raise DocumentError([(where, f"a brain is an object with a 'kind': {', '.join(KINDS)}")])
    if not isinstance(kind, str) or kind not in KINDS:
        hint = did_you_mean(kind, KINDS) if isinstance(kind, str) else ""
        pointer = "/".join(filter(None, (where, "kind")))
        raise DocumentError([(pointer, f"there is no such kind of brain{hint or ': there are ' + ', '.join(KINDS)}")])
    return KINDS[kind](document, inputs, outputs, where, unsure)
