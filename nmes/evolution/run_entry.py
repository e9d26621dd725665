"""An entry of a run's log: a candidate, how its evaluation came out, and what the algorithm was told of it.

Hides how that is written as JSON (`schemas/run_record.json`), and read again from a log of whomever.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import Final

import orjson

from nmes.errors import DocumentError
from nmes.evaluation.evaluation import Evaluation
from nmes.evaluation.judge import Result
from nmes.evaluation.match_task import MatchTask
from nmes.evaluation.setting import Setting
from nmes.evolution.algorithm import Candidate, Score
from nmes.evolution.quantities import evaluate_quantities
from nmes.evolution.run_index import Record
from nmes.evolution.run_log import Line
from nmes.evolution.run_settings import RunSettings
from nmes.genome import Genome
from nmes.objective import Objective
from nmes.schemas.documents import JsonObject, check, compile_schema, complete, write_json

__all__ = ["Entry", "told"]

_RECORD: Final = compile_schema("run_record.json")


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry.

    Attributes:
        content: The document. The genome of an entry that is to be written is in it as a fragment of JSON: thousands
            of documents would keep the garbage collector at work.
        name: The genome's name.
        plan: A digest of its body without the numbers.
    """

    content: JsonObject
    name: str
    plan: str

    @classmethod
    def parse(cls, text: bytes, index: int, settings: RunSettings) -> Entry:
        """Reads an entry.

        Raises:
            DocumentError: It is none, or not that of the candidate of this index in a run of these settings.
        """
        try:
            content = orjson.loads(text)
        except orjson.JSONDecodeError as error:
            raise DocumentError([("", f"not strict JSON: {error}")]) from error
        check(_RECORD, content)
        content = complete(_RECORD.schema, content)
        if content["index"] != index:
            raise DocumentError([("index", f"must be {index}, not {content['index']}")])
        if not all(parent < index for parent in content["parents"]):
            raise DocumentError([("parents", f"must be candidates before {index}")])
        for name, expected in (("objectives", len(settings.objectives)), ("measures", len(settings.measures))):
            if len(content[name]) != (0 if content["score"] is None else expected):
                raise DocumentError([(name, "must be one for each of the run, and none where there is no score")])
        if not settings.in_turn(index, content["group"]):
            raise DocumentError([("group", f"is not the population whose turn it is: {content['group']!r}")])
        _check_opponents(content.get("opponents"), settings.task)
        return cls(content, content["genome"]["name"], _plan(content["genome"]["body"]))

    @property
    def genome(self) -> Genome:
        """The genome.

        Raises:
            DocumentError: It is no good one.
        """
        return Genome(self.content["genome"])

    @property
    def candidate(self) -> Candidate:
        """What the algorithm asked for.

        Raises:
            DocumentError: Its genome is no good one.
        """
        content = self.content
        parents = tuple(content["parents"])
        return Candidate(self.genome, content["operator"], parents, content["generation"], content["group"])

    @property
    def opponents(self) -> tuple[tuple[int, ...], ...]:
        """Whom it met in matches: the indices of each lineup; none in a run without populations."""
        return tuple(map(tuple, self.content.get("opponents", ())))

    @property
    def score(self) -> Score:
        """What the algorithm was told."""
        content = self.content
        return Score(content["score"], tuple(content["objectives"]), tuple(content["measures"]))

    def evaluation(self, task: Setting) -> Evaluation:
        """Returns the candidate's evaluation on the run's task."""
        content = self.content
        results = tuple(Result(**result) for result in content["results"])
        names = content["genome"]["name"], content["genome_hash"], task.name, task.hash
        return Evaluation(*names, results, content["error"])

    def record(self, line: Line) -> Record:
        """Returns the record of the entry in a line, for the index."""
        content = self.content
        faults = (result["fault"] for result in content["results"] if result["fault"] is not None)
        error = content["error"] or next(faults, None)
        if error is None and content["score"] is None:
            error = "an objective or a measure has no finite value"
        return Record(
            index=content["index"],
            begin=line.begin,
            end=line.end,
            digest=line.digest,
            score=content["score"],
            operator=content["operator"],
            parents=tuple(content["parents"]),
            generation=content["generation"],
            group=content["group"],
            objectives=tuple(content["objectives"]),
            measures=tuple(content["measures"]),
            genome=self.name,
            genome_hash=content["genome_hash"],
            plan=self.plan,
            error=error,
        )


def told(
    index: int,
    candidate: Candidate,
    evaluation: Evaluation,
    settings: RunSettings,
    expressions: Sequence[Objective],
) -> Entry:
    """Returns the entry of a candidate that was evaluated.

    Args:
        index: The candidate's.
        candidate: What the algorithm asked for.
        evaluation: How it came out.
        settings: The run's.
        expressions: Its objectives, then its measures.
    """
    values = evaluate_quantities(expressions, candidate.genome, evaluation, settings.task)
    opponents = [[each.index for each in lineup] for lineup in candidate.lineups]
    known, split = () if values is None else values, len(settings.objectives)
    document = candidate.genome.document
    content = {
        "index": index,
        "operator": candidate.operator,
        "parents": list(candidate.parents),
        "generation": candidate.generation,
        "group": candidate.group,
        "genome": orjson.Fragment(write_json(document)),
        "genome_hash": evaluation.genome_hash or candidate.genome.hash,
        "results": [result.to_json() for result in evaluation.results],
        "error": evaluation.error,
        **({"opponents": opponents} if opponents else {}),
        "score": None if values is None else evaluation.score,
        "objectives": list(known[:split]),
        "measures": list(known[split:]),
    }
    return Entry(content, document["name"], _plan(document["body"]))


def _check_opponents(opponents: list[list[int]] | None, task: Setting) -> None:
    """Returns if an entry tells of opponents as it must: where the task has roles, one for each other role.

    Raises:
        DocumentError: It does not.
    """
    others = len(task.roles) - 1 if isinstance(task, MatchTask) else 0
    if opponents is None and others:
        raise DocumentError([("opponents", "is missing: the task has roles")])
    if opponents is not None and any(len(lineup) != others for lineup in opponents):
        raise DocumentError([("opponents", f"must be {others or 'none'} in each match")])


def _plan(body: JsonObject) -> str:
    """Returns a digest of the parts of a body and of what joins which, without the numbers; of no body, of nothing."""
    try:
        if "graph" in body:
            parts, joints, names = body["graph"]["parts"], body["graph"].get("connections", ()), ("from", "to", "face")
        else:
            parts, joints, names = body["cubes"], body.get("joints", ()), ("cube1", "cube2", "type")
        plan = [[part["id"] for part in parts], [[joint.get(name) for name in names] for joint in joints]]
    except (KeyError, TypeError, AttributeError):
        plan = []  # a line of somebody else's; that its genome is none comes out where it is needed
    return blake2b(orjson.dumps(plan), digest_size=8).hexdigest()
