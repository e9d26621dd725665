"""Brains that a world runs by itself: before each tick they sense and drive.

Hides what such a brain is begun with, and what a snapshot holds of it. Invariant: what a mind does follows from its
creature's genome, its seed and what it sensed so far; restored from its `state`, it goes on bit for bit.
"""

from __future__ import annotations

from hashlib import blake2b
from typing import TYPE_CHECKING

import numpy as np

from nmes.backend import Array
from nmes.errors import DocumentError, WorldError
from nmes.genome import Genome
from nmes.world.snapshot import pack_array, unpack_array

if TYPE_CHECKING:
    from nmes.world.creature import Creature

__all__ = ["Mind", "require_mind"]

_FOREIGN = "onnx"  # what such a model computes and costs is its author's to say, and its package may be missing


class Mind:
    """The running brain of one creature.

    Args:
        genome: Whose brain it is.
        seed: The world's.
        number: Of the creature, never used twice in its world.
        dt: A tick, s.
        state: Of a mind that is to go on, as `state` told it; None: a new one.

    Raises:
        DocumentError: The genome's brain is none for its body.
        ValueError: The state is none of such a mind.
    """

    def __init__(self, genome: Genome, seed: int, number: int, dt: float, state: str | None = None) -> None:
        self._brain = genome.brain()
        digest = blake2b(f"{seed}:mind:{number}".encode(), digest_size=8).digest()
        self._brain.reset(int.from_bytes(digest, "little"), dt)
        self._blind = np.zeros(len(self._brain.inputs)) if self._brain.open_loop else None
        if state is not None:
            self._brain.recall(unpack_array(state, 1).reshape(-1))

    def act(self, creature: Creature) -> None:
        """Senses, thinks, and drives its creature."""
        creature.drive(self._brain.step(creature.sense() if self._blind is None else self._blind))

    def memory(self) -> Array:
        """Returns the state of the brain, shape (k,)."""
        return self._brain.memory()

    def activity(self) -> Array:
        """Returns the last activity of the brain's units, shape (k,), as `Brain.activity`."""
        return self._brain.activity()

    def state(self) -> str:
        """Returns its memory for a snapshot."""
        return pack_array(self.memory())


def require_mind(genome: Genome) -> None:
    """Raises unless a world can run the brain of a genome.

    Raises:
        WorldError: `invalid`: it has none, a bad one, or a model that only its own package runs.
    """
    kind = genome.document.get("brain", {}).get("kind")
    if kind == _FOREIGN:
        raise WorldError("invalid", "genome: a world does not run ONNX models: drive it from outside", "genome/brain")
    try:
        genome.brain()
    except DocumentError as error:
        raise WorldError("invalid", f"genome: {error.message}", "genome/brain") from error
