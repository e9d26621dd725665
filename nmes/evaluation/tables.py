"""What a recording holds as tables of rows, by name: the scores of an episode among them, which a task must judge."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from nmes.evaluation.proof import scores_so_far
from nmes.playback import states
from nmes.playback.export import TABLES, arrow_table, control_rows, joint_rows, messages, sensor_rows, state_rows
from nmes.recording import Recording

__all__ = ["arrow", "table_rows"]


def table_rows(recording: Recording, what: str, *, keep_going: bool = False) -> Iterable[Mapping[str, Any]]:
    """Returns the rows of a table, made one by one.

    Args:
        recording: The recording.
        what: Which of `nmes.playback.export.TABLES`.
        keep_going: Go on where a tick does not come out as it was recorded; scores never do.

    Raises:
        ValueError: There is no such table.
        RecordingError: A tick does not come out as recorded (`diverged`, or `not_comparable` where the fingerprints
            differ).
        ProofError, DocumentError: Of scores, where the recording is none of an episode.
    """
    if what not in TABLES:
        raise ValueError(f"the tables of a recording are {', '.join(TABLES)}; there is no {what!r}")
    if what == "messages":
        return messages(recording)
    if what == "scores":
        return _score_rows(recording)
    if what == "states":
        return state_rows(states(recording, keep_going=keep_going))
    rows = {"joints": joint_rows, "controls": control_rows, "sensors": sensor_rows}
    return rows[what](recording, keep_going=keep_going)


def _score_rows(recording: Recording) -> Iterator[Mapping[str, Any]]:
    """Yields a row for each tick of an episode: the score that it would have had, had it ended there."""
    for time, score in scores_so_far(recording).tolist():
        frame = round(time * recording.config["tick_rate"])
        yield {"frame": frame, "t": time, "score": None if score != score else score}


def arrow(recording: Recording, what: str, *, keep_going: bool = False) -> Any:
    """Returns a table as a `pyarrow.Table`; as `table_rows`.

    Raises:
        MissingPackage: pyarrow is not installed.
    """
    return arrow_table(table_rows(recording, what, keep_going=keep_going), what)
