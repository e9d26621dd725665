"""`nmes measure`: what things cost on this machine, each beside something that it is compared with."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import asdict
from importlib.util import find_spec
from typing import Any

import click

from nmes.cli._interruptions import interruptions
from nmes.cli._json import print_json
from nmes.cli._options import FiniteRange
from nmes.errors import MissingPackage, visible

__all__ = ["command"]

_JSON = click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
_SEED = click.option(
    "--seed", metavar="S", type=click.IntRange(0), default=0, show_default=True, help="Of all that is drawn."
)


def _rounds(default: int) -> Callable[[Any], Any]:
    return click.option(
        "--rounds",
        metavar="N",
        type=click.IntRange(1, 10_000),
        default=default,
        show_default=True,
        help="How often what is compared takes turns.",
    )


@click.group("measure")
@click.pass_context
def command(context: click.Context) -> None:
    """Measure what things cost on this machine."""
    context.with_resource(interruptions(signal.SIGTERM))  # a host that was begun is ended then, as at Ctrl-C


@command.command("crowd")
@click.option("--backend", metavar="E", default="mujoco", show_default=True, help="The physics engine.")
@click.option(
    "--active", metavar="N", type=click.IntRange(1, 5_000), default=200, show_default=True, help="Cubes that move."
)
@click.option(
    "--still", metavar="N", type=click.IntRange(0, 5_000), default=300, show_default=True, help="Cubes besides."
)
@_rounds(9)
@_SEED
@_JSON
def crowd(backend: str, active: int, still: int, rounds: int, seed: int, as_json: bool) -> None:
    """Measure how fast a crowd of cubes runs, and what freezing is worth.

    Pairs of cubes stand in a row, the two of a pair joined by a hinge where the engine has hinges. Some are pushed
    whenever they land. The others are not there, frozen, at rest, or pushed too: four worlds, which take turns.

    For example:

    \b
        nmes measure crowd --active 200 --still 300
        nmes measure crowd --backend pymunk --json
    """
    from nmes.measure.crowds import measure_crowd

    _tell(asdict(measure_crowd(backend, active, still, seed, rounds)), as_json)


@command.command("agents")
@click.option(
    "--agents",
    metavar="N",
    type=click.IntRange(1, 200),
    multiple=True,
    default=(1, 2, 4, 8, 16, 32),
    show_default=True,
    help="How many; may be repeated.",
)
@click.option(
    "--ticks", metavar="N", type=click.IntRange(1, 100_000), default=40, show_default=True, help="Of each round."
)
@_rounds(5)
@_SEED
@_JSON
def agents(agents: tuple[int, ...], ticks: int, rounds: int, seed: int, as_json: bool) -> None:
    """Measure what agents in one world cost a host.

    A host is begun, and each agent has a connection and a cube of its own there. At each tick each of them observes
    its cube and pushes it; then the world, which waits for them, ticks. What is told is the host's time of processors.

    For example:

    \b
        nmes measure agents --agents 1 --agents 8 --agents 32
    """
    from nmes.measure.hosts import measure_agents

    found, digest = measure_agents(agents, ticks, seed, rounds)
    _tell({"agents": [asdict(each) for each in found], "digest": digest}, as_json)


@command.command("decisions")
@click.option(
    "--seconds", metavar="S", type=FiniteRange(0.1, 3600), default=3.0, show_default=True, help="In either mode."
)
@_SEED
@_JSON
def decisions(seconds: float, seed: int, as_json: bool) -> None:
    """Measure how many decisions a second one agent makes.

    It observes its cube, decides and acts: in lockstep, and in real time at each tick that it hears of.

    For example:

    \b
        nmes measure decisions --json
    """
    from nmes.measure.hosts import measure_decisions

    _tell(asdict(measure_decisions(seconds, seed)), as_json)


@command.command("spawning")
@click.option(
    "--cubes", metavar="N", type=click.IntRange(1, 5_000), default=180, show_default=True, help="How many are spawned."
)
@click.option(
    "--connections", metavar="N", type=click.IntRange(1, 200), default=9, show_default=True, help="Side by side."
)
@_rounds(9)
@_JSON
def spawning(cubes: int, connections: int, rounds: int, as_json: bool) -> None:
    """Measure how fast cubes are spawned over one connection and over many.

    Each is awaited, on one connection or on several side by side; and on one connection all are sent together.

    For example:

    \b
        nmes measure spawning --cubes 900 --connections 9
    """
    from nmes.measure.hosts import measure_spawning

    _tell(asdict(measure_spawning(cubes, connections, rounds)), as_json)


@command.command("encodings")
@click.option(
    "--cubes", metavar="N", type=click.IntRange(1, 5_000), default=100, show_default=True, help="That are observed."
)
@_rounds(9)
@_SEED
@_JSON
def encodings(cubes: int, rounds: int, seed: int, as_json: bool) -> None:
    """Measure what JSON costs, beside MessagePack and shared memory.

    A decision is a push, a tick, and the state of all cubes. The same decisions are made over TCP with JSON, over TCP
    with MessagePack, and through shared memory, in worlds that are the same.

    For example:

    \b
        nmes measure encodings --cubes 10
    """
    from nmes.measure.encodings import measure_encodings

    _tell(asdict(measure_encodings(cubes, seed, rounds)), as_json)


@command.command("peer")
@click.argument("genome", default="walker")
@_rounds(9)
@_SEED
@_JSON
def peer(genome: str, rounds: int, seed: int, as_json: bool) -> None:
    """Measure a body here and in Gymnasium.

    GENOME is a file, or the name of a genome that ships. The same model of MuJoCo is stepped by our environments, by a
    plain environment of Gymnasium, and over a host. Which other peers are installed is told too; none of them is
    measured.

    For example:

    \b
        nmes measure peer
        nmes measure peer centipede --json
    """
    _need_gymnasium()
    from nmes.measure.peers import measure_peers

    _tell(asdict(measure_peers(genome, seed, rounds)), as_json)


@command.command("learning")
@click.argument("genome", default="roller")
@click.option(
    "--steps", metavar="N", type=click.IntRange(1), default=48_000, show_default=True, help="At most, of each."
)
@click.option(
    "--goal", metavar="M", type=float, default=1.5, show_default=True, help="The score whose time is taken, m."
)
@_SEED
@_JSON
def learning(genome: str, steps: int, goal: float, seed: int, as_json: bool) -> None:
    """Measure how long a learner takes to a score, here and in Gymnasium.

    GENOME is a file, or the name of a genome that ships. The same learner, with the same seed, learns in our
    environments and in plain ones of Gymnasium over the same model of MuJoCo to get along x, until the episodes of a
    block come as far as the goal in the mean. The two take turns, block by block.

    For example:

    \b
        nmes measure learning
        nmes measure learning walker --steps 100000 --goal 2 --json
    """
    _need_gymnasium()
    from nmes.measure.peers import measure_learning

    _tell(asdict(measure_learning(genome, steps, goal, seed)), as_json)


@command.command("install")
@click.argument("packages", nargs=-1)
@_JSON
def install(packages: tuple[str, ...], as_json: bool) -> None:
    """Measure what it takes to install packages.

    PACKAGES are names of packages that are installed here; those with commas between them are installed together.
    Without any it is Gymnasium with MuJoCo, and then NMES. Each is installed by pip in a fresh virtual
    environment, from wheels that are packed again from what is installed here: no index is asked.

    For example:

    \b
        nmes measure install
        nmes measure install gymnasium,mujoco,pygame --json
    """
    from nmes.measure.installs import measure_installs

    found = measure_installs(packages or ("gymnasium,mujoco", "nmes"))
    _tell({"installs": [asdict(each) for each in found]}, as_json)


def _need_gymnasium() -> None:
    if find_spec("gymnasium") is None:
        raise MissingPackage("to measure beside Gymnasium takes it: pip install 'nmes[gym]'")


def _tell(found: dict[str, Any], as_json: bool) -> None:
    """Prints what was measured."""
    if as_json:
        print_json(found)
        return
    for line in _lines(found):
        click.echo(visible(line))


def _lines(value: Any, name: str = "") -> list[str]:
    """Returns a line for each single value, with the names that lead to it."""
    if isinstance(value, dict):
        return [line for key, each in value.items() for line in _lines(each, f"{name} {key}".strip())]
    if isinstance(value, list | tuple):
        return [line for place, each in enumerate(value) for line in _lines(each, f"{name} {place}")]
    shown = f"{value:.4g}" if isinstance(value, float) else str(value)
    return [f"{name.replace('_', ' ')}: {shown}"]
