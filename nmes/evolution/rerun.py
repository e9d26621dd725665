"""A candidate of a run evaluated again, with recordings that prove what the log says of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from nmes.errors import RunError
from nmes.evaluation import Evaluation, MatchTask, Task, evaluate
from nmes.evaluation.again import MODEL, has_model
from nmes.evaluation.contest import hold_contest
from nmes.evolution.run import Run
from nmes.recording.signed import require_unsigned

__all__ = ["record_candidate"]


def record_candidate(run: Run, index: int, folder: Path, seeds: Sequence[int]) -> Evaluation:
    """Evaluates a candidate again, and leaves a recording of each episode, or of each of its matches, in a folder.

    Nothing is left unless every figure is that of the log.

    Args:
        run: The run.
        index: The candidate's, which has a score.
        folder: An existing folder.
        seeds: Of the episodes; those that the run did not have are compared with nothing. Matches have the run's.

    Raises:
        RunError: It comes out otherwise than the log says (`diverged`, or `not_comparable` where the run was begun on
            a machine or by versions that compute otherwise, or has ONNX brains), or the log is damaged (`log_damaged`).
        RecordingError: A recording cannot be written, or would replace one that is signed (`signed`).
    """
    rivals = run.rivals(index)
    with TemporaryDirectory(dir=folder, prefix=".") as unfinished:
        genome, settings = run.genome(index), run.settings
        if rivals is not None and isinstance(settings.task, MatchTask):
            found = hold_contest(genome, rivals, settings.task, settings.seeds, Path(unfinished))
            _compare_matches(run, index, found)
        else:
            assert isinstance(settings.task, Task)
            found = evaluate(genome, settings.task, seeds=seeds, record=unfinished)
            _compare_episodes(run, index, found)
        recordings = [folder / Path(path).name for path in found.recordings]
        for target in recordings:
            require_unsigned(target)
        for path in dict.fromkeys(found.recordings):  # a match that was played twice has one recording
            Path(path).replace(folder / Path(path).name)
    names = found.genome, found.genome_hash, found.task, found.task_hash
    return Evaluation(*names, found.results, None, tuple(map(str, recordings)), found.wall_seconds)


def _compare_episodes(run: Run, index: int, found: Evaluation) -> None:
    """Returns if the episodes of a candidate come out as the log says.

    Raises:
        RunError: They do not (`diverged` or `not_comparable`).
    """
    logged = run.evaluation(index)
    if logged.score != run.records[index].score or {each.seed for each in logged.results} != set(run.settings.seeds):
        raise _otherwise(run, index, "its score there is not the mean over the seeds")
    known = {result.seed: result for result in logged.results}
    if found.error is not None:
        raise _otherwise(run, index, found.error)
    for again in found.results:
        if again != known.get(again.seed, again):
            raise _otherwise(run, index, f"{again}, and not {known[again.seed]}")


def _compare_matches(run: Run, index: int, found: Evaluation) -> None:
    """Returns if the matches of a candidate come out as the log says.

    Raises:
        RunError: They do not (`diverged` or `not_comparable`).
    """
    logged = run.evaluation(index)
    if logged.score != run.records[index].score or len(logged.results) != len(found.results):
        raise _otherwise(run, index, found.error or "its score there is not the mean over its matches")
    for again, known in zip(found.results, logged.results, strict=True):
        if again != known:
            raise _otherwise(run, index, f"{again}, and not {known}")


def _otherwise(run: Run, index: int, what: str) -> RunError:
    """Returns the error of a candidate that does not come out as the log says."""
    rivals = run.rivals(index)
    met = [] if rivals is None else [genome for lineup in rivals.lineups for genome in lineup]
    excuse = ""
    if run.differences():
        excuse = "; the run was begun where other numbers come out"
    elif has_model(genome.document for genome in (run.genome(index), *met)):
        excuse = f"; {MODEL}"
    code = "not_comparable" if excuse else "diverged"
    return RunError(code, f"candidate {index} of {run.folder} does not come out as its log says ({what}){excuse}")
