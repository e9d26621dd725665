"""Environments over the wire: a creature in a world of a live host, ours or another's that speaks the protocol.

    env = Remote("127.0.0.1:14000", task="walk", genome="walker", password="...")
    envs = RemoteVector("127.0.0.1:14000", task="walk", genome="walker", count=8, password="...")

Hides which commands make an episode: a reset of the world with the scene's seed, the task's own commands, then for each
decision one batch that drives, steps, senses and reads the states, from which rewards and ends are computed here. The
worlds of several rows are asked at once, each over its own connection, since a connection is for one world.

Invariants: in a world of ours an episode has the observations, rewards and ends of `Environments` to the last bit,
where engine and config are the task's. What the protocol does not tell, the power of motors within a tick, is not
judged: no balance of energy is drawn.
"""

from __future__ import annotations

import os
import ssl
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from nmes import protocol
from nmes.backend import Array
from nmes.backend.arrays import ArrayLike
from nmes.client import Client
from nmes.client.address import read_address
from nmes.client.conversation import understood
from nmes.errors import CommandFailed, Disconnected, WorldError
from nmes.evaluation.environments import AUTORESET, Autoreset
from nmes.evaluation.judge import Result
from nmes.evaluation.progress import Progress, read_reward
from nmes.evaluation.seeding import RowSeeds, check_actions, read_seeds
from nmes.evaluation.steps import Rest
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.learning.wire import Moment, WireScene, require_world
from nmes.objective.trajectory import Flags
from nmes.schemas.documents import JsonObject

if TYPE_CHECKING:
    from nmes.client.declaration import Pending

__all__ = ["RemoteEnvironments"]

_STEPS: Final[int] = protocol.COMMANDS["step"].schema["properties"]["ticks"]["maximum"]
_TOGETHER: Final = 50  # ticks of settling that are asked for at once: their states are as many replies


class _Settled(NamedTuple):
    """How a scene was set when it was set first: after how many ticks, and by what commands, the episode began."""

    ticks: int
    start: list[JsonObject]


class RemoteWorld:
    """One world of a host, over a connection of its own, in which a creature has one episode after the other.

    Args:
        client: Not connected yet.
        task: What the creature is asked to do.
        scene: Its scenes.
    """

    def __init__(self, client: Client, task: Task, scene: WireScene) -> None:
        self._client, self._task, self._scene = client, task, scene
        self._settled: dict[int, _Settled] = {}  # by seed: what was seen once need not be looked for again
        self._mode: str | None = None  # that the world had before; None: not connected
        self._frame = 0

    def connect(self) -> None:
        """Connects, if it is not connected, and makes the world tick by steps alone; who fails to do so must `close`.

        Raises:
            Disconnected, TimeoutError: The host cannot be reached.
            CommandFailed: It lets nobody in, or has no such world.
            WorldError: The world cannot be one of the task: `unsupported`, `wrong_world`.
        """
        if self._mode is not None:
            return
        self._client.connect()
        with understood():
            info = self._client.get_world_info()
            require_world(info, self._task)
            self._client.set_mode("lockstep")
            self._mode = info["mode"]

    def close(self) -> None:
        """Disconnects; the world is left in the mode in which it was, if it can be reached."""
        mode, self._mode = self._mode, None
        if mode not in (None, "lockstep"):
            with suppress(CommandFailed, Disconnected, TimeoutError):
                self._client.request({"type": "set_mode", "mode": mode})
        self._client.close()

    def begin(self, seed: int) -> Moment:
        """Empties the world, sets the scene of a seed, and waits until the creature is at rest.

        Raises:
            Disconnected, TimeoutError: The host is gone.
            CommandFailed: It refuses the creature, or another command.
            WorldError: The creature does not come to rest; or `unsupported`.
        """
        with understood():
            return self._begin(seed)

    def _begin(self, seed: int) -> Moment:
        scene, settled = self._scene, self._settled.get(seed)
        if settled is None:
            self._scene.require_parts(self._ask(scene.set_down(seed))[1])
            settled = self._settled[seed] = self._settle(seed)
            commands = settled.start
        else:
            left = range(settled.ticks, 0, -_STEPS)
            steps = [{"type": "step", "ticks": min(_STEPS, ticks)} for ticks in left]
            commands = [*scene.set_down(seed), *steps, *settled.start]
        self._frame = settled.ticks
        return scene.moment(*self._ask([*commands, *scene.look])[-len(scene.look) :])

    def _settle(self, seed: int) -> _Settled:
        """Ticks until the creature is at rest."""
        task, scene, rest, ticks = self._task, self._scene, Rest(self._scene.body, self._task), 0
        tick = [{"type": "step"}, scene.look_at_body]
        while ticks < task.settle_ticks or not rest.reached:
            if ticks >= task.settle_limit_ticks:
                break
            count = min(max(1, task.settle_ticks - ticks), _TOGETHER)
            for told in self._ask(tick * count)[1::2]:
                rest.look(scene.states(told["cubes"]))
            ticks += count
        if (reason := rest.why_not(ticks)) is not None:
            raise WorldError("invalid", f"the creature cannot begin with seed {seed}: {reason}")
        return _Settled(ticks, scene.start(seed, rest.states[0]))

    def _ask(self, commands: Sequence[JsonObject]) -> list[Any]:
        """Sends commands in one write; returns their replies. The first that is refused is raised."""
        with self._client.pipeline() as together:
            calls = [together.request(command) for command in commands]
        return [call.result() for call in calls]

    def drive(self, controls: Sequence[float]) -> Pending[Any]:
        """Begins a tick: sends controls, without waiting.

        Raises:
            Disconnected: The host is gone.
        """
        return self._client.post(self._scene.tick(controls))

    def take(self, call: Pending[Any]) -> Moment | str:
        """Ends a tick: waits for what the world tells of it; or returns the fault that stopped the world.

        Raises:
            Disconnected, TimeoutError: The host is gone.
            CommandFailed: It refuses a command.
            WorldError: `disturbed`: somebody else steps or resets the world.
        """
        with understood():
            return self._take(call)

    def _take(self, call: Pending[Any]) -> Moment | str:
        replies = self._client.wait(call)["results"]
        stepped = replies[1]
        if stepped["type"] == "error" and stepped["code"] == "world_faulted":
            fault = self._client.get_world_info()["fault"] or stepped
            return f"{fault['code']}: {fault['message']}"
        self._frame += 1
        if stepped["type"] == "stepped" and stepped["frame"] != self._frame:
            world, frames = self._client.welcome["world"], f"frame {stepped['frame']} and not {self._frame}"
            raise WorldError("disturbed", f"somebody else steps or resets world {world!r}: it is at {frames}")
        for reply in replies:
            if reply["type"] == "error":
                raise CommandFailed(reply["code"], reply["message"], reply.get("field"))
        return self._scene.moment(*replies[2:])


class RemoteEnvironments:
    """Rows of a creature on a task, each in a world of its own of one host; used as `Environments` is.

    Attributes:
        genome: The creature.
        task: What it is asked to do.
        sensors: The ids of the sensors, the columns of observations.
        motors: The ids of the motors and voices, the columns of actions.
        observations: Array (count, sensors): what the sensors read.
        rewards: Array (count,), as those of `Environments`.
        terminated: Array (count,), whether the episode was ended by the task's ends and limits, or by a fault.
        truncated: Array (count,), whether the episode has lasted its time.
        last_observations: Array (count, sensors): where an episode is over, what was sensed at its end.
        results: Of each row, how the episode came out that was over last; None where none was yet.
    """

    def __init__(
        self,
        address: str,
        genome: Genome,
        task: Task,
        count: int = 1,
        *,
        password: str,
        worlds: Sequence[str] | None = None,
        tls: bool | ssl.SSLContext = False,
        timeout: float | None = 10.0,
        seeds: Sequence[int] | None = None,
        reward: str | None = None,
        autoreset: Autoreset = "same_step",
    ) -> None:
        """Connects, and looks whether the worlds can be those of the task.

        Args:
            address: `HOST:PORT` of the host, or `[HOST]:PORT` where the host is an IPv6 address.
            genome: The creature; its brain, if it has one, is not asked.
            task: What it is asked to do, and for how long.
            count: The number of rows.
            password: The host's.
            worlds: The names of the worlds, one a row, which are emptied; the first ones of the host if left out.
            tls: As for `nmes.Client`.
            timeout: How long a reply may take, s; None waits for ever.
            seeds: Of the scenes that episodes take; the task's if left out.
            reward: As for `Environments`.
            autoreset: As for `Environments`.

        Raises:
            ValueError: It is no address, there are no rows or no seeds, or not as many worlds as rows.
            TypeError: A seed is no whole number.
            Disconnected, TimeoutError: The host cannot be reached.
            CommandFailed: It lets nobody in, or has no such world.
            WorldError: The creature may not take part; the reward cannot be read; the host has too few worlds
                (`too_few_worlds`), or such as are not of the task (`wrong_world`, `unsupported`).
        """
        self.genome, self.task = genome, task
        self._scenes = task.seeds if seeds is None else read_seeds(seeds)
        if count < 1 or not self._scenes:
            raise ValueError(f"there must be 1 row and 1 seed or more, not {count} and {len(self._scenes)}")
        if autoreset not in AUTORESET:
            raise ValueError(f"autoreset is one of {', '.join(AUTORESET)}, not {autoreset!r}")
        reasons = task.check_driven(genome.body)
        if reasons:
            raise WorldError("invalid", "; ".join(reasons))
        body = genome.body
        self.sensors = tuple(sensor.id for sensor in body.sensors)
        self.motors = body.outputs
        paid = None if reward is None else read_reward(reward, genome, task)
        touchy = task.touchy or (paid is not None and any(quantity.name == "contacts" for quantity in paid.needs))
        scene = WireScene(genome, task, touchy=touchy)
        bodies = scene.bodies
        self._progress = Progress(task, bodies, count, paid)
        self._states = np.zeros((count, len(bodies.cubes), 13))
        self._touches: Flags = np.zeros((count, len(bodies.cubes) if touchy else 0, 2), np.bool_)
        self._work = np.zeros((count, 1))
        self._rows, self._seeds = [_Row() for _ in range(count)], RowSeeds(count)
        self._autoreset: Autoreset = autoreset
        self._all, self._waits = np.arange(count), np.ones(count, np.bool_)
        self.observations, self.last_observations = np.zeros((2, count, len(self.sensors)))
        self.rewards: Array = self._progress.rewards
        self.terminated: Flags = np.zeros(count, np.bool_)
        self.truncated: Flags = np.zeros(count, np.bool_)
        self.results: list[Result | None] = [None] * count
        host, port = _host_and_port(address)
        options: dict[str, Any] = {"password": password, "tls": tls, "timeout": timeout}
        names = _worlds(Client(host, port, **options), count, worlds)
        self._worlds = [RemoteWorld(Client(host, port, world=name, **options), task, scene) for name in names]
        self._connect()

    @property
    def seeds(self) -> list[int]:
        """Of each row, the seed of the scene that its episode has, or had."""
        return [row.scene for row in self._rows]

    def reset(self, seed: int | Sequence[int | None] | None = None, rows: Flags | None = None) -> Array:
        """Begins an episode in every row, or in some; connects anew where a connection was lost.

        Args:
            seed: As for `Environments`.
            rows: In which rows, array (count,); in all if left out.

        Returns:
            `observations`.

        Raises:
            ValueError: A row has never had a seed, or there are not as many seeds as rows, or one is below 0; nothing
                has begun.
            Disconnected, TimeoutError: The host is gone.
            CommandFailed: It refuses the creature.
            WorldError: The creature cannot begin.
        """
        places = self._all[slice(None) if rows is None else rows].tolist()
        self._seeds.take(seed, places)
        for place in places:
            self.results[place] = None
        self._begin(places)
        self.rewards[places], self.terminated[places], self.truncated[places] = 0.0, False, False
        return self.observations

    def step(self, actions: ArrayLike) -> tuple[Array, Array, Flags, Flags]:
        """Goes one tick on in every row; all worlds are asked before the first answer is waited for.

        Args:
            actions: Array (count, motors), each from -1 to 1.

        Returns:
            `observations`, `rewards`, `terminated` and `truncated`, which the next step overwrites.

        Raises:
            ValueError: The actions have another shape, or are beyond -1 or 1, or a row must be reset before; nothing
                has moved.
            Disconnected, TimeoutError: The host is gone; as with what follows, `reset` comes next, and connects anew.
            CommandFailed: It refuses a command.
            WorldError: `disturbed`: somebody else steps or resets a world.
        """
        actions = self._check(actions)
        progress, going = self._progress, ~self._waits
        begin = self._all[self._waits].tolist()
        faults = self._move(self._all[going].tolist(), actions)
        progress.take(self._states, self._work, self._touches, going)
        self.terminated[:] = progress.over
        self.terminated[list(faults)] = True
        np.equal(progress.ticks, self.task.ticks, out=self.truncated)
        self.truncated &= going & ~self.terminated
        over = np.flatnonzero(self.terminated | self.truncated).tolist()
        for place in over:
            self.results[place] = progress.result(place, self._rows[place].scene, faults.get(place))
        self.last_observations[over] = self.observations[over]
        self._waits[over] = True
        due = over if self._autoreset == "same_step" else begin
        if due:
            self._begin(due)
        return self.observations, self.rewards, self.terminated, self.truncated

    def record(self, row: int, path: str | os.PathLike[str]) -> None:
        """Refuses: what happens in a world is recorded by its host."""
        raise WorldError("unsupported", "the host records a remote episode, if it was started with --record; not this")

    def close(self) -> None:
        """Disconnects; the worlds are left in the modes in which they were."""
        self._abandon()
        self._seeds.forget()

    def _connect(self) -> None:
        try:
            for world in self._worlds:
                world.connect()
        except BaseException:
            self._abandon()
            raise

    def _check(self, actions: ArrayLike) -> Array:
        if not all(row.begun for row in self._rows):
            raise ValueError("no episodes have begun: reset comes first")
        if self._waits.any() and self._autoreset == "disabled":
            raise ValueError(f"the episode of row {int(self._waits.argmax())} is over: reset it first")
        return check_actions(actions, len(self._rows), self.motors)

    def _move(self, places: Sequence[int], actions: Array) -> dict[int, str]:
        """Goes one tick on in some rows, and reads them; returns of those that fault why."""
        worlds, faults = self._worlds, {}
        try:
            calls = [(place, worlds[place].drive(actions[place].tolist())) for place in places]
            for place, call in calls:
                moment = worlds[place].take(call)
                if isinstance(moment, str):
                    faults[place] = moment
                else:
                    self._read(place, moment)
        except BaseException:
            self._abandon()  # of some worlds answers are still to come
            raise
        return faults

    def _read(self, place: int, moment: Moment) -> None:
        self.observations[place], self._states[place] = moment.senses, moment.states
        self._touches[place], self._work[place] = moment.touches, moment.energy

    def _abandon(self) -> None:
        """Ends all episodes where they are, and hangs up."""
        for row, world in zip(self._rows, self._worlds, strict=True):
            row.begun = False
            world.close()

    def _begin(self, places: Sequence[int]) -> None:
        """Begins the next episode in some rows."""
        try:
            for place in places:
                row, world = self._rows[place], self._worlds[place]
                world.connect()
                row.scene = self._seeds.draw(place, self._scenes)
                moment = world.begin(row.scene)
                self._seeds.count(place)
                row.begun = True
                self._read(place, moment)
                self._progress.begin(place, moment.states, moment.touches, self.task.target(row.scene))
                self._waits[place] = False
        except BaseException:
            self._abandon()
            raise


class _Row:
    """One row: the seed of its scene, and whether an episode goes on in it."""

    def __init__(self) -> None:
        self.scene = 0
        self.begun = False


def _host_and_port(address: str) -> tuple[str, int]:
    """Reads an address; raises ValueError where it is none."""
    try:
        return read_address(address)
    except ValueError as error:
        raise ValueError(f"an address is HOST:PORT, such as 127.0.0.1:14000, not {address!r}: {error}") from error


def _worlds(client: Client, count: int, names: Sequence[str] | None) -> Sequence[str | None]:
    """Returns the names of as many worlds as there are rows; None is the host's first."""
    if names is not None:
        if len(names) != count or len(set(names)) != count:
            raise ValueError(f"worlds: expected {count}, each once, one a row, got {', '.join(names) or 'none'}")
        return names
    if count == 1:
        return [None]
    there = [world["world"] for world in client.worlds()]
    if len(there) < count:
        reason = f"the host has {len(there)} worlds, and {count} are needed, one for each row: see nmes serve --worlds"
        raise WorldError("too_few_worlds", reason)
    return there[:count]
