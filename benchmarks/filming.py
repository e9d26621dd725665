"""What a film costs: ten seconds of a creature that walks, drawn in software at 640x480, beside the drawing alone."""

from __future__ import annotations

import time
from collections.abc import Iterator
from math import radians
from pathlib import Path
from tempfile import TemporaryDirectory

from measure import Figure
from nmes import Genome, Task, evaluate
from nmes.backend import CameraSpec
from nmes.errors import WorldError
from nmes.recording import Recording
from nmes.view.film import Cut, film
from nmes.view.moments import moments
from nmes.view.stage import Stage

SECONDS, FPS, SIZE = 10.0, 30, (640, 480)


def figures() -> Iterator[Figure]:
    """Films an episode once, and draws as many of its moments without camera, encoding and replay."""
    with TemporaryDirectory() as folder:
        evaluate(Genome.load("walker"), Task.load("walk"), seeds=[1], record=Path(folder))
        recording = Recording(next(Path(folder).glob("*.mcap")))
        began = time.perf_counter()
        try:
            film([recording], Path(folder) / "walk.mp4", Cut(end=SECONDS), fps=FPS, size=SIZE)
        except WorldError as error:
            print(f"filming: skipped: {error.message}")
            return
        seconds = time.perf_counter() - began
        bare = drawing(recording)
    count = int(SECONDS * FPS) + 1
    yield Figure("film of 10 s at 640x480, to draw and encode", seconds, "s", at_most=60.0, details={"pictures": count})
    yield Figure("the same beside the drawing alone", seconds / bare, "times", details={"drawing s": bare})


def drawing(recording: Recording) -> float:
    """Draws one moment as often as the film has pictures; returns the seconds that took."""
    stage = Stage(recording.config)
    stage.show(next(moments(recording)))
    camera = CameraSpec(*SIZE, radians(40.0), (0.0, 1.0, 4.0), (0.0, 0.0, 0.0, 1.0), shadows=True)
    stage.draw(camera)
    began = time.perf_counter()
    for _ in range(int(SECONDS * FPS) + 1):
        stage.draw(camera)
    seconds = time.perf_counter() - began
    stage.close()
    return seconds
