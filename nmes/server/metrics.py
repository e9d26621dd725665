"""Metrics: what a host does, counted for Prometheus.

It hides the library that counts and writes the page. Nothing is counted unless a host is given
`Metrics`: its worlds are then of a kind that measures, and all others know nothing of it. What can be read off the
host is read when it is asked for, not kept up.

Invariant: the page is bounded, however many worlds there are. What all of them did is told without their names, and of
those that are awake the first `LISTED` have lines of their own.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

from nmes.protocol import COMMANDS, Request, decode
from nmes.world import World

__all__ = ["CONTENT_TYPE", "LISTED", "Figures", "Metrics", "Spent", "WorldFigures", "merged_pages"]

CONTENT_TYPE = CONTENT_TYPE_LATEST
LISTED = 200
"""Worlds that have lines of their own on a page."""

# s; a tick of 60 Hz has 0.0167.
_BUCKETS = (1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.5, 1.0)
_WORLD = ["world"]
_ERROR = b'{"type":"error"'  # how the world's encoder begins an error


class Spent:
    """The ticks of one world and the time (s) that they took, so far."""

    __slots__ = ("seconds", "ticks")

    def __init__(self) -> None:
        self.ticks, self.seconds = 0, 0.0


class WorldFigures(NamedTuple):
    """The state of a world that is awake.

    Attributes:
        name: Its name.
        clients: The number of connections in it.
        faulted: Whether a fault has stopped it.
        unwritten: How old (s) the oldest record may be that is not written yet; None: it is not recorded.
        ratio: How fast it runs, as a part of the pace that was asked for; 1 where it keeps up.
        lost: The wall's time (s) that it has let go, since it could not keep up.
        ticks: How often it ticked.
        seconds: The time (s) that its ticks took.
    """

    name: str
    clients: int
    faulted: bool
    unwritten: float | None
    ratio: float
    lost: float
    ticks: int
    seconds: float


class Figures(NamedTuple):
    """The state of a host; bytes are those of the protocol, before any TLS.

    Attributes:
        connections: The number of connections.
        received: Bytes.
        sent: Bytes.
        ready: Whether somebody new is let in.
        worlds: The number of worlds that have been created.
        awake: Those of them that do not hibernate, in the order in which they were created.
    """

    connections: int
    received: int
    sent: int
    ready: bool
    worlds: int
    awake: list[WorldFigures]


class Metrics:
    """The counters of one host, to be given to the `Host`, which counts and serves them."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self._ticks = Histogram("nmes_tick_seconds", "Time of a tick", buckets=_BUCKETS, registry=self.registry)
        self._commands = Counter(
            "nmes_commands", "Commands by type and outcome", ["type", "outcome"], registry=self.registry
        )
        self._lost = Counter(
            "nmes_lost_seconds",
            "Time of the clock that all worlds let go",
            registry=self.registry,
        )

    def world(self, config: Any, spent: Spent) -> World:
        """Makes a world that is measured from when its `emit` is set; its own ticks are added to `spent`."""
        measured = _MeasuredWorld(config)

        def ticked(seconds: float) -> None:
            spent.ticks += 1
            spent.seconds += seconds
            self._ticks.observe(seconds)

        measured.ticked = ticked
        measured.answered = lambda kind, outcome: self._commands.labels(kind, outcome).inc()
        return measured

    def lose(self, seconds: float) -> None:
        """Counts time that a world has let go."""
        self._lost.inc(seconds)

    def watch(self, figures: Callable[[], Figures]) -> None:
        """Adds the state of a host to the page; `figures` is called whenever the page is made."""
        self.registry.register(_Reading(figures))

    def page(self) -> bytes:
        """Returns the page in Prometheus' format, whose media type is `CONTENT_TYPE`."""
        return generate_latest(self.registry)


def merged_pages(pages: Mapping[str, bytes], own: Mapping[str, tuple[str, float]]) -> bytes:
    """Returns one page of those of several processes, whose figures get the label `worker`, and of figures of its own.

    Args:
        pages: The pages, by what is to be the label.
        own: The other figures by name, each with what it is.
    """
    families: dict[str, Metric] = {}
    for name, (about, value) in own.items():
        kind = CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily
        families[name] = kind(name, about, value=value)
    for worker, page in pages.items():
        for family in text_string_to_metric_families(page.decode()):
            into = families.setdefault(family.name, Metric(family.name, family.documentation, family.type))
            for sample in family.samples:
                into.samples.append(sample._replace(labels={"worker": worker, **sample.labels}))
    registry = CollectorRegistry()
    registry.register(_Families(list(families.values())))
    return generate_latest(registry)


class _Families(Collector):
    def __init__(self, families: list[Metric]) -> None:
        self._families = families

    def collect(self) -> Iterator[Metric]:
        yield from self._families


class _MeasuredWorld(World):
    """A world whose ticks and commands are counted, but for those that bring it to a frame of a recording.

    Their events go to nobody either: `emit` is None meanwhile.
    """

    ticked: Callable[[float], None]
    answered: Callable[[str, str], None]

    def tick(self) -> None:
        if self.fault is not None:
            return
        began = time.perf_counter()
        super().tick()
        if self.emit is not None:
            self.ticked(time.perf_counter() - began)

    def handle(self, client: int, request: Request) -> bytes:
        reply = super().handle(client, request)
        if self.emit is None:
            return reply
        outcome = decode(reply)["code"] if reply.startswith(_ERROR) else "ok"
        # What a client calls a command that there is none of must not become a series.
        self.answered(request.type if request.type in COMMANDS else "none", outcome)
        return reply


class _Reading(Collector):
    def __init__(self, figures: Callable[[], Figures]) -> None:
        self._figures = figures

    def collect(self) -> Iterator[Metric]:
        figures = self._figures()
        awake = figures.awake
        listed = awake[:LISTED]
        gauges = {
            "nmes_ready": ("1 where somebody new is let in", float(figures.ready)),
            "nmes_worlds": ("Worlds that have been created", figures.worlds),
            "nmes_worlds_asleep": ("Those of them that hibernate", figures.worlds - len(awake)),
            "nmes_worlds_faulted": ("Those that a fault has stopped", len([each for each in awake if each.faulted])),
            "nmes_worlds_lagging": ("Those that fall behind", len([each for each in awake if each.ratio < 1.0])),
            "nmes_worlds_listed": ("Those that have lines of their own", len(listed)),
            "nmes_connections": ("Connections, those in no world included", figures.connections),
            "nmes_clients": ("Clients in worlds", math.fsum(each.clients for each in awake)),
            "nmes_recording_lag_seconds": (
                "Age of the oldest record of any world that may not be written yet",
                max((each.unwritten for each in awake if each.unwritten is not None), default=0.0),
            ),
        }
        for name, (help_, number) in gauges.items():
            yield GaugeMetricFamily(name, help_, value=number)
        yield CounterMetricFamily("nmes_received_bytes", "Bytes received", value=figures.received)
        yield CounterMetricFamily("nmes_sent_bytes", "Bytes sent", value=figures.sent)
        yield from _of_worlds(listed)


def _of_worlds(worlds: Sequence[WorldFigures]) -> Iterator[Metric]:
    """Yields what is told of single worlds."""
    gauge, counter = GaugeMetricFamily, CounterMetricFamily
    families: list[tuple[GaugeMetricFamily | CounterMetricFamily, Callable[[WorldFigures], float | None]]] = [
        (gauge("nmes_world_clients", "Clients in a world", labels=_WORLD), lambda each: each.clients),
        (gauge("nmes_world_faulted", "1 where a fault has stopped it", labels=_WORLD), lambda each: each.faulted),
        (gauge("nmes_world_pace_ratio", "Its pace of that asked for", labels=_WORLD), lambda each: each.ratio),
        (
            gauge("nmes_world_recording_lag_seconds", "Age of its oldest record to be written", labels=_WORLD),
            lambda each: each.unwritten,
        ),
        (counter("nmes_world_lost_seconds", "Time of the clock that it let go", labels=_WORLD), lambda each: each.lost),
        (counter("nmes_world_ticks", "Its ticks", labels=_WORLD), lambda each: each.ticks),
        (counter("nmes_world_tick_seconds", "The time of its ticks", labels=_WORLD), lambda each: each.seconds),
    ]
    for family, read in families:
        for world in worlds:
            number = read(world)
            if number is not None:
                family.add_metric([world.name], float(number))
        yield family
