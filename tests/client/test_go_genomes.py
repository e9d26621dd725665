"""Genomes in Go: judged in the same words, named by the same hashes, and changed into the same mutants as in Python."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from functools import cache
from itertools import count, islice
from random import Random
from typing import Any

import pytest

import go_schemas
from go_programs import GO, go
from nmes.errors import DocumentError, VariationError
from nmes.genome import Genome
from nmes.genome.limits import Limits
from nmes.schemas.documents import parse_document
from nmes.variation import KINDS, Draw, Requirements, mutate
from random_bodies import draw_genome, valid_genomes

pytestmark = pytest.mark.skipif(GO is None, reason="Go is not installed: the Go client was not built and not run")

Json = dict[str, Any]

_DRAWN, _SPOILED, _MUTANTS = 60, 12, 8  # documents; of each that ships; of each parent
_WORDS = ["", "x", "a b", "*", "it's", '"<"', "\u00e9\n\u2028", "torso", "brain", "0"]
_VALUES: list[Any] = [None, True, 0, -1, 1.0, 1e9, 1e300, 2**70, *_WORDS, [], {}, [1, 2, 3], {"a": 1}, [[]], [{}]]
_PLACES = [  # where a creature may live: what there is, for Python and for Go
    (Requirements(), {}),
    (
        Requirements(
            senses=("range", "camera", "food_smell", "touch"),
            channels=(("alarm", 1), ("map", 3)),
            shapes=("sphere", "capsule", "cylinder"),
            development=True,
        ),
        {
            "senses": ["range", "camera", "food_smell", "touch"],
            "channels": [{"name": "alarm", "size": 1}, {"name": "map", "size": 3}],
            "shapes": ["sphere", "capsule", "cylinder"],
            "development": True,
        },
    ),
    (
        Requirements(Limits(cubes=16, mass=60, size=2.5, density=3000, neighbours=40, effort=4, restitution=0.5)),
        {
            "limits": {
                **{"cubes": 16, "mass": 60, "size": 2.5, "density": 3000},
                **{"neighbours": 40, "effort": 4, "restitution": 0.5},
            }
        },
    ),
    (Requirements(planar=True, development=True), {"planar": True, "development": True}),
    (
        Requirements(Limits(neighbours=30, effort=3, friction=(0.4, 1.1)), development=True),
        {"limits": {"neighbours": 30, "effort": 3, "friction": [0.4, 1.1]}, "development": True},
    ),
]


# -- what is drawn ----------------------------------------------------------------------------------------------------


def _spots(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yields each container of a document with each of its keys."""
    for key, item in value.items() if isinstance(value, dict) else enumerate(value):
        yield value, key
        if isinstance(item, dict | list):
            yield from _spots(item)


def _misspelt(name: str) -> list[str]:
    """Returns names that are more or less like one."""
    return [name[1:], name[:-2], name[len(name) // 3 :], name[: len(name) // 2 + 1], f"{name[2:]}{name[:2]}"]


def _spoil(document: Json, draw: Random) -> None:
    """Changes a few values of a document, most of them to what they must not be."""
    for _ in range(draw.choice((1, 1, 2, 5))):
        container, key = draw.choice(list(_spots(document)))
        value = container[key]
        match draw.randrange(6):
            case 0 | 1:
                container[key] = json.loads(json.dumps(draw.choice(_VALUES)))
            case 2:
                del container[key]
            case 3 if isinstance(value, str):
                container[key] = draw.choice((*(value + letter for letter in "x*?'"), *_misspelt(value)))
            case 4 if isinstance(value, int | float):
                container[key] = value * draw.choice((-1, 2, 10, 0.1)) + draw.choice((0, 1, -0.5))
            case _ if isinstance(container, dict):
                container[draw.choice((f"{key}x", *_misspelt(key)))] = container.pop(key)
            case _:
                container.append(json.loads(json.dumps(draw.choice(_VALUES))))


def _documents() -> Iterator[str]:
    """Yields texts of genomes: good, bad, and no JSON at all."""
    draw = Random(24)
    for name in Genome.names():
        yield json.dumps(Genome.load(name).document)
        for _ in range(_SPOILED):
            document = Genome.load(name).document
            _spoil(document, draw)
            yield json.dumps(document, ensure_ascii=draw.random() < 0.5)
    drawn = 0
    for seed in count():
        try:
            document, _ = draw_genome(seed)
        except DocumentError:
            continue
        yield json.dumps({**document, "description": draw.choice(_WORDS), "author": draw.choice(_WORDS)})
        drawn += 1
        if drawn == _DRAWN:
            break
    nested = '{"body":' * 201 + "1" + "}" * 201
    yield from ("", "{", "[1,]", '{"a":1,"a":2}', "01", "1e400", '"\\ud800"', '"\t"', nested, f"[{'[],' * 70_000}[]]")


def _parents() -> Iterator[Genome]:
    """Yields genomes that ship, and random ones; their brains are of all kinds but ONNX, which Go does not vary."""
    yield from map(Genome.load, Genome.names())
    for planar in (False, True):
        found = valid_genomes(count(7_000), Counter(), planar=planar)
        genomes = (Genome(document) for _, document in found if document.get("brain", {}).get("kind") != "onnx")
        yield from islice((genome for genome in genomes if not Genome.problems(genome.document)), 24)


def _changes() -> Iterator[tuple[Genome, int, str, int]]:
    """Yields parents, seeds, kinds ("" for one that is drawn) and places: some parents are mutants themselves."""
    kinds = list(KINDS)
    for number, founder in enumerate(_parents()):
        parent = founder
        for seed in range(_MUTANTS):
            kind = "" if seed % 2 else kinds[(number * _MUTANTS + seed) // 2 % len(kinds)]
            places = [place for place, (needs, _) in enumerate(_PLACES) if not needs.check(parent.body)]
            place = places[(number + seed) % len(places)]
            yield parent, seed, kind, place
            if seed % 3 == 0:
                parent = _mutant(parent, seed, kind, place)[0] or founder


@cache
def _mutant(parent: Genome, seed: int, kind: str, place: int) -> tuple[Genome | None, Json]:
    """Returns a mutant and what the program in Go must answer."""
    try:
        mutant = mutate(parent, Draw(seed, "genome", place), kind=kind or None, requirements=_PLACES[place][0])
    except VariationError as error:
        return None, {"code": error.code, "message": error.message}
    return mutant.genome, {"hash": mutant.genome.hash, "kind": mutant.kind}


def _developing() -> Iterator[Genome]:
    """Yields genomes that ship, and others that grow, shed and resize parts by rules that are drawn."""
    draw = Random(25)
    for genome in _parents():
        yield genome
        parts = [cube.id for cube in genome.body.cubes[1:]]
        for _ in range(3):
            rules: list[Json] = [
                {
                    "when": "age > 1.0",
                    "resize": [{"part": part, "scale": round(draw.uniform(0.3, 2.5), 3)} for part in some],
                    "shed": draw.sample(parts, draw.randint(0, len(parts) // 2)),
                }
                for some in (draw.sample(parts, draw.randint(1, len(parts))) for _ in range(2) if parts)
            ]
            document = {**genome.document, "later": draw.sample(parts, len(parts) // 3), "development": rules}
            if not Genome.problems(document):
                yield Genome(document)


# -- what both make of it ---------------------------------------------------------------------------------------------


def _judged(text: str) -> Json:
    """Returns what Python says of a document."""
    try:
        problems = Genome.problems(parse_document(text.encode()))
    except DocumentError as error:
        problems = list(error.problems)
    return {"problems": problems} if problems else {"hash": Genome.parse(text.encode()).hash}


@cache
def _both() -> tuple[list[tuple[str, Json, Json]], list[tuple[Json, Json, Json]]]:
    """Returns documents and changes, each with what Python and what Go makes of it: one program in Go answers all."""
    documents = [(text, _judged(text)) for text in _documents()]
    changes = [
        (
            {"mutate": parent.document, "seed": seed, "number": place, "kind": kind, "needs": _PLACES[place][1]},
            _mutant(parent, seed, kind, place)[1],
        )
        for parent, seed, kind, place in _changes()
    ]
    questions = [{"check": text} for text, _ in documents] + [question for question, _ in changes]
    ran = go("run", "./genome/lines", told="".join(json.dumps(question) + "\n" for question in questions))
    assert ran.returncode == 0, ran.stderr
    answers = [json.loads(line) for line in ran.stdout.splitlines()]
    assert len(answers) == len(questions)
    half = len(documents)
    return (
        [(*each, answer) for each, answer in zip(documents, answers[:half], strict=True)],
        [(*each, answer) for each, answer in zip(changes, answers[half:], strict=True)],
    )


def test_the_schemas_in_go_are_those_of_the_protocol() -> None:
    assert go_schemas.GENOMES.read_text() == go_schemas.written_genomes(), "run make clients"


def test_good_documents_have_the_same_hash_and_bad_ones_are_refused() -> None:
    documents, _ = _both()
    for text, python, answer in documents:
        assert python.get("hash") == answer.get("hash"), text
    assert 60 < sum("hash" in python for _, python, _ in documents) < len(documents) - 200


def test_what_is_wrong_is_told_of_the_same_places_in_the_same_words() -> None:
    told = 0
    for text, python, answer in _both()[0]:
        if "problems" not in python or python["problems"][0][0] == "" or len(python["problems"]) > DocumentError.MOST:
            continue  # what is no JSON is told in other words, and of more than 20 problems others may come first
        found = [(problem["path"], problem["message"]) for problem in answer["problems"]]
        assert sorted(found) == sorted(python["problems"]), text
        told += len(found)
    assert told > 400


def test_the_same_seed_makes_the_same_mutant() -> None:
    _, changes = _both()
    others = [
        (question["mutate"]["name"], question["seed"], question["kind"], python, answer)
        for question, python, answer in changes
        if any(answer.get(name) != python.get(name) for name in ("hash", "kind", "code", "message"))
    ]
    assert not others, others[:3]
    kinds = Counter(answer["kind"] for _, _, answer in changes if "kind" in answer)
    assert set(kinds) == set(KINDS) and len(changes) > 500
    assert {question["number"] for question, _, _ in changes} == set(range(len(_PLACES)))
    brains = Counter(question["mutate"].get("brain", {}).get("kind") for question, _, _ in changes)
    assert {"sine", "cpg", "mlp", "ctrnn", "graph"} <= set(brains)


def test_a_body_is_held_to_limits_in_the_same_words() -> None:
    limits = Limits(neighbours=3, effort=0.7, density=900, size=1.2, mass=8, restitution=0.2, friction=(0.6, 0.9))
    needs = {"limits": {name: value for name, value in asdict(limits).items() if value is not None}}
    genomes = list(_developing())
    questions = [{"check": json.dumps(genome.document), "needs": needs} for genome in genomes]
    ran = go("run", "./genome/lines", told="".join(json.dumps(question) + "\n" for question in questions))
    assert ran.returncode == 0, ran.stderr
    told: Counter[str] = Counter()
    for genome, line in zip(genomes, ran.stdout.splitlines(), strict=True):
        reasons = limits.check(genome.body)
        assert json.loads(line).get("reasons", []) == reasons, genome.document
        told.update(re.sub(r"'[^']*'|[0-9.e+-]+", "_", reason) for reason in reasons)
    assert len(told) == 9 and min(told.values()) > 5, told  # with what two of them are of bodies that develop
