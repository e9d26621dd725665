"""Tasks, and creatures evaluated on them: episodes, scores, proofs, leaderboards."""

from __future__ import annotations

from nmes.evaluation.environments import Environments
from nmes.evaluation.episode import Episode, brain_of
from nmes.evaluation.evaluation import Evaluation
from nmes.evaluation.evaluator import Evaluator, Job, evaluate
from nmes.evaluation.judge import Result
from nmes.evaluation.match import Match, MatchResult, play
from nmes.evaluation.match_proof import MatchProof, prove_match
from nmes.evaluation.match_task import MatchTask
from nmes.evaluation.parallel import Workers
from nmes.evaluation.proof import Course, Proof, prove, retrace, scores_so_far
from nmes.evaluation.task import Task
from nmes.genome.limits import Limits

__all__ = [
    "Course",
    "Environments",
    "Episode",
    "Evaluation",
    "Evaluator",
    "Job",
    "Limits",
    "Match",
    "MatchProof",
    "MatchResult",
    "MatchTask",
    "Proof",
    "Result",
    "Task",
    "Workers",
    "brain_of",
    "evaluate",
    "play",
    "prove",
    "prove_match",
    "retrace",
    "scores_so_far",
]
