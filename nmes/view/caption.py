"""The line over a picture of a film: what is seen, at what time, and for an episode what it is worth so far.

It hides fonts, and where the words come from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from nmes.backend import Array
from nmes.backend import Image as Pixels
from nmes.errors import DocumentError, ProofError, RecordingError, visible
from nmes.evaluation.proof import recorded_episode, scores_so_far
from nmes.recording import Recording
from nmes.view.chart import number

__all__ = ["Caption"]

_NARROW = 160  # pixels: a picture with fewer across has no room for a line
_PART = 16  # of a picture's height is the line's
_LEAST = 16  # pixels of its height
_LETTERS = 0.62  # of its height
_INK, _PAPER, _SHADE = (255, 255, 255), (22, 26, 34), 0.72
_ROUNDING = 1e-9  # s


@dataclass(frozen=True, slots=True, eq=False)
class Caption:
    """The line over the pictures of one recording.

    Attributes:
        title: What is seen; empty for no line at all.
        scores: Array (n, 2) of times since the recording began, s, and of scores so far; None where there are none.
    """

    title: str
    scores: Array | None = None

    @classmethod
    def of(cls, recording: Recording) -> Caption:
        """Returns the line that a recording has by itself."""
        try:
            task, genome, seed = recorded_episode(recording)
        except (ProofError, DocumentError):  # it is no episode, or one that somebody has edited
            return cls(visible(recording.path.stem))
        title = visible(f"{genome.name} on {task.name}, seed {seed}")
        try:
            return cls(title, scores_so_far(recording))
        except (ProofError, RecordingError) as error:  # a film proves nothing, but it must not tell what is not so
            return cls(f"{title} (no score: {error.code.replace('_', ' ')})")

    def draw(self, pixels: Pixels, time: float) -> Pixels:
        """Returns a picture, array (height, width, 3) of bytes, with the line over it.

        Args:
            pixels: The picture.
            time: Its moment, s since the recording began.
        """
        height, width = max(_LEAST, pixels.shape[0] // _PART), pixels.shape[1]
        if not self.title or width < _NARROW or height > pixels.shape[0]:
            return pixels
        shade = (1.0 - _SHADE) * pixels[:height] + _SHADE * np.array(_PAPER)
        line = Image.fromarray(shade.astype(np.uint8))
        pen, font, gap = ImageDraw.Draw(line), ImageFont.load_default(round(_LETTERS * height)), height // 2
        score = self._score(time)
        told = f"{time:.2f} s" + ("" if score is None else f"   score {number(score)}")
        free = width - 3 * gap - pen.textlength(told, font)
        title = self.title
        while title and pen.textlength(title, font) > free:
            title = title.removesuffix("…")[:-1].rstrip() + "…" if len(title) > 2 else ""
        pen.text((gap, height / 2), title, _INK, font, anchor="lm")
        pen.text((width - gap, height / 2), told, _INK, font, anchor="rm")
        return np.concatenate([np.asarray(line), pixels[height:]])

    def _score(self, time: float) -> float | None:
        """Returns the score at a time; None where there is none."""
        if self.scores is None:
            return None
        row = int(np.searchsorted(self.scores[:, 0], time + _ROUNDING)) - 1
        return None if row < 0 or np.isnan(self.scores[row, 1]) else float(self.scores[row, 1])
