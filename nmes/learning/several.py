"""Several creatures in one world, in PettingZoo's terms: each has its own start, and is judged by the task on its own.

    env = parallel_env("walk", {"a": "walker", "b": "roller"})
    observations, infos = env.reset(seed=1)
    while env.agents:
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        observations, rewards, terminations, truncations, infos = env.step(actions)

Hides how creatures find places where they do not overlap, when a body is taken away, and how an episode is recorded.

Invariants: what an agent is given and how it ends follow from its own body, as in an episode of its own; a creature
that is alone has the bits of a row of `Environments`. The same genomes, seed and actions give the same bits.
"""

from __future__ import annotations

import math
import os
import secrets
from collections.abc import Iterator, Mapping, Sequence
from hashlib import blake2b
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

import gymnasium
import numpy as np
import orjson
from gymnasium import spaces as gym_spaces
from pettingzoo import ParallelEnv

from nmes import protocol
from nmes.backend import Array
from nmes.backend.arrays import floats
from nmes.backend.rotation import total
from nmes.errors import RecordingError, WorldError
from nmes.evaluation.episode import Entrant, set_scene
from nmes.evaluation.judge import Observer, Result
from nmes.evaluation.progress import Progress
from nmes.evaluation.seeding import RowSeeds, read_seeds
from nmes.evaluation.steps import perform
from nmes.evaluation.task import Place, Task, TaskLike
from nmes.genome import Genome
from nmes.genome.body import Body, corners
from nmes.genome.genome import GenomeLike
from nmes.learning import spaces
from nmes.learning.cores import folder_of, told
from nmes.recording import Recorder
from nmes.recording.signed import require_unsigned
from nmes.world import World

__all__ = ["METADATA", "CreaturesEnv", "parallel_env"]

METADATA: Final = "nmes.learning"
"""The metadata record of an episode of several: its `task`, its `seed`, and `creatures`, the hash of each's genome."""

_GOING = np.ones(1, np.bool_)
_GAP = 1.0  # m between bodies that are set down beside each other
_POSE_RATE = 1.0  # Hz; pictures for viewers, which follow from the rest


def parallel_env(
    task: TaskLike,
    genomes: Mapping[str, GenomeLike],
    *,
    seeds: Sequence[int] | None = None,
    record: str | os.PathLike[str] | None = None,
) -> CreaturesEnv:
    """Makes an environment of several creatures in one world.

    Args:
        task: What each of them is asked to do: the name of a task that ships, a file, a document, or a `Task`.
        genomes: The creatures, likewise, by the names of their agents.
        seeds: Of the scenes that episodes take; the task's if left out.
        record: A folder in which every episode is recorded, the same one in the same file; None: none is.

    Raises:
        ValueError: There are no genomes, or no seeds.
        TypeError: A seed is no whole number.
        DocumentError: A genome or the task cannot be read.
        WorldError: A creature may not take part, or has no motors or no sensors.
        RecordingError: The folder cannot be made.
    """
    read = {name: Genome.load(genome) for name, genome in genomes.items()}
    return CreaturesEnv(Task.load(task), read, seeds=seeds, record=record)


class CreaturesEnv(ParallelEnv[str, Array, Array]):  # type: ignore[misc]
    """Creatures that are asked to do the same task, side by side in one world, where they may meet.

    An agent's observations are what its genome's sensors read; its actions, from -1 to 1, are the controls of its
    motors. A reward is by how much the task's objective for its own body grew in a tick. An agent is terminated by the
    task's ends and limits on its own body, and truncated with the task's time; then its body, and what the task gave it
    to carry, is taken out of the world, and the others go on.

    Attributes:
        agents: Those that are there now.
        possible_agents: All of them.
        task: What each is asked to do.
        genomes: The creatures by the names of their agents.
        recording: The recording of the last episode that was over; None where none was, or nothing is recorded.
    """

    metadata: dict[str, Any]
    render_mode: ClassVar[None] = None

    def __init__(
        self,
        task: Task,
        genomes: Mapping[str, Genome],
        *,
        seeds: Sequence[int] | None = None,
        record: str | os.PathLike[str] | None = None,
    ) -> None:
        """Checks who may take part; see `parallel_env`."""
        seeds = task.seeds if seeds is None else read_seeds(seeds)
        if not genomes or not seeds:
            raise ValueError(f"there must be 1 genome and 1 seed or more, not {len(genomes)} and {len(seeds)}")
        reasons = [f"{name}: {reason}" for name, genome in genomes.items() for reason in task.check_driven(genome.body)]
        if reasons:
            raise WorldError("invalid", "; ".join(reasons))
        self.metadata = {"name": f"nmes/{task.name}", "render_modes": [], "is_parallelizable": True}
        self.task, self.genomes = task, dict(genomes)
        self.agents: list[str] = []
        self.possible_agents = list(genomes)
        self.recording: Path | None = None
        self._spaces = {name: spaces.of(genome) for name, genome in genomes.items()}
        self._seeds, self._record = seeds, None if record is None else folder_of(record)
        self._draws = RowSeeds(1)
        self._episode: _Episode | None = None

    def observation_space(self, agent: str) -> gym_spaces.Box:
        """Returns the space of an agent's observations, always the same object."""
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> gym_spaces.Box:
        """Returns the space of an agent's actions, always the same object."""
        return self._spaces[agent][1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, dict[str, Any]]]:
        """Begins an episode.

        Args:
            seed: From which this and the following episodes draw their scenes; left out, it is the next of these.
            options: With `agents`, a list of names, only these take part. What else is in it is for others.

        Returns:
            Of each agent, what it senses, and an info with the `seed` of its scene.

        Raises:
            ValueError: `agents` names somebody else, or nobody; or the seed is below 0.
            WorldError: The creatures cannot begin.
            RecordingError: The recording cannot be written.
        """
        names = self._chosen((options or {}).get("agents", self.possible_agents))
        if seed is None and not self._draws.complete:
            seed = secrets.randbits(63)
        self._draws.take(seed, [0])
        self.close()
        scene = self._draws.draw(0, self._seeds)
        self._draws.count(0)
        self._episode = _Episode(self.task, {name: self.genomes[name] for name in names}, scene, self._record)
        self.agents = names
        return self._episode.senses(names), {name: {"seed": scene} for name in names}

    def _chosen(self, names: Sequence[str]) -> list[str]:
        unknown = [name for name in names if name not in self.genomes]
        if unknown or not names:
            known = ", ".join(self.possible_agents)
            raise ValueError(f"agents: expected one or more of {known}, got {', '.join(map(str, names)) or 'none'}")
        return [name for name in self.possible_agents if name in names]

    def step(
        self, actions: Mapping[str, Array]
    ) -> tuple[dict[str, Array], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Goes one tick on.

        Args:
            actions: Of each agent that is there, one number a motor, from -1 to 1.

        Returns:
            Observations, rewards, terminations, truncations and infos of those that were there before. Where one's
            episode is over its info has the `result`, and that of the last the `recording`, if there is one.

        Raises:
            gymnasium.error.ResetNeeded: No episode has begun, or it is over.
            ValueError: Actions of the wrong agents, of a wrong shape, or beyond -1 and 1; nothing has moved.
            RecordingError: The recording cannot be written.
        """
        episode, names = self._episode, self.agents
        if episode is None or not names:
            raise gymnasium.error.ResetNeeded("no episode has begun, or it is over: reset comes first")
        if set(actions) != set(names):
            raise ValueError(f"actions must be those of {', '.join(names)}, not of {', '.join(actions) or 'nobody'}")
        episode.move({name: self._checked(name, actions[name]) for name in names})
        standings = {name: episode.judge(name) for name in names}
        observations = episode.senses(names)
        infos: dict[str, dict[str, Any]] = {name: {} for name in names}
        for name, standing in standings.items():
            if standing.result is not None:
                infos[name]["result"] = told(standing.result)
        self.agents = [name for name in names if standings[name].result is None]
        if self.agents:
            episode.remove([name for name in names if name not in self.agents])
        else:
            self.close()
            if self.recording is not None:
                infos[names[-1]]["recording"] = str(self.recording)
        return (
            observations,
            {name: standing.reward for name, standing in standings.items()},
            {name: standing.terminated for name, standing in standings.items()},
            {name: standing.truncated for name, standing in standings.items()},
            infos,
        )

    def _checked(self, name: str, action: Array) -> Array:
        """Returns the controls that an action is; raises ValueError where it is none."""
        controls = floats(action, "actions")
        motors = self.genomes[name].body.outputs
        if controls.shape != (len(motors),):
            raise ValueError(f"{name}: an action has the shape {(len(motors),)}, one a motor, not {controls.shape}")
        for motor, control in zip(motors, controls.tolist(), strict=True):
            if not -1.0 <= control <= 1.0:
                raise ValueError(f"{name}: actions are from -1 to 1; that for {motor!r} is {control}")
        return controls

    def state(self) -> Array:
        """Returns the states of all cubes of all possible agents, array (n, 13), float64; of those not there, zeros.

        A cube's state is its position (m), its quaternion, its linear (m/s) and its angular velocity (rad/s).
        """
        present = {} if self._episode is None else self._episode.states(self.agents)
        missing = {name: np.zeros((len(genome.body.cubes), 13)) for name, genome in self.genomes.items()}
        return np.concatenate([present.get(name, missing[name]) for name in self.possible_agents])

    def close(self) -> None:
        """Ends the episode, if one goes on, and completes its recording.

        Raises:
            RecordingError: The recording cannot be written.
        """
        if self._episode is not None:
            episode, self._episode, self.agents = self._episode, None, []
            self.recording = episode.close()


class _Standing(NamedTuple):
    """What a tick gave an agent, and how it stands; the result where its episode is over."""

    reward: float
    terminated: bool
    truncated: bool
    result: Result | None


class _Agent:
    """One creature's part of an episode."""

    def __init__(self, observer: Observer, task: Task) -> None:
        self.observer, self._task = observer, task
        bodies = observer.judge.trajectory.bodies
        observer.note()
        states, watts, touches = observer.latest()
        self._progress = Progress(task, bodies, 1)
        self._progress.begin(0, states[0], touches[0], bodies.target)
        self._watts, self._ended = np.zeros_like(watts), observer.look()

    def tick(self, fault: str | None) -> _Standing:
        """Takes the tick that has just ended, or why the world could not make it."""
        observer, task, progress = self.observer, self._task, self._progress
        if fault is None:
            observer.note()
        states, watts, touches = observer.latest()
        self._watts += watts
        progress.take(states, self._watts / task.tick_rate, touches, _GOING)
        ticks, terminated = int(progress.ticks[0]), fault is not None or bool(progress.over[0])
        truncated = not terminated and ticks == task.ticks
        if terminated or truncated or ticks % task.tick_rate == 0:
            self._ended = observer.look()
        result = None
        if terminated or truncated:
            result = observer.judge.result(self._ended, fault)
            progress.settle(0, result.score, faulted=fault is not None)
        return _Standing(float(progress.rewards[0]), terminated, truncated, result)


class _Episode:
    """Creatures in a world of their own, from their start on.

    Raises:
        WorldError: They cannot begin.
        RecordingError: The recording cannot be written.
    """

    def __init__(self, task: Task, genomes: Mapping[str, Genome], seed: int, record: Path | None) -> None:
        self._task, self._seed = task, seed
        self._world = World(task.world_config(seed))
        self._recorder: Recorder | None = None
        self._agents: dict[str, _Agent] = {}
        self._done = blake2b(digest_size=8)  # who takes part, and what is done: the same episode has the same file
        for name, genome in genomes.items():
            self._done.update(f"{name}:{genome.hash}\n".encode())
        places = _places({name: genome.body for name, genome in genomes.items()}, flat=self._world.backend.dims == 2)
        self._entrants = {place.creature: Entrant(genomes[place.creature], place) for place in places}
        try:
            if record is not None:
                self._world.journal = self._recorder = self._recorder_in(record)
            self._client = self._world.join()
            self._begin()
        except BaseException:
            self._world.close()
            if self._recorder is not None:
                self._recorder.close()
                self._recorder.path.unlink(missing_ok=True)
            raise

    def _recorder_in(self, folder: Path) -> Recorder:
        creatures = {name: entrant.genome.hash for name, entrant in self._entrants.items()}
        about = {
            "task": protocol.encode(self._task.document).decode(),
            "seed": str(self._seed),
            "creatures": orjson.dumps(creatures).decode(),
        }
        part = folder / f"{secrets.token_hex(8)}.part"
        return Recorder(part, self._world, pose_rate=_POSE_RATE, about={METADATA: about})

    def _begin(self) -> None:
        world, task = self._world, self._task
        entrants = list(self._entrants.values())
        observers, restless = perform(world, self._client, set_scene(world, task, self._seed, entrants))
        if not observers:
            reasons = [f"{name}: {reason}" for name, reason in restless.items()] or [str(self._fault())]
            raise WorldError("invalid", f"the creatures cannot begin with seed {self._seed}: {'; '.join(reasons)}")
        self._agents = {observer.creature.name: _Agent(observer, task) for observer in observers}

    def _do(self, command: bytes) -> None:
        reply = protocol.decode(self._world.handle(self._client, protocol.parse(command)))
        if reply["type"] == "error":
            raise WorldError(reply["code"], reply["message"], reply.get("field"))

    def _fault(self) -> str | None:
        fault = self._world.fault
        if fault is not None and fault.code == "recording_failed":
            raise RecordingError(fault.code, fault.message)
        return None if fault is None else f"{fault.code}: {fault.message}"

    def move(self, controls: Mapping[str, Array]) -> None:
        """Drives creatures, and goes one tick on."""
        try:
            for name, values in controls.items():
                self._done.update(values.tobytes())
                self._world.drive(self._client, name, values)
        except WorldError:
            self._fault()  # what cannot be recorded is told as that
            raise
        self._world.tick()

    def judge(self, name: str) -> _Standing:
        """Judges the tick that has just ended for one creature."""
        return self._agents[name].tick(self._fault())

    def senses(self, names: Sequence[str]) -> dict[str, Array]:
        """Returns the readings of creatures' sensors, each an array (sensors,)."""
        return {name: self._agents[name].observer.creature.sense() for name in names}

    def states(self, names: Sequence[str]) -> dict[str, Array]:
        """Returns the states of the cubes of creatures, each an array (n, 13)."""
        states = self._world.simulation.states
        return {
            name: states(watched.bodies[: len(self._entrants[name].genome.body.cubes)])
            for name, watched in ((name, self._agents[name].observer.watched) for name in names)
        }

    def remove(self, names: Sequence[str]) -> None:
        """Takes creatures, and the props that the task gave them, out of the world."""
        for name in names:
            place, creature = self._entrants[name].place, self._agents[name].observer.creature
            for cube in [*creature.cubes.values(), *map(place.prop, self._task.prop_ids())]:
                self._do(protocol.encode({"type": "despawn_cube", "cube_name": cube, "list": False}))

    def close(self) -> Path | None:
        """Ends the world; returns its recording, if there is one, under its name for good."""
        self._world.close()
        if self._recorder is None:
            return None
        part = self._recorder.path
        try:
            self._recorder.close()
            self._fault()
            task = self._task
            path = part.with_name(f"{task.name}-{task.hash[:16]}-{self._seed}-{self._done.hexdigest()}.mcap")
            require_unsigned(path)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
        return path


def _places(bodies: Mapping[str, Body], *, flat: bool) -> Iterator[Place]:
    """Yields places in a row through the origin, in which bodies do not overlap however they are turned about y.

    The row is along z, since tasks run along x; in a planar world it is along x.
    """
    widths = {name: 2.0 * _radius(body) for name, body in bodies.items()}
    at = -(total(widths.values()) + _GAP * (len(widths) - 1)) / 2.0
    for name, width in widths.items():
        middle = at + width / 2.0
        yield Place(name, x=middle) if flat else Place(name, z=middle)
        at += width + _GAP


def _radius(body: Body) -> float:
    """Returns how far over the ground a body reaches from its place, m, however it is turned about its root."""
    root = body.cubes[0].position
    centre = [total(cube.mass * cube.position[axis] for cube in body.cubes) / body.mass for axis in (0, 2)]
    arm = max(math.hypot(x - root[0], z - root[2]) for cube in body.cubes for x, _, z in corners(cube).tolist())
    return math.ceil(100.0 * (arm + math.hypot(root[0] - centre[0], root[2] - centre[1]))) / 100.0
