"""Documents and commands of strangers: whatever they hold, they cost little, are refused in few words, and harm nobody.

What something costs is counted in calls of functions, not in seconds.
"""

from __future__ import annotations

import base64
import json
import re
import struct
import sys
import zlib
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from creatures import snake
from nmes import World, protocol
from nmes.brain import KINDS, load_brain
from nmes.errors import DocumentError, RejectedMessage
from nmes.evaluation.task import Task
from nmes.genome import Genome
from nmes.genome.development import read_rules
from nmes.protocol import DELIMITER
from nmes.schemas import load
from nmes.schemas.documents import fits
from onnx_models import field, tensor

Json = dict[str, Any]


def calls(work: Callable[[], object]) -> int:
    """Returns how many functions, of Python or C, some work calls."""
    count = 0

    def note(frame: object, event: str, argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(before)
    return count


def spawn(body: Json, **fields: Any) -> Json:
    return {"type": "spawn_creature", "genome": {"format": "nmes-genome/1", "name": "x", "body": body, **fields}}


def graph(parts: list[Json], *connections: Json) -> Json:
    return spawn({"graph": {"root": parts[0]["id"], "parts": parts, "connections": list(connections)}})


def cycle(part: Json, **connection: Any) -> Json:
    """Two parts that grow on one another for as long as they may."""
    parts = [{**part, "id": name, "recursive_limit": 64} for name in "ab"]
    ends = ({"from": "a", "to": "b"}, {"from": "b", "to": "a"})
    return graph(parts, *({**end, "face": "+x", **connection} for end in ends))


MOTOR = {"type": "slide", "motor": {"mode": "position", "range": [-1, 1], "max_effort": 10}}
CUBES = [{"id": f"c{i:060}", "size": 0.1, "mass": 1, "position": [i, 0.05, 0]} for i in range(256)]
TIED = [
    {"id": f"j{i}", "cube1": CUBES[i]["id"], "cube2": CUBES[i + 1]["id"], "type": "hinge", "anchor": [0, 0, 0]}
    for i in range(255)
]
LOOSE = [
    {"id": f"j{i}", "cube1": f"d{i % 256:060}", "cube2": f"e{i % 256:060}", "type": "hinge", "anchor": [0, 0, 0]}
    for i in range(512)
]

REFUSED: dict[str, Json] = {
    "growth without end": cycle({"size": 10, "joint": MOTOR}, scale=10),
    "growth to nothing": cycle({"size": 0.01, "joint": MOTOR}, scale=0.1),
    "growth sideways": cycle({"size": [0.01, 10, 0.01], "density": 100000}, scale=3, mirror="y", at=[1, 1]),
    "empty cubes": spawn({"cubes": [{}] * 200_000}),
    "very many empty cubes": spawn({"cubes": [{}] * 65_000}),
    "cubes of a wrong type": spawn({"cubes": [0] * 256}),
    "cubes all wrong": spawn({"cubes": [{"id": "", "size": -1, "mass": -1, "color": [], "x": 0, "y": 1}] * 256}),
    "unknown fields": spawn({"cubes": [], **{f"k{i}": 0 for i in range(60_000)}}),
    "joints to cubes that are not there": spawn({"cubes": CUBES, "joints": LOOSE}),
    "cubes that nothing joins": spawn({"cubes": CUBES}),
    "cubes in one place": spawn({"cubes": [{**cube, "position": [0, 1, 0]} for cube in CUBES], "joints": TIED}),
    "the same sensors again": spawn(
        {"cubes": CUBES, "joints": TIED}, sensors=[{"type": "velocity", "cube": "*"}] * 1024
    ),
    "sensors of many names": spawn({"cubes": CUBES}, sensors=[{"type": "up", "cube": f"*{i}?x"} for i in range(1024)]),
    "parts of one name": graph([{"id": "a", "size": 1}] * 64),
    "connections to nowhere": graph([{"id": "a", "size": 1}], *({"from": "a", "to": "b", "face": "+x"},) * 256),
    "numbers for names": {"type": "get_world_state", "cubes": [1] * 300_000},
    "numbers for names, not many": {"type": "get_world_state", "cubes": [1] * 9_000},
    "one name very often": {"type": "get_world_state", "cubes": ["ground"] * 100_000},
    "a batch of too many": {"type": "batch", "commands": [{"type": "ping"}] * 70_000},
    "a batch of what is none": {"type": "batch", "commands": [0] * 10_000},
    "a batch in a batch": {"type": "batch", "commands": [{"type": "batch", "commands": []}] * 10_000},
    "a batch of bad ones": {"type": "batch", "commands": [{"type": "spawn_cube", "size": -1}] * 10_000},
    "a batch with bad names": {"type": "batch", "commands": [{"type": "get_world_state", "cubes": [1] * 9_000}]},
    "a long name": {"type": "get_cube_state", "cube_name": "a " * 400_000},
    "a long type": {"type": "x" * 900_000},
    "too many controls": {"type": "drive", "creature": "a", "controls": ["x"] * 250_000},
    "too many rays": {"type": "get_cube_info", "cube_name": "a", "rays": [[0, 0, 0]] * 100_000},
    "too many events": {"type": "subscribe", "events": ["tick"] * 100_000},
    "an objective over one cube": {"type": "set_objective", "expression": "1", "cubes": ["ground"] * 100_000},
    "a long expression": {"type": "set_objective", "expression": "(" * 900_000},
}


@pytest.mark.parametrize("command", REFUSED.values(), ids=REFUSED)
def test_what_a_stranger_sends_is_refused_in_few_words_and_costs_others_nothing(command: Json) -> None:
    world = World({"mode": "lockstep"})
    stranger, neighbour = world.join(), world.join()
    world.execute(neighbour, {"type": "spawn_cube", "cube_name": "ground", "is_base": False})
    before = world.digest(), world.structure_version
    replies: list[bytes] = []
    frame = json.dumps(command).encode()
    cost = calls(lambda: replies.append(world.handle(stranger, protocol.parse(frame))))
    reply = protocol.decode(replies[0])
    assert reply["type"] == "error", reply
    assert reply["code"] in ("invalid", "unknown_type", "bad_expression", "bad_json")
    assert len(replies[0]) < 8_000 and DELIMITER not in replies[0]
    assert len(reply["message"].splitlines()) <= 21
    assert cost < 150_000  # about as many microseconds are a tenth of that
    assert (world.digest(), world.structure_version, world.fault) == (*before, None)
    world.tick()
    assert world.fault is None and world.execute(neighbour, {"type": "ping"}) == {"type": "pong"}


def test_a_document_with_many_mistakes_is_answered_with_twenty_and_that_there_are_more() -> None:
    world = World({"mode": "lockstep"})
    reply = world.execute(world.join(), REFUSED["cubes all wrong"])
    *problems, rest = reply["message"].removeprefix("genome: ").splitlines()
    assert len(problems) == 20 and rest == "and more"
    assert all(problem.startswith("body/cubes/") for problem in problems)
    with pytest.raises(DocumentError) as caught:
        Genome(REFUSED["cubes all wrong"]["genome"])
    assert len(caught.value.problems) == 20 and caught.value.message.endswith("\nand more")
    assert caught.value.path == caught.value.problems[0][0]


def test_the_last_of_many_cubes_is_found_when_it_alone_is_wrong() -> None:
    cubes = [*CUBES[:-1], {**CUBES[-1], "mass": -1}]
    with pytest.raises(DocumentError) as caught:
        Genome({"format": "nmes-genome/1", "name": "x", "body": {"cubes": cubes, "joints": TIED}})
    assert [path for path, _ in caught.value.problems] == ["body/cubes/255/mass"]


def test_a_chain_as_long_as_it_may_be_grows_with_little_work() -> None:
    parts = [{"id": name, "size": 0.1, "recursive_limit": 64, "joint": {"type": "hinge"}} for name in "abcd"]
    links = ({"from": a, "to": b, "face": "+x"} for a, b in ("ab", "bc", "cd", "da"))
    document = graph(parts, *links)["genome"]
    bodies: list[Any] = []
    assert calls(lambda: bodies.append(Genome(document).body)) < 150_000
    assert len(bodies[0].cubes) == 256 and len({cube.id for cube in bodies[0].cubes}) == 256


# -- wildcards --------------------------------------------------------------------------------------------------------


def fits_by_definition(pattern: str, name: str) -> bool:
    """One row of the usual table a character of the pattern: which beginnings of the name it fits so far."""
    reached = {0}
    for mark in pattern:
        if mark == "*":
            reached = set(range(min(reached, default=len(name) + 1), len(name) + 1))
        else:
            reached = {at + 1 for at in reached if at < len(name) and mark in ("?", name[at])}
    return len(name) in reached


@given(st.text("ab*?.[]\\\n", max_size=12), st.text("ab.[]\\\n", max_size=12))
@example("a[ab]", "ab")
@example("*", "")
@example("a**b", "a\nb")
def test_wildcards_fit_what_they_are_defined_to_fit(pattern: str, name: str) -> None:
    assert fits(pattern)(name) == fits_by_definition(pattern, name)


EVIL = "*a" * 31 + "*b"


@pytest.mark.parametrize("pattern", [EVIL, "*" * 63 + "b", "a*" * 31 + "?", "*?" * 31 + "b"])
def test_no_pattern_takes_long(pattern: str) -> None:
    assert fits(pattern)("a" * 5000 + "c") == fits_by_definition(pattern, "a" * 5000 + "c")


def test_wildcards_of_a_genome_and_of_a_brain_take_no_longer_than_others() -> None:
    cube = {"id": "a" * 64, "size": 0.1, "mass": 1, "position": [0, 0.05, 0]}
    document = {"format": "nmes-genome/1", "name": "x", "body": {"cubes": [cube]}}
    with pytest.raises(DocumentError, match=re.escape(f"no cube fits {EVIL!r}")):
        Genome({**document, "sensors": [{"type": "up", "cube": EVIL}]})
    motor = {"motor": EVIL + "*a" * 30, "amplitude": 1, "frequency": 1}
    with pytest.raises(DocumentError, match="there is no motor"):
        load_brain({"kind": "sine", "oscillators": [motor]}, [], ["a" * 64])


def test_a_brain_has_only_so_many_wildcards() -> None:
    layers = [{"weights": [[0.0] * 257], "biases": [0.0], "activation": "tanh"}]
    document = {"kind": "mlp", "inputs": [f"*{i:03}" for i in range(257)], "layers": layers}
    with pytest.raises(DocumentError, match="at most 256 entries with wildcards"):
        load_brain(document, [f"{i:03}" for i in range(257)], ["m"])


# -- other documents --------------------------------------------------------------------------------------------------


def test_links_of_a_pattern_generator_are_bounded_before_they_are_made() -> None:
    motors = [f"m{i}" for i in range(512)]
    waves = [{"motor": "*", "amplitude": 1, "frequency": 1}]
    document = {"kind": "cpg", "oscillators": waves, "links": [{"from": "*", "to": "*"}] * 100}
    with pytest.raises(DocumentError, match="links/0: with it there are over 4,096 links"):
        load_brain(document, [], motors)


@pytest.mark.skipif(find_spec("onnxruntime") is None, reason="models need onnxruntime")
def test_a_model_has_only_so_many_fields_and_no_numbers_in_other_files() -> None:
    def refused(model: bytes) -> str:
        with pytest.raises(DocumentError) as caught:
            load_brain({"kind": "onnx", "model": base64.b64encode(model).decode()}, ["a"], ["m"])
        return caught.value.message

    assert "more than 200,000 fields" in refused(field(1, 1) * 300_000)
    assert "more than 200,000 fields" in refused(field(7, b"") * 300_000)
    hidden = field(25, field(11, field(1, "value") + field(5, tensor("w", [1.0], way="external"))))
    assert "keeps numbers in other files" in refused(hidden)


OBSTACLES: dict[str, tuple[list[Json], str]] = {
    "stairs": (
        [{"type": "stairs", "length": 1, "width": 1, "height": 1, "steps": 1000}] * 1000,
        "they are 1,000,000 boxes",
    ),
    "gaps": (
        [{"type": "gap", "position": [i, 0, i], "length": 0.5, "width": 0.5, "depth": 1} for i in range(5000)],
        "5,000 gaps, at most 64",
    ),
}


@pytest.mark.parametrize(("obstacles", "words"), OBSTACLES.values(), ids=OBSTACLES)
def test_scenery_is_counted_before_it_is_made(obstacles: list[Json], words: str) -> None:
    with pytest.raises(RejectedMessage, match=words) as caught:
        World({"scene": {"obstacles": obstacles}})
    assert caught.value.path == "scene/obstacles"


def test_a_landscape_s_image_is_of_the_size_that_its_first_chunk_says() -> None:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    small = struct.pack(">IIBBBBB", 9, 9, 8, 0, 0, 0, 0)
    large = struct.pack(">IIBBBBB", 30_000, 30_000, 8, 0, 0, 0, 0)
    rows = zlib.compress(bytes(30_001 * 100))
    png = b"\x89PNG\r\n\x1a\n" + chunk(b"teXt", small) + chunk(b"IHDR", large) + chunk(b"IDAT", rows)
    image = base64.b64encode(png + chunk(b"IEND", b"")).decode()
    with pytest.raises(RejectedMessage, match="the image is no PNG"):
        World({"scene": {"type": "heightfield", "heightfield": {"image": image}}})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"duration": 600, "world": {"tick_rate": 1000}}, "610,000 ticks, at most 100,000"),
        ({"duration": 600, "world": {"tick_rate": 100, "substeps": 100}}, "6,100,000 engine steps, at most 1,000,000"),
        ({"settle_limit": 60, "world": {"tick_rate": 1000, "substeps": 16}}, "engine steps, at most 1,000,000"),
    ],
)
def test_a_task_has_episodes_of_bounded_length(changes: Json, words: str) -> None:
    document = {**Task.load("walk").document, **changes}
    with pytest.raises(DocumentError, match=words) as caught:
        Task(document)
    assert caught.value.path == "duration"


def test_a_document_s_file_is_read_up_to_a_bound(tmp_path: Path) -> None:
    path = tmp_path / "large.json"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # a file with nothing in it takes no room
    for kind in (Genome, Task):
        with pytest.raises(DocumentError, match="over 80 MiB"):
            kind.load(path)


DOCUMENTS = ["auth", "genome", "task", "world_config", *(f"brain-{kind}" for kind in KINDS)]
# Bounded by the frame they come in, by the table of commands, by param_name, by a schema of its own, by the engine.
ELSEWHERE = re.compile(
    r"\w+/id|batch/commands/\[\]/type|set_joint_param/value|spawn_creature/genome|[\w/]+/(engine|life/genomes/\[\])"
)


def unbounded(part: Json, path: str) -> Iterator[str]:
    """Yields the places of a schema at which a stranger may write as much as he likes."""
    kind = part.get("type")
    fixed = (
        "enum" in part
        or "const" in part
        or part.get("maxProperties") == 0
        or re.search(r"\}\$$", part.get("pattern", "")) is not None
    )
    ends = {"minimum", "maximum"}
    needed = {"array": {"maxItems"}, "string": {"maxLength"}, "object": {"properties"}, "number": ends, "integer": ends}
    if "propertyNames" in part:  # names of the writer's own
        needed["object"] = {"maxProperties", "additionalProperties"}
    choices = [*part.get("anyOf", ()), *part.get("oneOf", ())]
    if "propertyNames" in part:
        choices += [{"type": "string", **part["propertyNames"]}, part["additionalProperties"]]
    if not fixed and not (kind is None and choices) and (kind is None or not needed.get(kind, set()) <= part.keys()):
        yield path
    for name, inner in part.get("properties", {}).items():
        yield from unbounded(inner, f"{path}/{name}")
    for inner in ([part["items"]] if "items" in part else []) + choices:
        yield from unbounded(inner, f"{path}/[]")


def test_all_that_a_stranger_may_write_has_a_bound_in_its_schema() -> None:
    schemas = {kind: command.schema for kind, command in protocol.COMMANDS.items()}
    schemas |= {name: load(f"{name}.json") for name in DOCUMENTS}
    places = [place for name, schema in schemas.items() for place in unbounded(schema, name)]
    assert len(places) > len(protocol.COMMANDS)  # each has an id
    assert [place for place in places if not ELSEWHERE.fullmatch(place)] == []


def test_rules_that_name_what_is_not_there_are_not_all_judged() -> None:
    """Of a genome that is refused, 64 of them were compared with 4,096 sensors each, for 88 s."""
    rules = [{"when": f'has("t{number}")', "shed": ["c1"]} for number in range(64)]
    problems, _ = read_rules(rules, Genome(snake()).body)
    assert len(problems) == DocumentError.MOST + 1
    with pytest.raises(DocumentError, match="and more"):
        Genome({**snake(), "development": rules})
