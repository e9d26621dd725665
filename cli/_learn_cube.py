"""`nmes learn cube`: teach the paper's cube to reach a target."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import click

from nmes.cli._json import print_json
from nmes.cli._options import FiniteRange
from nmes.cli._output import whole_file
from nmes.cli._progress import QUIET, progress_bars
from nmes.errors import visible

__all__ = ["command"]


@click.command("cube")
@click.option(
    "--episodes",
    metavar="N",
    type=click.IntRange(1, 100_000),
    default=1200,
    show_default=True,
    help="How many to learn from.",
)
@click.option(
    "--test",
    metavar="N",
    type=click.IntRange(1, 10_000),
    default=30,
    show_default=True,
    help="How many to be judged by.",
)
@click.option(
    "--seed",
    metavar="S",
    type=click.IntRange(0, 1_000_000_000),
    default=0,
    show_default=True,
    help="Of all that is drawn.",
)
@click.option(
    "--delay",
    metavar="TICKS",
    type=click.IntRange(0, 12),
    default=0,
    show_default=True,
    help="How much later than it is decided a push begins, in 60ths of a second.",
)
@click.option(
    "--real-time",
    "rate",
    metavar="RATE",
    type=FiniteRange(0.01, 100),
    help="Judge it in a world that ticks by the clock, RATE of its seconds in one, and waits for nobody.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Where to write the table that it learned, a .json file, which nmes lab shows.",
)
@click.option("--json", "as_json", is_flag=True, help="Print what came of it as JSON.")
@QUIET
def command(
    episodes: int, test: int, seed: int, delay: int, rate: float | None, output: Path | None, as_json: bool
) -> None:
    """Teach the paper's cube to reach a target, by Q-learning.

    A cube is pushed in one of four directions, five times a second, to a target that is elsewhere in each episode; what
    is seen is its velocity and where the target is from it. Then it is judged by episodes that it did not learn from,
    in which nothing is left to chance: in how many it arrives within half a metre, in twelve seconds.

    It always learns in a world that waits for each push. With --real-time it is judged on a host of its own, over a
    connection, whose world goes on meanwhile; what comes of that depends on the machine, and how many ticks a push
    lasted too long is told.

    For example:

    \b
        nmes learn cube
        nmes learn cube --seed 3 --delay 6 --json
        nmes learn cube --real-time 1
        nmes learn cube -o lab/tables/cube.json
    """
    from nmes.learning.learners.cube import TargetCube, arrivals, learn_to_arrive, table_of_cube
    from nmes.measure.clock import clock_world
    from nmes.schemas.documents import write_json

    cube = TargetCube(seed, delay)
    with nullcontext() if output is None else whole_file(output) as file:  # found before the work, not after it
        try:
            with progress_bars() as progress:
                learner = learn_to_arrive(cube, episodes, lambda done: progress("learning", done, episodes))
            others = range(episodes, episodes + test)
            if rate is None:
                arrived = arrivals(cube, learner, others)
            else:
                with clock_world(rate) as world:
                    judged = TargetCube(seed, delay, world)
                    arrived = arrivals(judged, learner, others)
        finally:
            cube.close()
        if file is not None:
            figures = {"episodes": episodes, "seed": seed, "delay": delay, "arrived": arrived, "of": test}
            file.write_bytes(write_json(table_of_cube(learner, figures)))
    told = {"episodes": episodes, "delay": delay, "arrived": arrived, "of": test, "part": arrived / test}
    if rate is not None:
        told |= {"rate": rate, "late": judged.late / judged.pushes}
    if as_json:
        print_json({**told, "digest": learner.digest})
    else:
        click.echo(f"it arrives in {arrived:,} of {test:,} episodes")
        if rate is not None:
            click.echo(f"a push lasted {told['late']:.2f} ticks too long in the mean")
        click.echo(f"digest: {learner.digest}")
        if output is not None:
            click.echo(f"wrote {visible(str(output))}")
