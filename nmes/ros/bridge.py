"""Clients of ROS as clients of a world: operations of rosbridge become commands, and what a world does, messages.

All that changes the world goes through a `Connection`, as what any client says: so it is checked, limited, ordered and
recorded. What topics tell is read from the world itself, after its ticks, and recorded nowhere, as it changes nothing.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection, Coroutine, Mapping
from functools import partial
from math import ceil
from time import monotonic
from typing import Any, Final, NamedTuple, TypeVar
from weakref import WeakKeyDictionary

from starlette.applications import Starlette
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from nmes.errors import RejectedMessage
from nmes.protocol import encode
from nmes.ros.definitions import fields
from nmes.ros.graph import Graph, Views, full_name
from nmes.ros.messages import RosError, plain_type
from nmes.ros.services import LOOKED_UP, SERVICES, Asked, Service, check_args, look_up
from nmes.schemas.documents import JsonObject, parse_json, write_json
from nmes.server.connection import LONG, Connection
from nmes.server.host import Host
from nmes.server.hosted_world import HostedWorld
from nmes.server.http import OwnPages
from nmes.server.websocket import Carrier, health

__all__ = ["rosbridge_application"]

A = TypeVar("A")
T = TypeVar("T")

logger = logging.getLogger(__name__)

LEVELS: Final = ("none", "error", "warning", "info")
MOST_TOPICS: Final = 1000  # that a client may listen to, and say that it speaks on, each
LONGEST: Final = 512  # characters of a topic's name, a type's, or an id
BEHIND: Final = 64 << 10  # bytes that a client has not read yet, over which topics tell it nothing

_TICK = b'"type":"tick"'

EVENTS: Final = {  # how bad those are that come to all who listen to ticks
    "barrier_timeout": "warning",
    "host_draining": "warning",
    "lagging": "warning",
    "world_closed": "error",
    "world_fault": "error",
}


def rosbridge_application(
    host: Host, names: Collection[str], origins: Collection[str], password: str | None = None
) -> ASGIApp:
    """Returns the application that serves a host's worlds to clients of rosbridge, at any path, and `/health`.

    A client says the world, the password and its role in the address that it connects to, or the password in a header:
    `ws://localhost:9090/?world=main&password=secret`, `Authorization: Bearer secret`.

    Args:
        host: The host.
        names: What this machine is called.
        origins: Whose pages may connect, beside its own.
        password: What stands for the password of those who say none; None: nothing does.
    """
    views: _AllViews = WeakKeyDictionary()

    async def connect(websocket: WebSocket) -> None:
        await websocket.accept()
        bridge = _Bridge(websocket, host, views, _auth(websocket, password))
        try:
            await bridge.run()
        finally:
            bridge.forget()

    routes = [Route("/health", health), WebSocketRoute("/{path:path}", connect)]
    return OwnPages(Starlette(routes=routes), names, origins)


_AllViews = WeakKeyDictionary[HostedWorld, Views]  # a world that is closed takes its own along


def _auth(websocket: WebSocket, password: str | None) -> JsonObject:
    """Returns the `auth` that a client's address and headers say."""
    query = websocket.query_params
    scheme, _, secret = websocket.headers.get("authorization", "").partition(" ")
    said = secret if scheme.lower() == "bearer" else query.get("password", password or "")
    named = {field: query[field] for field in ("world", "role") if field in query}
    return {"type": "auth", "password": said, **named}


class _Subscription:
    """A topic that a client listens to.

    Attributes:
        rates: How long (s of the world's time) is at least between two messages, by the subscription's id.
        pause: The shortest of them, s.
        ros2: Whether times are written as in ROS 2.
        due: The frame at which the next message is due.
    """

    def __init__(self) -> None:
        self.rates: dict[str, float] = {}
        self.pause = 0.0
        self.ros2 = False
        self.due = 0


class _Bridge(Carrier):
    """One client."""

    def __init__(self, websocket: WebSocket, host: Host, views: _AllViews, auth: JsonObject) -> None:
        super().__init__(websocket, Connection(host, None))
        self._host, self._all_views, self._auth = host, views, auth
        self._name: str | None = None  # of the world that it is in
        self._views = Views()
        self._level = LEVELS.index("error")
        self._topics: dict[str, _Subscription] = {}
        self._speaks: dict[str, str] = {}  # the topics that it has advertised, and their types
        self._replies: dict[int, Callable[[JsonObject], None]] = {}  # what is done with each
        self._number = 0  # of the last command
        self._ros2 = False  # it has named a type as in ROS 2
        self._unread = 0  # bytes when it was told something last
        self._read_at = monotonic()  # when it last read some
        self._looked: HostedWorld | None = None  # the world that tells when it may be looked at again

    # -- the connection --------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Enters the world; nothing is read before that is done."""
        self.feed(encode(self._auth))

    def tell(self, frame: bytes) -> None:
        """Takes in a reply or an event."""
        if _TICK in frame[:32]:
            self._publish()
            return
        message = parse_json(frame)
        reply = self._replies.pop(message.get("id", 0), None)
        if reply is not None:
            reply(message)
        elif message["type"] == "auth_success":
            self._name = message["world"]
            if (hosted := self._host.worlds.get(self._name)) is not None:  # it may be closed already
                self._views = self._all_views.setdefault(hosted, Views())
        elif message["type"] == "error":
            self._status("error", message["message"], None)
        else:
            kind = message["type"]
            self._status(EVENTS.get(kind, "info"), f"{kind}: {message.get('message', frame.decode())}", None)

    def forget(self) -> None:
        """No longer waits for the world to come back from a thread."""
        if self._looked is not None:
            self._looked.onlookers.pop(self._look, None)
            self._looked = None

    def _command(self, command: JsonObject, reply: Callable[[JsonObject], None]) -> None:
        """Has a command executed; `reply` is called with its reply."""
        self._number += 1
        self._replies[self._number] = reply
        self.feed(encode({**command, "id": self._number}))

    def _world(self) -> HostedWorld | None:
        """Returns the world where it may be looked at now, else None."""
        hosted = None if self._name is None else self._host.worlds.get(self._name)
        return hosted if hosted is not None and hosted.readable else None

    def _graph(self) -> Graph | None:
        """Returns the topics, those of before where the world is in a thread; None: it was always in one."""
        hosted = self._world()
        return self._views.latest if hosted is None else self._views.graph(hosted.world)

    # -- operations ------------------------------------------------------------------------------------------------

    async def hear(self, text: str) -> None:
        """Does what an operation says, and tells what cannot be done of it."""
        identity = None
        try:
            data = text.encode()
            said = parse_json(data) if len(data) <= LONG else await self._read(parse_json, data)
            if not isinstance(said, dict):
                raise RosError("an operation is a JSON object")
            identity = said.get("id")
            if identity is not None and not isinstance(identity, (str, int)):
                raise RosError("id: a string or a whole number")
            operation = _OPERATIONS.get(str(said.get("op")))
            if operation is None:
                raise RosError(
                    f"op: {str(said.get('op'))[:64]!r} is not known here; known are {', '.join(_OPERATIONS)}"
                )
            if not said.keys() <= operation.fields:
                listed = ", ".join(sorted(field[:64] for field in said.keys() - operation.fields)[:8])
                self._status("warning", f"{said['op']} has no field {listed}: that is passed over", identity)
            if (done := operation.does(self, said)) is not None:
                await done
        except (RosError, RejectedMessage) as error:
            self._status("error", error.message, identity)

    async def _read(self, reading: Callable[[A], T], what: A) -> T:
        """Reads something long in a thread, as it would keep others waiting."""
        return await asyncio.wrap_future(self._host.read(reading, what))

    def _status(self, level: str, text: str, identity: Any) -> None:
        if LEVELS.index(level) <= self._level:
            named = {} if identity is None else {"id": identity}
            self.say(write_json({"op": "status", "level": level, "msg": text, **named}))

    def _set_level(self, said: JsonObject) -> None:
        level = said.get("level")
        if level not in LEVELS:
            raise RosError(f"level: one of {', '.join(LEVELS)}")
        self._level = LEVELS.index(level)

    def _advertise(self, said: JsonObject) -> None:
        topic, (kind, ros2) = _text(said, "topic"), plain_type(_text(said, "type"))
        self._ros2 |= ros2
        self._require(topic, kind, "hear")
        if len(self._speaks) >= MOST_TOPICS and topic not in self._speaks:
            raise RosError(f"you speak on {MOST_TOPICS:,} topics, which is the most")
        self._speaks[topic] = kind

    def _unadvertise(self, said: JsonObject) -> None:
        topic = _text(said, "topic")
        if self._speaks.pop(topic, None) is None:
            self._status("warning", f"you have not advertised {topic}", said.get("id"))

    def _say(self, said: JsonObject) -> None:
        """Does what a message on a topic asks: `publish`."""
        topic, message = _text(said, "topic"), said.get("msg")
        if not isinstance(message, dict):
            raise RosError("msg: a message, a JSON object")
        graph = self._graph()
        if graph is None:
            raise RosError("the world is busy, and was not looked at yet; say it again")
        known = graph.find(topic)
        if known is None or known.hear is None:
            raise RosError(_missing(graph, topic, "hear"))
        has = fields(known.type)
        if not message.keys() <= has.keys():
            unknown = min(message.keys() - has.keys())
            raise RosError(f"msg: {known.type} has no {unknown[:64]!r}; its fields are {', '.join(has)}")
        self._command(known.hear(message), partial(self._said, topic, said.get("id")))

    def _said(self, topic: str, identity: Any, reply: JsonObject) -> None:
        """Tells what could not be done of a message."""
        failed = [each for each in (reply, *reply.get("results", ())) if each.get("type") == "error"]
        for error in failed[:1]:
            self._status("error", f"{topic}: {error['message']}", identity)

    def _subscribe(self, said: JsonObject) -> None:
        topic, identity = _text(said, "topic"), str(said.get("id", ""))
        _refuse_encodings(said)
        queue = said.get("queue_length") or 0
        if isinstance(queue, bool) or not isinstance(queue, int) or queue < 0:
            raise RosError("queue_length: a whole number of messages, 0 or more")
        rate = said.get("throttle_rate") or 0
        if isinstance(rate, bool) or not isinstance(rate, (int, float)) or not 0 <= rate <= 1e9:
            raise RosError("throttle_rate: milliseconds, from 0 to 1e9")
        kind, ros2 = plain_type(_text(said, "type")) if said.get("type") else (None, self._ros2)
        self._ros2 |= ros2
        self._require(topic, kind, "read")
        if len(identity) > LONGEST:
            raise RosError(f"id: at most {LONGEST} characters")
        if sum(len(each.rates) for each in self._topics.values()) >= MOST_TOPICS:
            raise RosError(f"you have {MOST_TOPICS:,} subscriptions, which is the most")
        subscription = self._topics.setdefault(topic, _Subscription())
        subscription.rates[identity] = rate / 1000.0
        subscription.pause = min(subscription.rates.values())
        subscription.ros2 |= ros2
        if queue > 1:
            told = f"queue_length: nothing is queued here; after a pause you are told what {topic} tells then"
            self._status("warning", told, said.get("id"))
        self._command({"type": "subscribe", "events": ["tick"]}, self._subscribed)

    def _subscribed(self, reply: JsonObject) -> None:
        """Tells a first time what topics tell: in a world that stands still there is no tick to wait for."""
        if reply["type"] == "error":
            self._status("error", reply["message"], None)
        self._publish()

    def _unsubscribe(self, said: JsonObject) -> None:
        topic = _text(said, "topic")
        subscription = self._topics.get(topic)
        if subscription is None:
            self._status("warning", f"you do not listen to {topic}", said.get("id"))
            return
        if said.get("id") is None:
            subscription.rates.clear()
        elif subscription.rates.pop(str(said["id"]), None) is None:
            self._status("warning", f"you do not listen to {topic} under that id", said["id"])
        if subscription.rates:
            subscription.pause = min(subscription.rates.values())
        else:
            del self._topics[topic]
        if not self._topics:
            self._command({"type": "unsubscribe"}, lambda _: None)

    def _require(self, topic: str, kind: str | None, way: str) -> None:
        """Raises RosError unless the world has the topic with that type, or may come to have it."""
        graph = self._graph()
        known = None if graph is None else graph.find(topic)
        if known is not None:
            if getattr(known, way) is None:
                assert graph is not None
                raise RosError(_missing(graph, topic, way))
            if kind is not None and kind != known.type:
                raise RosError(f"{topic} is of type {known.type}, and not {kind}")
        elif graph is not None and (kind is None or full_name(topic) in graph.ambiguous):
            raise RosError(_missing(graph, topic, way))

    async def _call(self, said: JsonObject) -> None:
        name, args = full_name(_text(said, "service")), said.get("args", {})
        head = {"op": "service_response", "service": said["service"]}
        if said.get("id") is not None:
            head["id"] = said["id"]
        service = SERVICES.get(name)
        try:
            if args is None or args == []:
                args = {}
            if not isinstance(args, dict):
                raise RosError("args: a JSON object, of arguments by name")
            _refuse_encodings(said)
            if service is not None or name in LOOKED_UP:
                check_args(name, args)
            if service is not None:
                long = any(len(each) > LONG for each in args.values() if isinstance(each, str))
                command = await self._read(service.command, args) if long else service.command(args)
                self._command(command, partial(self._called, head, service))
            elif name in LOOKED_UP:
                self._command({"type": "ping"}, partial(self._look_up, head, name, args))
            else:
                raise RosError(f"there is no service {name}; /rosapi/services tells which there are")
        except RosError as error:
            self._answer_error(head, service, error.message)

    def _called(self, head: JsonObject, service: Service, reply: JsonObject) -> None:
        if reply["type"] == "error":
            self._answer_error(head, service, reply["message"])
            return
        reply.pop("id", None)
        self.say(write_json({**head, "values": service.values(reply), "result": True}))

    def _look_up(self, head: JsonObject, name: str, args: JsonObject, reply: JsonObject) -> None:
        """Answers what /rosapi is asked, once all that was said before is done, and on disk where it must be."""
        hosted = self._world()
        try:
            if hosted is None:
                raise RosError("the world is busy; call again")
            asked = Asked(self._views.graph(hosted.world), hosted.world, args)
            self.say(write_json({**head, "values": look_up(name, asked), "result": True}))
        except RosError as error:
            self._answer_error(head, None, error.message)

    def _answer_error(self, head: JsonObject, service: Service | None, text: str) -> None:
        told = service is not None and service.told
        values = {"success": False, "status_message": text} if told else text
        self.say(write_json({**head, "values": values, "result": told}))

    # -- topics ----------------------------------------------------------------------------------------------------

    def _publish(self) -> None:
        """Tells what is due on the topics that this client listens to, unless it does not read."""
        hosted = None if self._name is None else self._host.worlds.get(self._name)
        if not self._topics or hosted is None:
            return
        if not hosted.readable:  # it is in a thread: it is looked at when it is back
            self._looked = hosted
            hosted.onlookers[self._look] = None
            return
        self.forget()
        if self._is_behind():
            return
        world = hosted.world
        frame, rate = world.frame, world.config["tick_rate"]
        for topic, subscription in self._topics.items():
            ticks = max(1, ceil(subscription.pause * rate - 1e-6))  # from a message to the next
            if not subscription.due - ticks <= frame < subscription.due:
                text = self._views.text(world, topic, subscription.ros2)
                if text is not None:
                    subscription.due = frame + ticks
                    self.say(text)

    def _is_behind(self) -> bool:
        """Whether the client has not read what it was told; it is cut off where it reads nothing for too long.

        Its connection cannot tell: the events of ticks that it sends go no further than this.
        """
        unread, now = self.get_write_buffer_size(), monotonic()
        if unread <= BEHIND or unread < self._unread:
            self._unread, self._read_at = unread, now
        elif now - self._read_at >= self._host.limits.stall_timeout:
            self.abort()
        else:
            self._unread = unread
        return unread > BEHIND

    def _look(self) -> None:
        """Tells what is due, in the middle of what a host does: what fails here must not fail there."""
        try:
            self._publish()
        except Exception:
            logger.exception("a client of rosbridge cannot be told what world %r does", self._name)
            self.abort()


def _text(said: Mapping[str, Any], field: str) -> str:
    value = said.get(field)
    if not isinstance(value, str) or not 0 < len(value) <= LONGEST:
        raise RosError(f"{field}: a string of 1 to {LONGEST} characters is missing")
    return value


def _refuse_encodings(said: Mapping[str, Any]) -> None:
    if said.get("compression", "none") not in ("none", None):
        raise RosError("compression: there is none here; ask without it")
    if said.get("fragment_size") is not None:
        raise RosError("fragment_size: messages are sent whole here; ask without it")


def _missing(graph: Graph, topic: str, way: str) -> str:
    """Returns why a topic cannot be spoken on or listened to."""
    if full_name(topic) in graph.ambiguous:
        return f"{topic} could be two things of this world: rename one of them"
    if graph.find(topic) is not None:
        verb = "tells, and does not listen" if way == "hear" else "listens, and tells nothing"
        return f"on {topic} the world {verb}"
    return f"this world has no topic {topic}; /rosapi/topics tells which there are"


class _Operation(NamedTuple):
    """What an operation does, and the fields that are known of it."""

    does: Callable[[_Bridge, JsonObject], Coroutine[Any, Any, None] | None]
    fields: frozenset[str]


def _operation(does: Callable[[_Bridge, JsonObject], Coroutine[Any, Any, None] | None], fields: str) -> _Operation:
    return _Operation(does, frozenset(("op", "id", *fields.split())))


_OPERATIONS: Final = {
    "advertise": _operation(_Bridge._advertise, "topic type latch queue_size"),
    "unadvertise": _operation(_Bridge._unadvertise, "topic"),
    "publish": _operation(_Bridge._say, "topic msg type latch queue_size"),
    "subscribe": _operation(_Bridge._subscribe, "topic type throttle_rate queue_length fragment_size compression"),
    "unsubscribe": _operation(_Bridge._unsubscribe, "topic type"),
    "call_service": _operation(_Bridge._call, "service type args fragment_size compression timeout"),
    "set_level": _operation(_Bridge._set_level, "level"),
}
