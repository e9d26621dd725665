"""Metrics: what a host does, counted for Prometheus.

It hides the library that counts and writes the page. Nothing is counted unless a host is given
`Metrics`: its worlds are then of a kind that measures, and all others know nothing of it. What can be read off the
host is read when it is asked for, not kept up.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

from nmes.protocol import COMMANDS, Request, decode
from nmes.world import World

__all__ = ["CONTENT_TYPE", "Figures", "Metrics", "WorldFigures", "merged_pages"]

CONTENT_TYPE = CONTENT_TYPE_LATEST

# s; a tick of 60 Hz has 0.0167.
_BUCKETS = (1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.5, 1.0)
_ERROR = b'{"type":"error"'  # how the world's encoder begins an error


class WorldFigures(NamedTuple):
    """The state of a world.

    Attributes:
        name: Its name.
        clients: The number of connections in it.
        faulted: Whether a fault has stopped it.
        unwritten: How old (s) the oldest record may be that is not written yet; None: it is not recorded.
        ratio: How fast it runs, as a part of the pace that was asked for; 1 where it keeps up.
        lost: The wall's time (s) that it has let go, since it could not keep up.
        asleep: Whether it hibernates.
    """

    name: str
    clients: int
    faulted: bool
    unwritten: float | None
    ratio: float
    lost: float
    asleep: bool


class Figures(NamedTuple):
    """The state of a host; bytes are those of the protocol, before any TLS."""

    connections: int
    received: int
    sent: int
    worlds: list[WorldFigures]


class Metrics:
    """The counters of one host, to be given to the `Host`, which counts and serves them."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self._ticks = Histogram(
            "nmes_tick_seconds", "Time of a tick", ["world"], buckets=_BUCKETS, registry=self.registry
        )
        self._commands = Counter(
            "nmes_commands", "Commands by type and outcome", ["world", "type", "outcome"], registry=self.registry
        )

    def world(self, config: Any) -> World:
        """Makes a world that is measured from when its `emit` is set."""
        measured = _MeasuredWorld(config)
        name = measured.config["name"]
        measured.ticked = self._ticks.labels(name).observe
        measured.answered = lambda kind, outcome: self._commands.labels(name, kind, outcome).inc()
        return measured

    def forget(self, name: str) -> None:
        """Takes a world that is closed off the page."""
        self._ticks.remove_by_labels({"world": name})
        self._commands.remove_by_labels({"world": name})

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
        yield GaugeMetricFamily("nmes_worlds", "Worlds that have been created", value=len(figures.worlds))
        asleep = len([world for world in figures.worlds if world.asleep])
        yield GaugeMetricFamily("nmes_worlds_asleep", "Those of them that hibernate", value=asleep)
        yield GaugeMetricFamily(
            "nmes_connections", "Connections, those in no world included", value=figures.connections
        )
        yield CounterMetricFamily("nmes_received_bytes", "Bytes received", value=figures.received)
        yield CounterMetricFamily("nmes_sent_bytes", "Bytes sent", value=figures.sent)
        clients = GaugeMetricFamily("nmes_clients", "Clients in a world", labels=["world"])
        faulted = GaugeMetricFamily("nmes_faulted", "1 where a fault has stopped the world", labels=["world"])
        lag = GaugeMetricFamily(
            "nmes_recording_lag_seconds", "Age of the oldest record that may not be written yet", labels=["world"]
        )
        ratio = GaugeMetricFamily(
            "nmes_pace_ratio", "How fast a world runs of the pace asked for; 1: it keeps up", labels=["world"]
        )
        lost = CounterMetricFamily(
            "nmes_lost_seconds", "Time of the clock that a world let go, since it could not keep up", labels=["world"]
        )
        for world in figures.worlds:
            ratio.add_metric([world.name], world.ratio)
            lost.add_metric([world.name], world.lost)
            clients.add_metric([world.name], world.clients)
            faulted.add_metric([world.name], float(world.faulted))
            if world.unwritten is not None:
                lag.add_metric([world.name], world.unwritten)
        yield from (clients, faulted, lag, ratio, lost)
