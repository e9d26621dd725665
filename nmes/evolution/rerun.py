"""A candidate of a run evaluated again, with recordings that prove what the log says of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from nmes.errors import RunError
from nmes.evaluation import Evaluation, evaluate
from nmes.evolution.run import Run
from nmes.recording.signing import SUFFIX

__all__ = ["record_candidate"]


def record_candidate(run: Run, index: int, folder: Path, seeds: Sequence[int]) -> Evaluation:
    """Evaluates a candidate again, and leaves a recording of each episode in a folder.

    Nothing is left unless every figure is that of the log.

    Args:
        run: The run.
        index: The candidate's, which has a score.
        folder: An existing folder.
        seeds: Of the episodes; those that the run did not have are compared with nothing.

    Raises:
        RunError: It comes out otherwise than the log says (`diverged`, or `not_comparable` where the run was begun on
            a machine or by versions that compute otherwise), or the log is damaged (`log_damaged`).
        RecordingError: A recording cannot be written.
    """
    with TemporaryDirectory(dir=folder, prefix=".") as unfinished:
        found = evaluate(run.genome(index), run.settings.task, seeds=seeds, record=unfinished)
        logged = run.evaluation(index)
        if logged.score != run.records[index].score or {each.seed for each in logged.results} != set(
            run.settings.seeds
        ):
            raise _otherwise(run, index, "its score there is not the mean over the seeds")
        known = {result.seed: result for result in logged.results}
        if found.error is not None:
            raise _otherwise(run, index, found.error)
        for again in found.results:
            if again != known.get(again.seed, again):
                raise _otherwise(run, index, f"{again}, and not {known[again.seed]}")
        recordings = [folder / Path(path).name for path in found.recordings]
        for path, target in zip(found.recordings, recordings, strict=True):
            target.with_name(target.name + SUFFIX).unlink(missing_ok=True)  # it is of the recording before
            Path(path).replace(target)
    names = found.genome, found.genome_hash, found.task, found.task_hash
    return Evaluation(*names, found.results, None, tuple(map(str, recordings)), found.wall_seconds)


def _otherwise(run: Run, index: int, what: str) -> RunError:
    """Returns the error of a candidate that does not come out as the log says."""
    code = "not_comparable" if run.differences() else "diverged"
    where = ", and the run was begun where other numbers come out" if code == "not_comparable" else ""
    return RunError(code, f"candidate {index} of {run.folder} does not come out as its log says{where} ({what})")
