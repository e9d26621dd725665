"""`nmes genome`: list, begin, check, show, expand, vary and compare the files of creatures, and give them brains."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import orjson

from nmes.cli import _genome_publish, _genome_variation
from nmes.cli._columns import columns
from nmes.cli._genomes import find_genomes, load_genome, write_genome
from nmes.cli._json import print_json
from nmes.cli._output import check_output, whole_file
from nmes.errors import DocumentError, visible
from nmes.genome import Genome
from nmes.genome.body import Body
from nmes.genome.development import deeds
from nmes.genome.genome import SHIPPED
from nmes.schemas import load
from nmes.schemas.documents import parse_document

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from nmes.evolution import Difference

__all__ = ["command"]


def _files(_: click.Context, parameter: click.Parameter, values: Iterable[str]) -> list[str]:
    return find_genomes(values)


_argument = click.argument("files", metavar="GENOME...", nargs=-1, required=True, callback=_files)
_json = click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")


@click.group("genome")
def command() -> None:
    """List, check, show and vary genomes.

    FILE is a file, a directory (the *.json in it), a pattern such as 'creatures/*.json', or the name of a genome that
    ships with the package.
    """


command.add_command(_genome_publish.command)
command.add_command(_genome_variation.mutate)
command.add_command(_genome_variation.cross)


@command.command("list")
@_json
def list_shipped(as_json: bool) -> None:
    """List the genomes that ship with the package.

    For example:

    \b
        nmes genome list
    """
    about = [_about(Genome.load(name)) for name in Genome.names()]
    if as_json:
        print_json(about)
        return
    rows = [("genome", "size (m)", "mass (kg)", "cubes", "motors", "sensors", "brain")]
    for each in about:
        size = " x ".join(f"{edge:.2f}" for edge in each["size"])
        counts = (str(len(each[kind])) for kind in ("cubes", "motors", "sensors"))
        rows.append((each["name"], size, f"{each['mass']:.3g}", *counts, each["brain"] or "none"))
    click.echo("\n".join(columns(rows, right=(2, 3, 4, 5))))


_new_file = click.argument("target", metavar="FILE", type=click.Path(dir_okay=False, path_type=Path))


@command.command("new")
@_new_file
def new(target: Path) -> None:
    """Write a small creature to begin from: two cubes, a joint with a motor, and a brain.

    It is the worked example of docs/genomes.md, which tells what each part of it means. FILE must not be there yet; its
    name becomes the creature's.

    For example:

    \b
        nmes genome new hopper.json
    """
    _write_named(target, load("genome.json")["examples"][0])


@command.command("copy")
@click.argument("source", metavar="GENOME")
@_new_file
def copy(source: str, target: Path) -> None:
    """Write a genome to a new file, under the name of that file, to change it there.

    GENOME is a file, or the name of one that ships. The copy names it as its parent.

    For example:

    \b
        nmes genome copy walker mine.json
    """
    original = load_genome(source)
    _write_named(target, {**original.document, "parents": [original.hash]})


def _write_named(target: Path, document: dict[str, Any]) -> None:
    """Writes a genome to a file that is not there yet, under the file's name."""
    if os.path.lexists(target):
        raise click.UsageError(f"there is {target} already: name a file that is not there yet")
    try:
        genome = Genome({**document, "name": target.name.removesuffix(".json")})
    except DocumentError as error:
        raise click.UsageError(f"the file's name becomes the creature's: {error.message}") from error
    write_genome(target, genome.document)
    click.echo(f"wrote {visible(str(target))}: {visible(genome.name)}")


@command.command("check")
@_argument
@_json
@click.pass_context
def check(context: click.Context, files: list[str], as_json: bool) -> None:
    """Say whether genomes are good and, if not, everything that is wrong with them and where.

    For example:

    \b
        nmes genome check creature.json
        nmes genome check creatures/ --json
    """
    rows = []
    for file in files:
        row: dict[str, Any] = {"file": file, "name": None, "hash": None, "problems": []}
        try:
            document = parse_document(SHIPPED.read(file))
            problems = Genome.problems(document)
            if not problems:
                genome = Genome(document)
                row |= {"name": genome.name, "hash": genome.hash}
        except DocumentError as error:
            problems = list(error.problems)
        row["problems"] = [{"path": path, "message": message} for path, message in problems]
        rows.append(row)
    if as_json:
        print_json(rows)
    else:
        for row in rows:
            click.echo(f"{visible(row['file'])}: {_verdict(row['problems'])}")
            for problem in row["problems"]:
                place = f"{problem['path']}: " if problem["path"] else ""
                click.echo(f"  {visible(place + problem['message'])}")
    context.exit(1 if any(row["problems"] for row in rows) else 0)


def _verdict(problems: list[Any]) -> str:
    if len(problems) > DocumentError.MOST:
        return f"over {DocumentError.MOST} problems"
    return "good" if not problems else "1 problem" if len(problems) == 1 else f"{len(problems)} problems"


@command.command("show")
@_argument
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="PNG",
    help="Draw to a PNG file: of many genomes, a sheet.",
)
@_json
def show(files: list[str], output: Path | None, as_json: bool) -> None:
    """Show what bodies are made of, and draw them: here in characters, with -o to a PNG.

    For example:

    \b
        nmes genome show walker
        nmes genome show walker -o walker.png
        nmes genome show creatures/*.json -o sheet.png
    """
    genomes = [load_genome(file) for file in files]
    if as_json:
        print_json([_about(genome) for genome in genomes])
    if output is not None:
        _draw(genomes, output, files)
        if not as_json:
            what = visible(genomes[0].name) if len(genomes) == 1 else f"{len(genomes)} genomes"
            click.echo(f"drew {what} to {visible(str(output))}")
    elif not as_json:
        from rich.console import Console

        console = Console(highlight=False, markup=False)
        if not console.is_terminal:
            console = Console(highlight=False, markup=False, width=200)  # what reads it has lines of any length
        for index, genome in enumerate(genomes):
            if index:
                console.print()
            _print(console, genome)


def _draw(genomes: list[Genome], output: Path, files: list[str]) -> None:
    from PIL import Image

    from nmes.genome.preview import render_body, sheet

    if len(genomes) == 1:
        pixels = render_body(genomes[0].body)
    else:
        pixels = sheet([(genome.name, genome.body) for genome in genomes])
    with whole_file(output, *files) as unfinished:
        Image.fromarray(pixels).save(unfinished, format="PNG")


def _about(genome: Genome) -> dict[str, Any]:
    body, document = genome.body, genome.document
    low, high = body.bounds
    return {
        "name": genome.name,
        "hash": genome.hash,
        "author": document.get("author"),
        "license": document.get("license"),
        "description": document.get("description"),
        "parents": document.get("parents", []),
        "generative": "graph" in document["body"],
        "brain": document["brain"]["kind"] if "brain" in document else None,
        "mass": body.mass,
        "size": [high[axis] - low[axis] for axis in range(3)],
        "cubes": [
            {"id": cube.id, "size": cube.size, "mass": cube.mass, "position": cube.position} for cube in body.cubes
        ],
        "joints": [
            {"id": joint.id, "type": joint.kind, "cube1": joint.cube1, "cube2": joint.cube2, "limits": joint.limits}
            for joint in body.joints
        ],
        "motors": [
            {"id": motor.id, "mode": motor.mode, "range": [motor.low, motor.high], "max_effort": motor.max_effort}
            for motor in body.motors
        ],
        "sensors": [sensor.id for sensor in body.sensors],
        **({"voices": [voice.id for voice in body.voices]} if body.voices else {}),
        **({"later": list(body.later)} if body.later else {}),
        **({"development": document["development"]} if body.development else {}),
    }


def _print(console: Console, genome: Genome) -> None:
    from rich.text import Text

    from nmes.genome.preview import render_text

    about, body = _about(genome), genome.body
    by = f" by {about['author']}" if about["author"] else ""
    licence = f" ({about['license']})" if about["license"] else ""
    console.print(Text(visible(f"{genome.name}{by}{licence}"), style="bold"))
    if about["description"]:
        console.print(visible(about["description"], keep="\n"))
    width, height, depth = about["size"]
    console.print(
        f"{len(body.cubes)} cubes, {len(body.joints)} joints, {len(body.motors)} motors, {len(body.sensors)} sensors; "
        f"{body.mass:.3g} kg; {width:.2f} x {height:.2f} x {depth:.2f} m (x, y, z); brain: {about['brain'] or 'none'}"
    )
    console.print(f"hash {genome.hash}\n")
    columns = max(20, min(72, console.width - 1))
    for line in render_text(body, columns, columns * 22 // 72):
        console.print(line)
    console.print(_cubes(body))
    console.print()
    console.print(_joints(body))
    console.print(f"\nsensors: {', '.join(about['sensors'])}")
    if body.voices:
        console.print(f"\nvoices: {', '.join(about['voices'])}")
    if body.later:
        console.print(f"\nnot there at birth: {', '.join(about['later'])}")
    if body.development:
        console.print()
        console.print(_rules(body, about["development"]))


def _cubes(body: Body) -> Table:
    from rich.table import Table

    table = Table("cube", "size (m)", "mass (kg)", "centre (m)", box=None, pad_edge=False)
    for cube in body.cubes:
        size, place = (", ".join(f"{part:.3g}" for part in parts) for parts in (cube.size, cube.position))
        table.add_row(cube.id, size, f"{cube.mass:.3g}", place)
    return table


def _joints(body: Body) -> Table:
    from rich.table import Table

    table = Table("joint", "type", "between", "limits", "motor", box=None, pad_edge=False)
    for joint in body.joints:
        unit = "m" if joint.kind == "slide" else "rad"
        limits = "" if joint.limits is None else f"{joint.limits[0]:.3g} to {joint.limits[1]:.3g} {unit}"
        motor = joint.motor
        words = ""
        if motor is not None:
            speed, effort = ("/s" if motor.mode == "velocity" else ""), ("N" if joint.kind == "slide" else "N m")
            words = f"{motor.mode}, {motor.low:.3g} to {motor.high:.3g} {unit}{speed}, {motor.max_effort:.3g} {effort}"
        table.add_row(joint.id, joint.kind, f"{joint.cube1} - {joint.cube2}", limits, words)
    return table


def _rules(body: Body, entries: list[dict[str, Any]]) -> Table:
    from rich.table import Table

    table = Table("rule", "when", "in stage", "does", "at most", "every", box=None, pad_edge=False)
    for number, (rule, entry) in enumerate(zip(body.development, entries, strict=True)):
        stage, times = (
            "any" if rule.stage is None else str(rule.stage),
            "once" if rule.times == 1 else f"{rule.times} times",
        )
        table.add_row(str(number), visible(rule.when), stage, deeds(entry), times, f"{rule.every:g} s")
    return table


@command.command("expand")
@_argument
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="Write to a file; of many genomes, to files of the same names in a directory.",
)
def expand(files: list[str], output: Path | None) -> None:
    """Write genomes with the cubes and joints that their graphs grow into, ready to be edited by hand.

    For example:

    \b
        nmes genome expand centipede
        nmes genome expand centipede -o centipede-expanded.json
    """
    documents = [load_genome(file).expanded().document for file in files]
    if output is None:
        for document in documents:
            print_json(document)
        return
    targets = [output]
    if len(files) > 1 or output.is_dir():
        targets = [output / f"{Path(file).name.removesuffix('.json')}.json" for file in files]
        if len(set(targets)) < len(targets):
            raise click.UsageError("two of these files have the same name: expand them one by one")
    for target in targets:
        check_output(target, *files)
    for target, document in zip(targets, documents, strict=True):
        write_genome(target, document)
    for target in targets:
        click.echo(f"wrote {visible(str(target))}")


def _open(context: click.Context, parameter: click.Parameter, value: str) -> Genome:
    """Reads the genome that an argument names; one that is none is wrong usage."""
    try:
        return Genome.load(value)
    except DocumentError as error:
        message = visible(f"{value}:\n{error.message}", keep="\n")
        raise click.BadParameter(message, ctx=context, param=parameter) from error


@command.command("diff")
@click.argument("first", metavar="GENOME", callback=_open)
@click.argument("second", metavar="GENOME", callback=_open)
@_json
@click.pass_context
def diff(context: click.Context, first: Genome, second: Genome, as_json: bool) -> None:
    """Say in what two genomes differ, part by part.

    Names, authors and parents do not count.

    Exit status: 0 the same, 1 not, 2 wrong usage or no good genome.

    For example:

    \b
        nmes genome diff walker mutant.json
    """
    from nmes.evolution import differences

    found = differences(first, second)
    if as_json:
        print_json([asdict(each) for each in found])
    for each in () if as_json else found:
        click.echo(visible(f"{each.path}: {_told(each)}"))
    if not found and not as_json:
        click.echo("the same creature")
    context.exit(1 if found else 0)


@command.command("from-sb3")
@click.argument("model", metavar="MODEL", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--genome", "file", metavar="GENOME", required=True, help="The creature: a file, or one that ships.")
@click.option(
    "--vec-normalize",
    "statistics",
    metavar="FILE",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="What VecNormalize saved, if the policy was trained on observations that were normalised so.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="PATH",
    help="Write to a file. Else it is printed.",
)
def from_sb3(model: Path, file: str, statistics: Path | None, output: Path | None) -> None:
    """Give a creature the policy of a Stable-Baselines3 model for its brain.

    MODEL is the zip file that `model.save` wrote, of PPO, A2C, SAC, TD3 or DDPG. The brain does what the policy does
    where it draws no numbers. Neither Stable-Baselines3 nor torch is needed, and nothing in the file is run.

    For example:

    \b
        nmes genome from-sb3 model.zip --genome walker -o trained.json
        nmes genome from-sb3 model.zip --genome walker --vec-normalize vec_normalize.pkl -o trained.json
    """
    from nmes.learning.stable_baselines import with_policy

    check_output(output, model, file, *([] if statistics is None else [statistics]))
    creature = load_genome(file)
    try:
        trained = with_policy(creature, model, statistics)
    except DocumentError as error:
        raise click.ClickException(visible(error.message, keep="\n")) from error
    if output is None:
        print_json(trained.document)
    else:
        write_genome(output, trained.document)
        click.echo(f"wrote {visible(str(output))}: {visible(trained.name)} with the policy of {visible(str(model))}")


def _told(difference: Difference) -> str:
    """Tells a difference in a line; of long values, how long they are."""
    before, after = (_short(value) for value in (difference.before, difference.after))
    match difference.kind:
        case "added":
            return f"added {after}"
        case "removed":
            return f"removed {before}"
        case _:
            return f"{before} -> {after}"


def _short(value: Any) -> str:
    text = orjson.dumps(value).decode()
    return text if len(text) <= 100 else f"{text[:97]}..."
