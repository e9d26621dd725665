"""The world: a deterministic state machine of cubes, joints, clients and frames over any physics engine.

It hides the engine, and keeps all that must mean the same over every engine: names, order, ownership, error codes,
joint parameters, modes, subscriptions. Commands and ticks go in, replies and events come out; each of them is told
to the journal, in the one order that makes up the world's history.

Invariants:

- The same config and the same inputs in the same order give the same replies, events and digests. Nothing here
  reads a clock, a socket, a file or an unseeded random number; the host decides when `tick` is called.
- Each command gets exactly one reply. One that is refused changes nothing; only in a `batch` do the parts before a
  refused one stand.
- Nothing a client sends makes `handle` raise. An engine that fails faults this world alone, until `reset`; so does a
  mistake of ours, but one in what changes nothing, or in what one client is told, is an error of that client alone.
"""

from __future__ import annotations

import logging
import zlib
from collections.abc import Callable, Mapping
from typing import Any

from nmes import protocol
from nmes.backend import load_backend
from nmes.backend.arrays import ArrayLike
from nmes.errors import NmesError, RecordingError, RejectedMessage, SimulationFault, WorldError
from nmes.protocol import Request
from nmes.schemas.documents import JsonObject
from nmes.world.channels import Channels
from nmes.world.client_objectives import ClientObjectives
from nmes.world.clients import Client, Clients, Emit
from nmes.world.commands import COMMANDS, HARMLESS
from nmes.world.creatures import Creatures
from nmes.world.entities import Entities
from nmes.world.journal import Journal
from nmes.world.keyframes import KeyframeSchedule
from nmes.world.life import Life
from nmes.world.pushes import Pushes
from nmes.world.queries import WorldQueries
from nmes.world.roles import OWNER, read_roles
from nmes.world.snapshot import pack, unpack
from nmes.world.state import Barrier, Fault

__all__ = ["World"]

logger = logging.getLogger(__name__)

# A faulted world still answers these: they ask nothing of the engine.
_WHEN_FAULTED = frozenset({"ping", "get_world_info", "reset", "subscribe", "unsubscribe"})


class World(WorldQueries):
    """One simulated place.

    Args:
        config: A world config (schemas/world_config.json); what is left out has its default.
        journal: Where the history goes. May be set later, before the first input that it should see.
        emit: Called with a client's number and an encoded event (no delimiter) for each event to a subscriber.

    Attributes:
        between: Called after each tick of a command, if set: there a host lets others have their turn. A RecordingError
            that it raises counts as the journal's; with a BaseException that is no Exception it ends the world's
            history in the middle of the command, and the world must only be closed then.
        in_batch: Whether the command that is being executed is part of a batch.
        pushes: What clients pushed last, for whoever watches.

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
        self.config = protocol.complete_config(config or {})
        self.journal = journal
        self.emit = emit
        self.between: Callable[[], None] | None = None
        self.in_batch = False
        self.pushes = Pushes()
        self.backend = load_backend(self.config["backend"])
        self.mode = self.config["mode"]
        self.rate = float(self.config["rate"])
        self.paused = False
        self.barrier = None
        self._tick_rate = self.config["tick_rate"]
        self._substeps: int = self.config["substeps"]
        self._past = 0
        self._stepping = False  # within the ticks of a command
        self._hibernated: bytes | None = None  # the packed snapshot of a world that sleeps
        self._keyframes = KeyframeSchedule(self.config, self.backend)
        try:
            self.roles = read_roles(self.config.get("roles"))
            self._clients = Clients(self.roles)
            self._begin(self.config["seed"], version=0)
        except WorldError as error:
            raise RejectedMessage(error.code, error.message, error.path) from error

    def _begin(self, seed: int, version: int) -> None:
        """Makes the empty world of frame 0."""
        self.entities = Entities(self.backend, self.config, seed, version)
        self.channels = Channels(self.config, self.entities)
        self.all_creatures = Creatures(self.entities, self.channels)
        self.life = self._ecosystem(self.entities, self.all_creatures)
        self.seed = seed
        self.frame = 0
        self.fault = None
        self._built = self.entities.edits

    def _ecosystem(self, entities: Entities, creatures: Creatures) -> Life | None:
        """Returns the ecosystem that the config asks for, over these creatures; None where it asks for none."""
        rules = self.config.get("life")
        return None if rules is None else Life(rules, self.backend, entities, creatures)

    # -- clients -------------------------------------------------------------------------------------------------

    def join(self, role: str | None = None, player: int | None = None) -> int:
        """Lets a client in and returns its number, never used before in this world.

        Args:
            role: In a world with roles, its role there; None: `owner`.
            player: The number of a player who comes back; None: somebody new.

        Raises:
            WorldError: `role_not_found`, `player_not_found`.
        """
        if role is None and self.roles:
            role = OWNER
        client = self._clients.join(role, player)
        number, player = client.number, client.player
        self._record(lambda journal: journal.joined(number, role, player))
        return number

    def leave(self, client: int) -> None:
        """Forgets a client's ownership and subscription; its cubes stay."""
        del self._clients[client]
        self._record(lambda journal: journal.left(client))

    def announce(self, event: Mapping[str, Any]) -> None:
        """Sends subscribers an event that only the host knows of."""
        self._clients.announce(self.emit, event)

    # -- commands ------------------------------------------------------------------------------------------------

    def handle(self, client: int, request: Request) -> bytes:
        """Executes one frame and returns the encoded reply, without delimiter. The one door for commands."""
        journal = self.journal
        if journal is None:
            encoded = protocol.encode(self.answer(self._clients[client], request))
        else:
            try:
                journal.received(client, request)
                encoded = protocol.encode(self.answer(self._clients[client], request))
                journal.replied(client, request, encoded)
            except RecordingError as error:
                self.stop_recording(error)
                return protocol.encode(self.answer(self._clients[client], request))
        if self._past + self.frame >= self._keyframes.due:
            self._keep_keyframe()
        return encoded

    def execute(self, client: int, command: Mapping[str, Any]) -> JsonObject:
        """Executes a command given as a dict and returns the reply as one; else the same as `handle`.

        Where the command has fields that are not known, the reply tells them as `ignored`, as over the wire.
        """
        request = protocol.request_from(dict(command))
        reply = protocol.decode(self.handle(client, request))
        return {**reply, "ignored": list(request.ignored)} if request.ignored else reply

    def answer(self, client: Client, request: Request) -> JsonObject:
        """Executes one request, or one command of a batch, and returns its reply.

        For `handle` and command functions alone: the journal is not told. Everybody else uses `handle` or `execute`.

        Raises:
            RecordingError: The journal was told of a tick, and failed.
        """
        command = request.command
        if command is None:
            assert request.error is not None
            reply = protocol.error_reply(request.error, request.type)
            if request.id is not protocol.NO_ID:
                reply["id"] = request.id
            return reply
        kind: str = command["type"]
        try:
            if self.fault is not None:
                self._refuse_when_faulted(kind, self.fault)
            role = client.role
            if role is not None and kind not in role.everywhere:
                role.require(self, client, command)
            reply = COMMANDS[kind](self, client, command)
        except RecordingError:
            raise
        except Exception as error:
            reply = protocol.error_reply(self._handle_error(kind, error), kind)
        if "id" in command:
            reply["id"] = command["id"]
        return reply

    def _refuse_when_faulted(self, kind: str, fault: Fault) -> None:
        if kind not in _WHEN_FAULTED or (kind == "reset" and fault.code == "recording_failed"):
            raise WorldError("world_faulted", f"the world stopped at frame {fault.frame}: {fault.message}")

    def _handle_error(self, kind: str, error: Exception) -> NmesError:
        """Returns the error to answer with; a mistake of ours stops a world that it may have left half done."""
        if isinstance(error, SimulationFault):
            self._stop(error.code, error.message, error.body)
            return WorldError("world_faulted", error.message)
        if isinstance(error, NmesError):
            return error
        logger.error("command %r of world %r failed", kind, self.config["name"], exc_info=error)
        if kind in HARMLESS:
            return WorldError("internal", "the command failed, and the world goes on; see the server's log")
        self._stop("internal", f"{type(error).__name__}: {error}", cause=error)
        return WorldError("internal", "the world failed; see the server's log")

    def drive(self, client: int, creature: str, controls: ArrayLike) -> None:
        """Drives a creature: the command `drive` for callers in this process, the same in effect and in the journal.

        Args:
            client: Whose command it is.
            creature: Its name.
            controls: Shape (m,), each from -1 to 1, in the order of the creature's motors; float64 is fastest.

        Raises:
            WorldError: As the reply `error` to the command says; that is what the journal has, too.
        """
        driven = self.all_creatures.get(creature)
        if driven is None or self.fault is not None or self.roles or not driven.accepts(controls):
            answer = self.execute(client, {"type": "drive", "creature": creature, "controls": controls})
            if answer["type"] == "error":
                raise WorldError(answer["code"], answer["message"], answer.get("field"))
            return
        journal = self.journal
        if journal is None:
            driven.drive(controls)
            return
        request, reply = driven.message(controls)
        try:
            journal.received(client, request)
            driven.drive(controls)
            journal.replied(client, request, reply)
        except RecordingError as error:
            self.stop_recording(error)
            raise WorldError("world_faulted", error.message) from error

    # -- time ----------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """Advances by one tick of `1 / tick_rate` s. Does nothing in a faulted world."""
        if self.fault is not None:
            return
        try:
            self.all_creatures.act()
            lost = self._advance()
            self._built = self.entities.edits
            self.entities.moments += 1
            self.entities.meter.tick()
            self._clients.measure(self.entities)
            self.channels.tick()
            events = lost if self.life is None else [*lost, *self.life.tick(self.frame + 1)]
            self.all_creatures.develop(None if self.life is None else self.life.energy_of)
            digest = b"" if self.journal is None else self.digest()  # nobody else is told
        except Exception as error:
            self._engine_failed(error)
            return
        self.frame += 1
        if self.journal is not None:
            try:
                self.journal.ticked(self.frame, digest)
            except RecordingError as error:
                self.stop_recording(error)
                return
        changes = self.all_creatures.changes(self.frame)
        if changes:
            self._clients.tell(self.emit, "creatures", changes)
        if events:
            self._record(lambda journal: journal.lived(self.frame, events))
            self._clients.tell(self.emit, "life", events)
        if self._clients:
            self._clients.tick(self.emit, self.frame, self.entities)
        if self._past + self.frame >= self._keyframes.due and not self._stepping:
            self._keep_keyframe()

    def _advance(self) -> list[JsonObject]:
        """Takes the engine's steps of a tick; returns what happened on the way, as events.

        In an ecosystem, which goes on for long, a creature that the engine cannot follow dies of it; without it the
        tick begins anew.

        Raises:
            SimulationFault: The engine cannot go on.
        """
        simulation, events = self.entities.simulation, list[JsonObject]()
        while True:
            try:
                simulation.step(self._substeps)
                return events
            except SimulationFault as fault:
                if self.life is None or fault.body is None or not simulation.recover():
                    raise
                lost = self.life.lose(fault.body, self.frame + 1)
                if not lost:
                    raise
                events += lost

    def step(self, ticks: int) -> None:
        """Ticks within a command, and calls `between` after each tick.

        For command functions alone: the journal is not told of a command. Scripts call `tick`, or `execute` a `step`.

        Raises:
            WorldError: `world_faulted`: the world stopped on the way.
        """
        self._stepping = True
        try:
            for _ in range(ticks):
                self.tick()
                if self.between is not None:
                    self.between()
                if self.fault is not None:
                    raise WorldError("world_faulted", f"stopped at frame {self.fault.frame}: {self.fault.message}")
        finally:
            self._stepping = False

    def reset(self, seed: int) -> None:
        """Empties the world and begins again at frame 0; clients stay, and own nothing.

        For command functions alone: the journal is not told. Scripts `execute` a `reset`.
        """
        self.simulation.close()
        began, self._past = self._past, self.ticks
        self._begin(seed, version=self.structure_version + 1)
        if self.in_batch:
            self._keyframes.advance(self._past, 0)
        else:
            self._keyframes.restart(began, self._past)
        for client in self._clients.values():
            client.owned, client.objectives = None, ClientObjectives()

    def close(self) -> None:
        """Tells subscribers that the world is closed and releases the engine."""
        self.announce({"type": "world_closed"})
        if not self.asleep:
            self.simulation.close()

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
        self.entities.require("snapshot", "snapshots")
        engine = self.simulation.snapshot()  # first: it takes up what was edited
        self.entities.moments += 1
        self._built = self.entities.edits
        barrier = self.barrier
        state = {
            "seed": self.seed,
            "frame": self.frame,
            "ticks": self.ticks,
            "mode": self.mode,
            "rate": self.rate,
            "paused": self.paused,
            "barrier": None if barrier is None else {"agents": barrier.agents, "timeout": barrier.timeout},
            "assembly": self.entities.assembly(),
            "creatures": self.all_creatures.snapshot(),
            **self._clients.snapshot(self.entities),
            **self.channels.snapshot(),
            **({} if self.life is None else {"life": self.life.snapshot()}),
        }
        return pack(self.config, state, engine)

    def restore(self, snapshot: bytes) -> None:
        """Takes up what `snapshot` of a world of the same config returned, in place of all that is here.

        The journal is not told: its history begins with what is restored.

        Raises:
            WorldError: `bad_snapshot`: it is none, or of a world of another config. This world is as it was.
        """
        simulation = self.simulation
        self._restore(snapshot)
        simulation.close()

    def _restore(self, snapshot: bytes) -> None:
        """Takes up a snapshot; whatever engine was here is still to be closed."""
        state, engine = unpack(snapshot, self.config)
        entities = Entities(self.backend, self.config, state["seed"], version=0)
        try:
            entities.restore(state["assembly"], engine)
            channels = Channels(self.config, entities)
            channels.restore(state)
            creatures = Creatures(entities, channels)
            creatures.restore(state["creatures"])
            life = self._ecosystem(entities, creatures)
            if life is not None:
                life.restore(state["life"])
            clients = Clients.restored(state, entities, self.roles)
            _require_same(state, entities, creatures, clients, channels, life)
        except Exception as error:  # an engine's bytes may be anything, and so may what its library thinks of them
            entities.simulation.close()
            raise WorldError("bad_snapshot", f"the snapshot does not fit together: {error}") from error
        self.entities, self.all_creatures, self._clients = entities, creatures, clients
        self.channels, self.life = channels, life
        self._built = entities.edits
        self.seed, self.frame, self._past = state["seed"], state["frame"], state["ticks"] - state["frame"]
        self.fault = None
        self.mode, self.rate, self.paused = state["mode"], float(state["rate"]), state["paused"]
        self.barrier = None if state["barrier"] is None else Barrier(**state["barrier"])
        self._keyframes.advance(self._past, self.frame)

    def _keep_keyframe(self) -> bytes | None:
        """Saves the world, between two inputs: a tick of the clock or a command has just ended.

        Returns:
            The snapshot; None where the world is faulted, now or before.
        """
        if self.fault is not None:
            return None
        try:
            snapshot = self.snapshot()
        except Exception as error:
            self._engine_failed(error)
            return None
        self._keyframes.advance(self._past, self.frame)
        return snapshot if self._record(lambda journal: journal.keyframe(snapshot)) else None

    def hibernate(self) -> None:
        """Saves this world and lets its engine go, until `wake`: for a host, while nobody is in the world.

        It is an input like a tick, which the journal is told first, and after it the world is as a restored one, bit
        for bit. Until then only `wake`, `close` and its attributes may be used, of which `running` is False. Where it
        cannot be saved, or that not be recorded, the world faults, and stays as it is; it also stays where what was
        saved cannot be taken up.

        Raises:
            WorldError: The engine has no snapshots (`unsupported`); the world is faulted, or somebody is in it.
        """
        self.entities.require("snapshot", "snapshots")
        if self.fault is not None or self._clients:
            raise WorldError("world_faulted" if self.fault is not None else "wrong_mode", "this world cannot hibernate")
        told = self._record(lambda journal: journal.hibernated(self.frame))
        snapshot = self._keep_keyframe() if told else None
        if snapshot is None:
            return
        simulation = self.simulation
        try:
            self._restore(snapshot)  # else a mistake in what was saved would be found when all else is gone
        except WorldError as error:
            logger.error("world %r stays awake: %s", self.config["name"], error.message)
            return
        simulation.close()
        self.simulation.close()
        self._hibernated = zlib.compress(snapshot, 1)
        del self.entities, self.all_creatures, self.channels, self.life

    def wake(self) -> None:
        """Takes this world up again where `hibernate` left it; a fault that came meanwhile stays."""
        assert self._hibernated is not None
        fault = self.fault
        self._restore(zlib.decompress(self._hibernated))
        self.fault, self._hibernated = fault, None

    # -- the journal and faults ----------------------------------------------------------------------------------

    def _record(self, call: Callable[[Journal], None]) -> bool:
        """Tells the journal of an event, if there is one; returns False where it cannot keep that."""
        if self.journal is not None:
            try:
                call(self.journal)
            except RecordingError as error:
                self.stop_recording(error)
                return False
        return True

    def stop_recording(self, error: RecordingError) -> None:
        """Faults the world because its history can no longer be kept, be it the journal's or the host's finding."""
        # Never on unrecorded: this fault stays, `reset` does not lift it.
        self.journal = None
        if self.fault is None or self.fault.code != "recording_failed":
            self._stop("recording_failed", error.message)

    def _engine_failed(self, error: Exception) -> None:
        if isinstance(error, SimulationFault):
            self._stop(error.code, error.message, error.body)
            return
        # An adapter's own mistake must not take the host down with all its other worlds, but it must be loud.
        logger.error("the engine of world %r failed", self.config["name"], exc_info=error)
        self._stop("engine_failed", f"{type(error).__name__}: {error}", cause=error)

    def _stop(self, code: str, message: str, body: int | None = None, cause: Exception | None = None) -> None:
        """Faults the world, and tells the journal and the subscribers why; `body` is the engine's number of a cube."""
        name = None if body is None else self.entities.body_names.get(body)
        if name is not None:
            message = f"{message} (cube {name})"
        self.fault = fault = Fault(code, message, self.frame, name, cause)
        self._record(lambda journal: journal.faulted(fault.frame, code, message))
        self.announce({"type": "world_fault", "code": code, "frame": fault.frame, "message": message})


def _require_same(
    state: JsonObject,
    entities: Entities,
    creatures: Creatures,
    clients: Clients,
    channels: Channels,
    life: Life | None,
) -> None:
    """Raises WorldError unless what was restored, the engine's part aside, would be saved as the very same bytes."""
    own = {**clients.snapshot(entities), **channels.snapshot(), **({} if life is None else {"life": life.snapshot()})}
    parts = {"assembly": entities.assembly(), "creatures": creatures.snapshot(), **own}
    told = {name: state[name] for name in (*parts, "roles", "channels", "life") if name in state}
    counts = [state[name] for name in ("seed", "frame", "ticks", "next_client")]
    if any(type(count) is not int for count in counts) or state["ticks"] < state["frame"]:
        raise WorldError("bad_snapshot", "its numbers of ticks, or of clients, are none")
    if max(clients, default=0) >= state["next_client"]:
        raise WorldError("bad_snapshot", "the next client has the number of one that is in")
    if protocol.encode(parts) != protocol.encode(told):
        raise WorldError("bad_snapshot", "no world would save itself like this")
