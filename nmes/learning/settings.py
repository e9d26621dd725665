"""What a run of learning is about, as a document: read, completed, judged as a whole, and kept as `run.json`.

Invariants: settings that were read can be run; two runs whose settings are equal have one history.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from hashlib import blake2b, sha256
from typing import Any, Final

import numpy as np
import orjson

from nmes.backend import Array, load_backend
from nmes.backend.fingerprint import fingerprint
from nmes.errors import DocumentError, NmesError
from nmes.evaluation import Task
from nmes.evaluation.progress import read_reward
from nmes.evolution.algorithms.bounds import read_options
from nmes.evolution.run_folder import require_documents
from nmes.genome import Genome
from nmes.learning.episodes import read_episodes
from nmes.learning.learners.cloning import Cloning
from nmes.learning.learners.networks import Network, read_layers
from nmes.learning.learners.ppo import Ppo
from nmes.learning.learners.reinforce import Reinforce
from nmes.schemas.documents import JsonObject, check, compile_schema, complete, did_you_mean, plain
from nmes.variation.draw import Draw

__all__ = ["ALGORITHMS", "FORMAT", "LearningSettings", "Lessons", "read_lessons"]

FORMAT: Final = "nmes-learning/1"
_LEARNING: Final = compile_schema("learning.json")
ALGORITHMS: Final[Mapping[str, type[Ppo] | type[Reinforce] | type[Cloning]]] = {
    "ppo": Ppo,
    "reinforce": Reinforce,
    "clone": Cloning,
}
"""The algorithms by name."""


@dataclass(frozen=True, eq=False, slots=True)
class Lessons:
    """What is learned from recordings.

    Attributes:
        genome: The creature.
        task: What it was asked to do.
        observations: Array (n, sensors): of all episodes, one after the other.
        actions: Array (n, motors): what was done then.
        digest: Of both, 32 hexadecimal digits.
    """

    genome: Genome
    task: Task
    observations: Array
    actions: Array
    digest: str


def read_lessons(recordings: tuple[str, ...]) -> Lessons:
    """Reads recordings of episodes, which are run again for it.

    Raises:
        RecordingError, ProofError, DocumentError: As `nmes.learning.read_episodes`: one of them cannot be read or does
            not come out as recorded, or they do not go together.
    """
    episodes = list(read_episodes(recordings))
    first = episodes[0]
    observations = np.concatenate([episode.observations[:-1] for episode in episodes])
    actions = np.concatenate([episode.actions for episode in episodes])
    digest = blake2b(digest_size=16)
    for array in (observations, actions):
        digest.update(np.ascontiguousarray(array).tobytes())
    return Lessons(first.genome, first.task, observations, actions, digest.hexdigest())


@dataclass(frozen=True, slots=True)
class LearningSettings:
    """What a run of learning is about.

    Attributes:
        algorithm: Its name.
        options: All of its options.
        genome: The creature, whose brain is to be another.
        task: What it learns.
        steps: How many steps are learned from in all.
        seed: Of everything that the run draws.
        every: In which legs the brain is scored: every so many, and the last.
        reward: The reward of a tick as an expression; None: by how much the task's objective grew.
        recordings: What `clone` learns from; else none.
        episodes: The digest of what is in them; empty where there are none.
    """

    algorithm: str
    options: Mapping[str, int | float | bool]
    genome: Genome
    task: Task
    steps: int
    seed: int
    every: int
    reward: str | None
    recordings: tuple[str, ...]
    episodes: str

    @classmethod
    def read(cls, document: Mapping[str, Any]) -> LearningSettings:
        """Reads a document as `schemas/learning.json` says; names and files of task and genome are looked up.

        Raises:
            DocumentError: It is not such a document, or what it says cannot be run, with all that is wrong.
        """
        settings = cls._of(document)
        if problems := list(settings._problems()):
            raise DocumentError(problems)
        return replace(settings, options=asdict(settings.algorithm_options()))

    @classmethod
    def reopen(cls, document: Mapping[str, Any]) -> LearningSettings:
        """Reads the document of a run that is there, whether or not it could be run here.

        Raises:
            DocumentError: It is no such document, or of an algorithm that there is not.
        """
        given = plain(document)
        check(_LEARNING, given)
        require_documents(given)
        settings = cls._of(given)
        if problems := list(settings._unknown()):
            raise DocumentError(problems)
        return settings

    @classmethod
    def _of(cls, document: Mapping[str, Any]) -> LearningSettings:
        """Reads a document whose task and genomes may be names or files."""
        given = plain(document)
        check(_LEARNING, given)
        full = complete(_LEARNING.schema, given)
        return cls(
            algorithm=full["algorithm"],
            options=full["options"],
            genome=_placed("genome", Genome, full["genome"]),
            task=_placed("task", Task, full["task"]),
            steps=full["steps"],
            seed=full["seed"],
            every=full["every"],
            reward=full.get("reward"),
            recordings=tuple(full.get("recordings", ())),
            episodes=full.get("episodes", ""),
        )

    def _unknown(self) -> Iterator[tuple[str, str]]:
        """Yields why it says of no algorithm what that learns from."""
        if self.algorithm not in ALGORITHMS:
            hint = did_you_mean(self.algorithm, ALGORITHMS) or f": there are {', '.join(ALGORITHMS)}"
            yield "algorithm", f"there is no algorithm {self.algorithm!r}{hint}"
        elif (self.algorithm == "clone") != bool(self.recordings):
            yield "recordings", "'clone' learns from recordings, and it alone"

    def _problems(self) -> Iterator[tuple[str, str]]:
        """Yields why it cannot be run."""
        yield from self._unknown()
        if self.algorithm == "clone" and self.reward is not None:
            yield "reward", "'clone' is not rewarded: it does what the recordings show"
        if self.reward is not None:
            try:
                read_reward(self.reward, self.genome, self.task)
            except NmesError as error:
                yield "reward", error.message.removeprefix("reward: ")
        for what, parts in (("sensors", self.genome.body.sensors), ("motors", self.genome.body.motors)):
            if not parts:
                yield "genome", f"{self.genome.name!r} has no {what}: there is nothing to learn"
        brain = self.genome.document.get("brain")
        if brain is not None and brain.get("kind") == "mlp" and self.algorithm != "clone":
            yield from self._unsound_start()
        for reason in self.task.check_driven(self.genome.body):
            yield "genome", f"{self.genome.name!r} may not take part: {reason}"

    def _unsound_start(self) -> Iterator[tuple[str, str]]:
        """Yields why an `mlp` cannot be gone on with, if it cannot."""
        try:
            self.genome.brain()
        except DocumentError as error:
            yield from ((f"genome/{path}", words) for path, words in error.problems)
            return
        if self.start() is None:
            words = "learning goes on only from layers of tanh and a last one of identity, over all sensors and motors"
            yield "genome/brain", f"{words}; without a brain it begins anew"

    def start(self) -> tuple[Network, Array] | None:
        """Returns the network and its parameters that learning goes on from, where the creature has such a brain."""
        document = self.genome.document.get("brain")
        return None if document is None else read_layers(document, len(self.genome.body.sensors))

    @property
    def document(self) -> JsonObject:
        """The document, everything filled in: a new copy, plain JSON data."""
        document: JsonObject = {
            "format": FORMAT,
            "algorithm": self.algorithm,
            "options": dict(self.options),
            "genome": self.genome.document,
            "task": self.task.document,
            "steps": self.steps,
            "seed": self.seed,
            "every": self.every,
        }
        if self.reward is not None:
            document["reward"] = self.reward
        if self.recordings:
            document |= {"recordings": list(self.recordings), "episodes": self.episodes}
        return document

    def algorithm_options(self) -> Any:
        """Returns the options as the algorithm takes them.

        Raises:
            DocumentError: There is no such option, or it is not what it must be.
        """
        return read_options(self.algorithm, ALGORITHMS[self.algorithm].Options, self.options)

    def draw(self, *path: str | int) -> Draw:
        """Returns the stream of choices for a purpose, such as `"leg", 12`."""
        return Draw(self.seed, "learning", *path)

    def fingerprint(self) -> dict[str, str]:
        """Returns the fingerprint of what would compute the run here: of the engine, and of what learners compute."""
        return {**fingerprint(load_backend(self.task.world_config(0)["backend"])), "learner": _probe()}


def _placed(place: str, kind: Any, value: str | JsonObject) -> Any:
    """Reads a genome or a task by its name or file, or as a document; problems are told with their place."""
    try:
        return kind.load(value) if isinstance(value, str) else kind(value)
    except DocumentError as error:
        raise DocumentError((f"{place}/{path}" if path else place, words) for path, words in error.problems) from error


def _probe() -> str:
    """Returns a digest of what a network computes and how it learns here."""
    draw = Draw(0, "fingerprint")
    network = Network((7, 64, 5))
    parameters = network.initial(draw, 1.0)
    forward = network.forward(parameters, draw.normals(7 * 33).reshape(33, 7))
    slopes = network.backward(parameters, forward, forward.outputs - draw.normals(5 * 33).reshape(33, 5))
    drawn = [draw.uniform(-1.0, 1.0), draw.count(0, 1 << 40), *draw.order(9).tolist()]
    return sha256(forward.outputs.tobytes() + slopes.tobytes() + orjson.dumps(drawn)).hexdigest()
