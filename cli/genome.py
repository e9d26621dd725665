"""`nmes genome`: list, begin, check, show, expand, vary and compare the files of creatures, and give them brains."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
import orjson

from nmes.cli import _genome_publish
from nmes.cli._columns import columns
from nmes.cli._genomes import find_genomes
from nmes.cli._json import print_json
from nmes.cli._output import check_output, whole_file
from nmes.errors import DocumentError, VariationError, visible
from nmes.genome import Genome
from nmes.genome.body import Body
from nmes.genome.development import deeds
from nmes.genome.genome import SHIPPED
from nmes.schemas import load
from nmes.schemas.documents import did_you_mean, parse_document

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from nmes.evolution import Difference
    from nmes.variation import Draw, Requirements

__all__ = ["command"]

Bred = TypeVar("Bred")


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
    original = _load(source)
    _write_named(target, {**original.document, "parents": [original.hash]})


def _write_named(target: Path, document: dict[str, Any]) -> None:
    """Writes a genome to a file that is not there yet, under the file's name."""
    if os.path.lexists(target):
        raise click.UsageError(f"there is {target} already: name a file that is not there yet")
    try:
        genome = Genome({**document, "name": target.name.removesuffix(".json")})
    except DocumentError as error:
        raise click.UsageError(f"the file's name becomes the creature's: {error.message}") from error
    _write_document(target, genome.document)
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
    genomes = [_load(file) for file in files]
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


def _load(file: str) -> Genome:
    try:
        return Genome.load(file)
    except DocumentError as error:
        raise click.ClickException(f"{visible(file)}:\n{error.message}") from error


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
    documents = [_load(file).expanded().document for file in files]
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
        _write_document(target, document)
    for target in targets:
        click.echo(f"wrote {visible(str(target))}")


def _write_document(target: Path, document: Any) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(target) as unfinished:
        unfinished.write_bytes(orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))


_seed = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of all that is drawn.")
_count = click.option(
    "-n", "--count", type=click.IntRange(1, 100_000), default=1, show_default=True, help="How many to make."
)
_task = click.option(
    "--task", metavar="NAME|FILE", help="Make only what may take part in this task: a shipped one's name, or a file."
)
_role = click.option(
    "--role", metavar="ROLE", help="Which role of the task they are to play, where it has several that differ."
)
_output = click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="Write to a file; of many, to files in a directory. Else they are printed.",
)


@command.command("mutate")
@click.argument("file", metavar="GENOME")
@click.option(
    "--kind", metavar="KIND", help="What to change, such as add-part; drawn if left out. See docs/evolution.md."
)
@_task
@_role
@_seed
@_count
@_output
def mutate(
    file: str, kind: str | None, task: str | None, role: str | None, seed: int, count: int, output: Path | None
) -> None:
    """Change a genome a little: its body, and the brain along with it.

    What comes out is a good genome, and the same one for the same seed.

    For example:

    \b
        nmes genome mutate walker -o mutant.json
        nmes genome mutate walker --kind add-part --seed 7 --task walk -o mutant.json
        nmes genome mutate walker --task chase --role prey -o prey.json
        nmes genome mutate walker -n 20 -o mutants/
    """
    from nmes.variation import mutate as vary

    parent, needs = _load(file), _load_requirements(task, role)
    mutants = [_bred(lambda d: vary(parent, d, kind=kind, requirements=needs), seed, i) for i in range(count)]
    _write_bred([(mutant.genome, mutant.kind) for mutant in mutants], output, seed, file)


@command.command("cross")
@click.argument("first", metavar="GENOME")
@click.argument("second", metavar="GENOME")
@_task
@_role
@_seed
@_count
@_output
def cross(
    first: str, second: str, task: str | None, role: str | None, seed: int, count: int, output: Path | None
) -> None:
    """Breed two genomes: the child is mostly like the first, and has something of the second.

    For example:

    \b
        nmes genome cross walker roller -o child.json
        nmes genome cross centipede inchworm -n 10 --task walk -o children/
    """
    from nmes.variation import cross as breed

    one, other, needs = _load(first), _load(second), _load_requirements(task, role)
    children = [_bred(lambda d: breed(one, other, d, requirements=needs), seed, i) for i in range(count)]
    _write_bred([(child, f"cross with {other.name}") for child in children], output, seed, first, second)


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
    creature = _load(file)
    try:
        trained = with_policy(creature, model, statistics)
    except DocumentError as error:
        raise click.ClickException(visible(error.message, keep="\n")) from error
    if output is None:
        print_json(trained.document)
    else:
        _write_document(output, trained.document)
        click.echo(f"wrote {visible(str(output))}: {visible(trained.name)} with the policy of {visible(str(model))}")


def _load_requirements(name: str | None, role: str | None) -> Requirements:
    """Returns the requirements of bodies that take part in a task, in a role if it has any; none where none is named.

    Raises:
        UsageError: The task has no such role, or it has several and none is named.
    """
    from nmes.variation import ANY

    if name is None:
        if role is not None:
            raise click.UsageError("--role is one of a task: name that with --task")
        return ANY
    from nmes.evaluation.match_task import MatchTask, load_task
    from nmes.evolution.coevolution import default_roles

    try:
        task = load_task(name)
    except DocumentError as error:
        raise click.ClickException(f"{visible(name)}:\n{error.message}") from error
    if not isinstance(task, MatchTask):
        if role is not None:
            raise click.UsageError(f"{visible(task.name)} has no roles")
        return task.requirements
    roles = default_roles(task) if role is None else (role,)
    if len(roles) > 1:
        raise click.UsageError(f"{visible(task.name)} has several roles: say --role {' or --role '.join(roles)}")
    if roles[0] not in task.roles:
        hint = did_you_mean(roles[0], task.roles) or f": there are {', '.join(task.roles)}"
        raise click.UsageError(visible(f"{task.name} has no role {roles[0]!r}{hint}"))
    return task.requirements(roles[0])


def _bred(breed: Callable[[Draw], Bred], seed: int, number: int) -> Bred:
    """Makes the genome of that number; every number has choices of its own."""
    from nmes.variation import Draw

    try:
        return breed(Draw(seed, "genome", number))
    except (DocumentError, VariationError) as error:
        raise click.ClickException(visible(error.message, keep="\n")) from error


def _write_bred(bred: list[tuple[Genome, str]], output: Path | None, seed: int, *inputs: str) -> None:
    """Prints genomes, or writes them to a file or to files of a directory, and says how each came about."""
    if output is None:
        for genome, _ in bred:
            print_json(genome.document)
        return
    targets = [output]
    if len(bred) > 1 or output.is_dir():
        names = "-".join(Path(name).name.removesuffix(".json") for name in inputs)
        targets = [output / f"{names}-{seed}-{number}.json" for number in range(len(bred))]
    for target in targets:
        check_output(target, *inputs)
    for target, (genome, how) in zip(targets, bred, strict=True):
        _write_document(target, genome.document)
        click.echo(f"wrote {visible(str(target))}: {visible(how)}")


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
