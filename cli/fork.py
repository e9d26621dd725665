"""`nmes fork`: a new recording that begins at a frame of another."""

from __future__ import annotations

from pathlib import Path

import click

from nmes.cli._json import print_json
from nmes.cli._options import MOMENT, Moment
from nmes.cli.info import open_recording
from nmes.errors import visible
from nmes.playback.fork import fork
from nmes.recording import Recording
from nmes.world import World

__all__ = ["command"]


@click.command("fork")
@click.argument("recording", metavar="FILE", callback=open_recording)
@click.option("--at", "moment", type=MOMENT, help="The frame or time, as 120 or 2.0s.  [default: the last]")
@click.option(
    "-o", "--output", required=True, type=click.Path(dir_okay=False, path_type=Path), help="The new recording."
)
@click.option("--json", "as_json", is_flag=True, help="Print what was done as JSON.")
def command(recording: Recording, moment: Moment | None, output: Path, as_json: bool) -> None:
    """Take the world out of a recording as it was at a frame.

    Writes a recording that begins there and holds nothing else: small, whole without its parent, which it names, and
    the place from which others go on. Scripts do so with nmes.playback.world_at, servers with
    `nmes serve --resume NEW.mcap`. The clients of then are in it. Where the engine cannot save a world, all that came
    before the frame is in it.

    Frames are counted on through resets.

    For example:

    \b
        nmes fork long.mcap --at 36000 -o tenth-minute.mcap
    """
    world = World(recording.config)
    try:
        _write(recording, world, output, None if moment is None else moment.frame(recording))
        done = {"file": str(output), "parent": str(recording.path), "frame": world.ticks, "cubes": len(world.cubes())}
    finally:
        world.close()
    if as_json:
        print_json(done)
    else:
        told = f"frame {done['frame']:,} of {recording.path}, {done['cubes']:,} cubes: {output}"
        click.echo(visible(told))


def _write(recording: Recording, world: World, output: Path, frame: int | None) -> None:
    recorder = fork(recording, world, output, frame)
    try:
        recorder.close()
    except BaseException:
        output.unlink()  # half of a new file is of no use
        raise
