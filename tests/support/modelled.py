"""A small creature whose brain is an ONNX model: what it does may be rounded otherwise on another processor."""

from __future__ import annotations

from base64 import b64encode
from typing import Any

import numpy as np

from creatures import seedling
from nmes.genome import Genome
from onnx_models import layer

__all__ = ["modelled"]


def modelled() -> dict[str, Any]:
    """Returns the genome of a seedling that an ONNX model drives by all that it senses."""
    body = Genome(seedling()).body
    weights = np.random.default_rng(0).normal(0.0, 1.0, (len(body.sensors), len(body.outputs)))
    model = layer(weights, np.full((1, len(body.outputs)), 0.5))
    return seedling() | {"brain": {"kind": "onnx", "model": b64encode(model).decode()}}
