"""The world: a deterministic state machine of cubes, joints, clients and frames over any physics engine.

It hides the engine, and keeps all that must mean the same over every engine: names, order, ownership, error codes,
joint parameters, modes, subscriptions. Commands and ticks go in, replies and events come out; each of them is told
to the journal, in the one order that makes up the world's history.

Invariants:

- The same config and the same inputs in the same order give the same replies, events and digests. Nothing here
  reads a clock, a socket, a file or an unseeded random number; the host decides when `tick` is called.
- Each command gets exactly one reply. One that is refused changes nothing; only in a `batch` do the parts before a
  refused one stand.
- Nothing a client sends makes `handle` raise. An engine that fails faults this world alone, until `reset`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any, ClassVar

from nmes import protocol
from nmes.backend import Array, Backend, Contact, Simulation, Track, Vector, load_backend
from nmes.backend.fingerprint import VERSION
from nmes.errors import NmesError, RecordingError, RejectedMessage, SimulationFault, WorldError
from nmes.objective.trajectory import Flags, touches
from nmes.protocol import Request
from nmes.world.client_objectives import ClientObjectives, metric
from nmes.world.clients import Client, Clients, Emit
from nmes.world.creature import Creature, Creatures
from nmes.world.entities import Entities
from nmes.world.entity_commands import Inhabitants
from nmes.world.journal import Journal
from nmes.world.snapshot import pack, unpack
from nmes.world.subscription import Subscription

__all__ = ["Barrier", "Fault", "World"]

logger = logging.getLogger(__name__)

JsonObject = dict[str, Any]

# A faulted world still answers these: they ask nothing of the engine.
_WHEN_FAULTED = frozenset({"ping", "get_world_info", "reset", "subscribe", "unsubscribe"})

_BATCH_TICKS = 10_000  # as many as one `step` may ask for: others wait meanwhile
_BATCH_REPLY = 8 << 20  # bytes of replies after which the rest of a batch is refused


@dataclass(frozen=True, slots=True)
class Fault:
    """Why a world has stopped: a code of `world_fault`, a message for a person, the last good frame."""

    code: str
    message: str
    frame: int


@dataclass(frozen=True, eq=False, slots=True)
class Barrier:
    """The wish that the world tick when all who control it have said `step`. It is the host that waits and ticks."""

    agents: int
    timeout: float


def _inhabited(
    answer: Callable[[Inhabitants, Client, JsonObject], JsonObject],
) -> Callable[[World, Client, JsonObject], JsonObject]:
    return lambda world, client, command: answer(world._inhabitants, client, command)


class World:
    """One simulated place.

    Args:
        config: A world config (schemas/world_config.json); what is left out has its default.
        journal: Where the history goes. May be set later, before the first input that it should see.
        emit: Called with a client's number and an encoded event (no delimiter) for each event to a subscriber.

    Attributes:
        between: Called after each tick of a command, if set: there a host lets others have their turn. A RecordingError
            that it raises counts as the journal's; with a BaseException that is no Exception it ends the world's
            history in the middle of the command, and the world must only be closed then.

    Raises:
        RejectedMessage: The config is not valid, or asks for what the engine cannot do; `path` names the field.
        BackendNotFound: No such engine.
    """

    def __init__(
        self,
        config: Mapping[str, Any] | None = None,
        *,
        journal: Journal | None = None,
        emit: Emit | None = None,
    ) -> None:
        self.config: JsonObject = protocol.complete_config(config or {})
        self.journal = journal
        self.emit = emit
        self.between: Callable[[], None] | None = None
        self.backend: Backend = load_backend(self.config["backend"])
        self.mode: str = self.config["mode"]
        self.rate = float(self.config["rate"])
        self.paused = False
        self.barrier: Barrier | None = None
        self._in_batch = False
        self._tick_rate: int = self.config["tick_rate"]
        self._substeps: int = self.config["substeps"]
        self._clients = Clients()
        self._past = 0  # ticks before the last reset
        self._stepping = False  # within a command's ticks
        try:
            self._begin(self.config["seed"], version=0)
        except WorldError as error:
            raise RejectedMessage(error.code, error.message, error.path) from error
        self._keyframe_due = self._next_keyframe()

    def _begin(self, seed: int, version: int) -> None:
        """Makes the empty world of frame 0."""
        self._entities = Entities(self.backend, self.config, seed, version)
        self._creatures = Creatures(self._entities)
        self._inhabitants = Inhabitants(self._entities, self._creatures)
        self.seed = seed
        self.frame = 0
        self.fault: Fault | None = None

    # -- what hosts, recorders and scripts ask -------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Simulation time in s."""
        return self.frame / self._tick_rate

    @property
    def ticks(self) -> int:
        """How many ticks there were, over all resets."""
        return self._past + self.frame

    @property
    def untouched(self) -> bool:
        """Whether nothing has happened here: nobody came, and it never ticked."""
        return not (self.ticks or self._clients.ever)

    @property
    def running(self) -> bool:
        """Whether the world ticks by itself now: not in lockstep, not paused, not faulted."""
        return self.mode != "lockstep" and not self.paused and self.fault is None

    @property
    def structure_version(self) -> int:
        """A number that increases whenever a cube or a joint comes or goes, or a cube is frozen or let go."""
        return self._entities.version

    @property
    def simulation(self) -> Simulation:
        """The running scene, for benchmarks and tests; whoever edits it breaks the world's promises."""
        return self._entities.simulation

    def digest(self) -> bytes:
        """Returns the 16 bytes that stand for the engine's whole state."""
        return self.simulation.digest()

    def cubes(self) -> list[str]:
        """Returns the cubes' names in order of creation."""
        return self._entities.names()

    def joints(self) -> list[str]:
        """Returns the joints' names in order of creation."""
        return [joint.name for joint in self._entities.joints()]

    def clients(self) -> list[int]:
        """Returns the numbers of those who are in, in the order in which they came."""
        return list(self._clients)

    def creatures(self) -> list[str]:
        """Returns the creatures' names in order of creation."""
        return self._creatures.names()

    def creature(self, name: str) -> Creature:
        """Returns a creature, whose `sense` may be called at any time; to drive it is an input, see `drive`.

        Raises:
            WorldError: `creature_not_found`.
        """
        return self._creatures.find(name)

    def poses(self) -> tuple[list[str], Array]:
        """Returns the names and a new array (n, 13) of positions, quaternions, linear and angular velocities."""
        return self._entities.names(), self._entities.states()

    def track(self, cubes: Sequence[str], joints: Sequence[str], rows: int) -> Track:
        """Returns what keeps up to so many rows of the states of cubes, and of joints with motors, as the world ticks.

        Raises:
            WorldError: `cube_not_found`, `joint_not_found`.
        """
        entities = self._entities
        bodies = [entities.cube(name).body for name in cubes]
        return entities.simulation.track(bodies, [entities.joint(name).number for name in joints], rows)

    def touches(self, cubes: Sequence[str], body: int) -> Flags:
        """Returns which cubes touch something now, and something that is not of the first `body` of them: (n, 2).

        Raises:
            WorldError: `cube_not_found`.
        """
        entities = self._entities
        return touches(entities.simulation, [entities.cube(name).body for name in cubes], body)

    def cube_shape(self, name: str) -> tuple[Vector, tuple[float, float, float, float]]:
        """Returns a cube's edge lengths (m) and colour (RGBA, 0 to 1)."""
        cube = self._entities.cube(name)
        return cube.size, cube.color

    def joint_infos(self) -> list[JsonObject]:
        """Returns what `get_joint_info` tells of each joint, in order of creation."""
        return [self._entities.joint_info(joint) for joint in self._entities.joints()]

    def contacts(self) -> list[Contact]:
        """Returns what all cubes touched in the last step; two cubes that touch each other say so both."""
        bodies = [self._entities.cube(name).body for name in self._entities.names()]
        return [contact for body in bodies for contact in self.simulation.contacts(body)]

    def motor_work(self) -> float:
        """Returns what the motors of all joints that there are have worked so far, J."""
        return sum(self._entities.meter.watts(joint) or 0.0 for joint in self._entities.meter.numbers) / self._tick_rate

    def welcome(self, client: int) -> JsonObject:
        """Returns the `auth_success` message for a client that has joined."""
        return {
            "type": "auth_success",
            "protocol": protocol.PROTOCOL_VERSION,
            "client": client,
            "world": self.config["name"],
            "backend": self.backend.name,
            "dims": self.backend.dims,
            "timestep": 1.0 / self._tick_rate,
            "tick_rate": self._tick_rate,
            "mode": self.mode,
        }

    # -- inputs --------------------------------------------------------------------------------------------------

    def join(self) -> int:
        """Lets a client in and returns its number, never used before in this world."""
        number = self._clients.join()
        self._tell(lambda journal: journal.joined(number))
        return number

    def leave(self, client: int) -> None:
        """Forgets a client's ownership and subscription; its cubes stay."""
        del self._clients[client]
        self._tell(lambda journal: journal.left(client))

    def handle(self, client: int, request: Request) -> bytes:
        """Executes one frame and returns the encoded reply, without delimiter. The one door for commands."""
        journal = self.journal
        if journal is None:
            encoded = protocol.encode(self._answer(self._clients[client], request))
        else:
            try:
                journal.received(client, request)
                encoded = protocol.encode(self._answer(self._clients[client], request))
                journal.replied(client, request, encoded)
            except RecordingError as error:
                self._lose_journal(error)
                return protocol.encode(self._answer(self._clients[client], request))
        if self._past + self.frame >= self._keyframe_due:
            self._keep_keyframe()
        return encoded

    def execute(self, client: int, command: Mapping[str, Any]) -> JsonObject:
        """Executes a command given as a dict and returns the reply as one; else the same as `handle`."""
        return protocol.decode(self.handle(client, protocol.request_from(dict(command))))

    def drive(self, client: int, creature: str, controls: Array) -> None:
        """Drives a creature: the command `drive` for callers in this process, the same in effect and in the journal.

        Args:
            client: Whose command it is.
            creature: Its name.
            controls: Shape (m,), float64, each from -1 to 1, in the order of the creature's motors.

        Raises:
            WorldError: As the reply `error` to the command says; that is what the journal has, too.
        """
        held = self._creatures.get(creature)
        if held is None or self.fault is not None or not held.accepts(controls):
            refusal = self.execute(client, {"type": "drive", "creature": creature, "controls": controls.tolist()})
            raise WorldError(refusal["code"], refusal["message"], refusal.get("field"))
        journal = self.journal
        if journal is None:
            held.drive(controls)
            return
        request, reply = held.message(controls)
        try:
            journal.received(client, request)
            held.drive(controls)
            journal.replied(client, request, reply)
        except RecordingError as error:
            self._lose_journal(error)
            raise WorldError("world_faulted", error.message) from error

    def tick(self) -> None:
        """Advances by one tick of `1 / tick_rate` s. Does nothing in a faulted world."""
        if self.fault is not None:
            return
        simulation = self._entities.simulation
        try:
            simulation.step(self._substeps)
            self._entities.meter.tick()
            self._clients.measure(self._entities)
            digest = b"" if self.journal is None else simulation.digest()  # nobody else is told
        except SimulationFault as fault:
            self._stop(fault.code, fault.message, fault.body)
            return
        except Exception as error:
            self._engine_failed(error)
            return
        self.frame += 1
        if self.journal is not None:
            try:
                self.journal.ticked(self.frame, digest)
            except RecordingError as error:
                self._lose_journal(error)
                return
        if self._clients:
            self._clients.tick(self.emit, self.frame, self.time, self.structure_version, self.poses)
        if self._past + self.frame >= self._keyframe_due and not self._stepping:
            self._keep_keyframe()

    def stop_recording(self, error: RecordingError) -> None:
        """Faults the world because its history can no longer be kept; for hosts that flush on a timer."""
        self._lose_journal(error)

    def announce(self, event: Mapping[str, Any]) -> None:
        """Tells subscribers what only the host knows."""
        self._clients.announce(self.emit, event)

    def close(self) -> None:
        """Tells subscribers that the world is closed and releases the engine."""
        self._clients.announce(self.emit, {"type": "world_closed"})
        self._entities.simulation.close()

    # -- snapshots -----------------------------------------------------------------------------------------------

    def snapshot(self) -> bytes:
        """Returns all that this world is but its config, such that `restore` goes on bit for bit.

        This world then does what a restored one would: its engine has taken up what was edited since the last tick,
        and readings (contacts, efforts) follow from the state alone. So a snapshot is itself an event of the history;
        who wants it repeated with the history sets `keyframes` in the config.

        Raises:
            WorldError: The engine has no snapshots (`unsupported`), or the world is faulted.
            SimulationFault: The engine cannot take up what was edited since the last tick.
        """
        if self.fault is not None:
            raise WorldError("world_faulted", f"the world stopped at frame {self.fault.frame}: {self.fault.message}")
        entities, engine = self._entities.snapshot()
        barrier = self.barrier
        state = {
            "seed": self.seed,
            "frame": self.frame,
            "ticks": self.ticks,
            "mode": self.mode,
            "rate": self.rate,
            "paused": self.paused,
            "barrier": None if barrier is None else {"agents": barrier.agents, "timeout": barrier.timeout},
            "assembly": entities,
            "creatures": self._creatures.snapshot(),
            **self._clients.snapshot(self._entities),
        }
        return pack(self.config, state, engine)

    def restore(self, snapshot: bytes) -> None:
        """Takes up what `snapshot` of a world of the same config returned, in place of all that is here.

        The journal is not told: its history begins with what is restored.

        Raises:
            WorldError: `bad_snapshot`: it is none, or of a world of another config. This world is as it was.
        """
        state, engine = unpack(snapshot, self.config)
        entities = Entities(self.backend, self.config, state["seed"], version=0)
        try:
            entities.restore(state["assembly"], engine)
            creatures = Creatures(entities)
            creatures.restore(state["creatures"])
            clients = Clients.restored(state, entities)
        except Exception as error:  # an engine's bytes may be anything, and so may what its library thinks of them
            entities.simulation.close()
            raise WorldError("bad_snapshot", f"the snapshot does not fit together: {error}") from error
        self._entities.simulation.close()
        self._entities, self._creatures = entities, creatures
        self._inhabitants = Inhabitants(entities, creatures)
        self.seed, self.frame, self._past = state["seed"], state["frame"], state["ticks"] - state["frame"]
        self.fault = None
        self.mode, self.rate, self.paused = state["mode"], float(state["rate"]), state["paused"]
        self.barrier = None if state["barrier"] is None else Barrier(**state["barrier"])
        self._clients = clients
        self._keyframe_due = self._next_keyframe()

    def _next_keyframe(self, began: int | None = None) -> float:
        """Returns the number of ticks at which the next keyframe is due.

        They count from the last reset, so that what a world answers after one does not depend on what was before. Where
        episodes are shorter than that, a reset is the place for the keyframe that came due in the one before it.

        Args:
            began: At a reset, the number of ticks at which the episode began that it ends.
        """
        seconds = self.config.get("keyframes", 0) if "snapshot" in self.backend.capabilities else 0
        if seconds == 0:
            return inf
        every = max(1, round(seconds * self._tick_rate))
        if began is not None and not self._in_batch:
            ticks = self._past - began
            if ticks < every and began // every < self._past // every:
                return self._past
        return self._past + (self.frame // every + 1) * every

    def _keep_keyframe(self) -> None:
        """Saves the world, between two inputs: a tick of the clock or a command has just ended."""
        if self.fault is not None:
            return
        try:
            snapshot = self.snapshot()
        except SimulationFault as fault:
            self._stop(fault.code, fault.message, fault.body)
            return
        except Exception as error:
            self._engine_failed(error)
            return
        self._keyframe_due = self._next_keyframe()
        self._tell(lambda journal: journal.keyframe(snapshot))

    # -- faults and events ---------------------------------------------------------------------------------------

    def _tell(self, call: Callable[[Journal], None]) -> None:
        if self.journal is not None:
            try:
                call(self.journal)
            except RecordingError as error:
                self._lose_journal(error)

    def _lose_journal(self, error: RecordingError) -> None:
        # Never on unrecorded: this fault stays, `reset` does not lift it.
        self.journal = None
        if self.fault is None or self.fault.code != "recording_failed":
            self._stop("recording_failed", error.message, None)

    def _engine_failed(self, error: Exception) -> None:
        # An adapter's own mistake must not take the host down with all its other worlds, but it must be loud.
        logger.exception("the engine of world %r failed", self.config["name"])
        self._stop("engine_failed", f"{type(error).__name__}: {error}", None)

    def _stop(self, code: str, message: str, body: int | None) -> None:
        name = None if body is None else self._entities.name_of(body)
        if name is not None:
            message = f"{message} (cube {name})"
        self.fault = fault = Fault(code, message, self.frame)
        self._tell(lambda journal: journal.faulted(fault.frame, code, message))
        event = {"type": "world_fault", "code": code, "frame": fault.frame, "message": message}
        self._clients.announce(self.emit, event)

    # -- commands ------------------------------------------------------------------------------------------------

    def _answer(self, client: Client, request: Request) -> JsonObject:
        command = request.command
        if command is None:
            assert request.error is not None
            reply = protocol.error_reply(request.error, request.type)
            if request.id is not protocol.NO_ID:
                reply["id"] = request.id
            return reply
        reply = self._perform(client, command)
        if "id" in command:
            reply["id"] = command["id"]
        return reply

    def _perform(self, client: Client, command: JsonObject) -> JsonObject:
        kind: str = command["type"]
        try:
            if self.fault is not None and (
                kind not in _WHEN_FAULTED or (kind == "reset" and self.fault.code == "recording_failed")
            ):
                raise WorldError(
                    "world_faulted", f"the world stopped at frame {self.fault.frame}: {self.fault.message}"
                )
            return self.COMMANDS[kind](self, client, command)
        except NmesError as error:
            if isinstance(error, RecordingError):
                raise
            if isinstance(error, SimulationFault):
                self._stop(error.code, error.message, error.body)
                error = WorldError("world_faulted", error.message)
            return protocol.error_reply(error, kind)
        except Exception as error:
            logger.exception("command %r of world %r failed", kind, self.config["name"])
            self._stop("internal", f"{type(error).__name__}: {error}", None)
            return protocol.error_reply(WorldError("internal", "the world failed; see the server's log"), kind)

    # -- commands: the world -------------------------------------------------------------------------------------

    def _get_world_state(self, client: Client, c: JsonObject) -> JsonObject:
        entities = self._entities
        names = c.get("cubes")
        if names is None:
            cubes = [entities.cube(name) for name in entities.names()]
        else:
            cubes = [entities.cube(name, f"cubes/{i}") for i, name in enumerate(names)]
        moving = entities.moving(cubes, sensors=bool(c.get("sensors")))
        return {"type": "world_state", "frame": self.frame, "t": self.time, "cubes": moving}

    def _get_world_info(self, client: Client, c: JsonObject) -> JsonObject:
        fault = self.fault
        return {
            "type": "world_info",
            "world": self.config["name"],
            "backend": self.backend.name,
            "versions": {
                "nmes": VERSION,
                "protocol": protocol.PROTOCOL_VERSION,
                "engine": self.backend.version(),
            },
            "dims": self.backend.dims,
            "seed": self.seed,
            "config": self.config,
            "mode": self.mode,
            "rate": self.rate,
            "paused": self.paused,
            "frame": self.frame,
            "t": self.time,
            "counts": {
                "cubes": len(self._entities.names()),
                "joints": len(self._entities.joints()),
                "clients": len(self._clients),
            },
            "limits": self.config["limits"],
            "skeletons": self._entities.skeletons(),
            "capabilities": self.capabilities(),
            "fault": None if fault is None else {"code": fault.code, "frame": fault.frame, "message": fault.message},
        }

    def capabilities(self) -> list[str]:
        """Returns the optional commands that this world serves and what its engine can do, sorted."""
        optional = {kind for kind in self.COMMANDS if not protocol.COMMANDS[kind].required}
        for command, capability in (("create_bone", "joint.conetwist"), ("get_camera", "camera")):
            if capability not in self.backend.capabilities:
                optional.discard(command)
        return sorted(optional | self.backend.capabilities)

    def _reset(self, client: Client, c: JsonObject) -> JsonObject:
        self._entities.simulation.close()
        began, self._past = self._past, self.ticks
        self._begin(c.get("seed", self.seed), version=self.structure_version + 1)
        self._keyframe_due = self._next_keyframe(began)
        for other in self._clients.values():
            other.owned, other.objectives = None, ClientObjectives()
        return {"type": "world_reset", "frame": 0, "seed": self.seed}

    def _step(self, client: Client, c: JsonObject) -> JsonObject:
        if self.mode != "lockstep" and not self.paused:
            raise WorldError("wrong_mode", f"step works in lockstep or in a paused world, not in {self.mode}")
        if self.barrier is not None:
            # The host held it back until all were there, and has ticked.
            if self._in_batch:
                raise WorldError("wrong_mode", "a step that waits for others cannot be part of a batch")
            return {"type": "stepped", "frame": self.frame, "t": self.time}
        self._stepping = True
        try:
            for _ in range(c.get("ticks", 1)):
                self.tick()
                if self.between is not None:
                    self.between()
                if self.fault is not None:
                    raise WorldError("world_faulted", f"stopped at frame {self.fault.frame}: {self.fault.message}")
        finally:
            self._stepping = False
        return {"type": "stepped", "frame": self.frame, "t": self.time}

    def _pause(self, client: Client, c: JsonObject) -> JsonObject:
        self.paused = True
        return {"type": "paused", "frame": self.frame}

    def _resume(self, client: Client, c: JsonObject) -> JsonObject:
        self.paused = False
        return {"type": "resumed", "frame": self.frame}

    def _set_mode(self, client: Client, c: JsonObject) -> JsonObject:
        barrier: Barrier | None = None
        if c.get("barrier", False):
            if c["mode"] != "lockstep":
                raise WorldError("wrong_mode", f"barrier: only in lockstep, not in {c['mode']}", "barrier")
            default = protocol.COMMANDS["set_mode"].defaults
            barrier = Barrier(c.get("agents", default["agents"]), float(c.get("timeout", default["timeout"])))
        self.mode, self.barrier = c["mode"], barrier
        self.rate = float(c.get("rate", self.rate))
        reply: JsonObject = {"type": "mode_set", "mode": self.mode, "rate": self.rate}
        return {**reply, "barrier": True} if barrier is not None else reply

    def _subscribe(self, client: Client, c: JsonObject) -> JsonObject:
        default = protocol.COMMANDS["subscribe"].defaults
        client.subscription = s = Subscription(
            events=tuple(dict.fromkeys(c.get("events", default["events"]))),
            every=c.get("every", default["every"]),
            position_threshold=float(c.get("position_threshold", default["position_threshold"])),
            rotation_threshold=float(c.get("rotation_threshold", default["rotation_threshold"])),
        )
        return {
            "type": "subscribed",
            "events": s.events,
            "every": s.every,
            "position_threshold": s.position_threshold,
            "rotation_threshold": s.rotation_threshold,
        }

    def _unsubscribe(self, client: Client, c: JsonObject) -> JsonObject:
        client.subscription = None
        return {"type": "unsubscribed"}

    def _set_objective(self, client: Client, c: JsonObject) -> JsonObject:
        entities = self._entities
        if "creature" in c:
            if "cubes" in c:
                raise WorldError("invalid", "cubes: either cubes or a creature, not both", "cubes")
            parts = self._creatures.find(c["creature"]).cubes
            body = {part: entities.cube(name) for part, name in parts.items()}
        elif "cubes" in c:
            body = {name: entities.cube(name, f"cubes/{i}") for i, name in enumerate(c["cubes"])}
        else:
            own = self._inhabitants.cube_or_own(client, {})
            body = {own.name: own}
        return client.objectives.set(entities, self.frame, body, c)

    def _compute_reward(self, client: Client, c: JsonObject) -> JsonObject:
        if "metric" not in c:
            return client.objectives.value(self._entities, self.frame, c.get("objective"))
        if "objective" in c:
            raise WorldError("invalid", "objective: either a metric or an objective, not both", "objective")
        cube = self._entities.cube(c["cube"], "cube") if "cube" in c else self._inhabitants.cube_or_own(client, {})
        return metric(self._entities, cube, c)

    def _batch(self, client: Client, c: JsonObject) -> JsonObject:
        ticks = sum(command.get("ticks", 1) for command in c["commands"] if command["type"] == "step")
        if ticks > _BATCH_TICKS:
            raise WorldError("invalid", f"commands: {ticks} ticks in one batch, at most {_BATCH_TICKS}", "commands")
        results: list[JsonObject] = []
        size = 0
        for command in c["commands"]:
            if command["type"] == "spawn_cube" and "list" not in command:
                command = {**command, "list": False}
            # It was validated with the batch.
            kind, number = command["type"], command.get("id", protocol.NO_ID)
            request = Request(b"", command, None, kind, number)
            if size > _BATCH_REPLY:
                message = f"the replies of this batch are over {_BATCH_REPLY >> 20} MiB; send the rest anew"
                request = Request(b"", None, RejectedMessage("limit_reached", message), kind, number)
            self._in_batch = True
            try:
                results.append(self._answer(client, request))
            finally:
                self._in_batch = False
            size += len(protocol.encode(results[-1]))
        return {"type": "batch_result", "results": results}

    def _ping(self, client: Client, c: JsonObject) -> JsonObject:
        return {"type": "pong"}

    COMMANDS: ClassVar[dict[str, Callable[[World, Client, JsonObject], JsonObject]]] = {
        **{kind: _inhabited(answer) for kind, answer in Inhabitants.COMMANDS.items()},
        "get_world_state": _get_world_state,
        "get_world_info": _get_world_info,
        "reset": _reset,
        "step": _step,
        "pause": _pause,
        "resume": _resume,
        "set_mode": _set_mode,
        "subscribe": _subscribe,
        "unsubscribe": _unsubscribe,
        "set_objective": _set_objective,
        "compute_reward": _compute_reward,
        "batch": _batch,
        "ping": _ping,
    }
