"""Genomes as documents: what is good, all that is wrong with one that is not, how graphs grow, what a hash is of."""

from __future__ import annotations

import copy
import hashlib
import json
import math
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nmes import World
from nmes.errors import DocumentError
from nmes.genome import Genome
from nmes.genome.body import read_body
from nmes.genome.morphology import MOST_CUBES, grow

Document = dict[str, Any]


def pair() -> Document:
    """Two cubes and a motored hinge."""
    return {
        "format": "nmes-genome/1",
        "name": "pair",
        "body": {
            "cubes": [
                {"id": "a", "size": 0.4, "mass": 1, "position": [0, 0.2, 0]},
                {"id": "b", "size": [0.4, 0.2, 0.2], "mass": 1, "position": [0.5, 0.2, 0]},
            ],
            "joints": [
                {
                    "id": "hip",
                    "cube1": "a",
                    "cube2": "b",
                    "type": "hinge",
                    "anchor": [0.25, 0.2, 0],
                    "motor": {"mode": "position", "range": [-1, 1], "max_effort": 5},
                }
            ],
        },
    }


def changed(path: str, value: Any) -> Document:
    """`pair` with another value at a path; None takes it away."""
    document = pair()
    at: Any = document
    *way, last = [int(key) if key.isdigit() else key for key in path.split("/")]
    for key in way:
        at = at[key]
    if value is None:
        del at[last]
    elif isinstance(at, list) and last == len(at):
        at.append(value)
    else:
        at[last] = value
    return document


def problems(document: Any) -> list[tuple[str, str]]:
    with pytest.raises(DocumentError) as caught:
        Genome(document)
    return list(caught.value.problems)


# -- what is wrong ----------------------------------------------------------------------------------------------------

C = {"id": "c", "size": 0.2, "mass": 1, "position": [0, 0.2, 0.3]}
LINK = {"id": "knee", "cube1": "a", "cube2": "c", "type": "hinge", "anchor": [0, 0.2, 0.2]}


@pytest.mark.parametrize(
    ("path", "value", "place", "message"),
    [
        ("format", "nmes-genome/2", "format", 'expected "nmes-genome/1", got "nmes-genome/2"'),
        ("name", None, "name", "is missing"),
        ("bodyy", {}, "bodyy", "there is no such field; did you mean body?"),
        ("body/cubes", None, "body", "must have either cubes (and joints between them) or a graph"),
        ("body/graph", {"root": "x", "parts": [{"id": "x", "size": 1}]}, "body", "must have either cubes"),
        ("body/cubes/0/size", 11, "body/cubes/0/size", "expected an edge, or 3 edges, from 0.01 to 10 m, got 11"),
        ("body/cubes/0/mass", 0, "body/cubes/0/mass", "expected a number from 0.001 to 10,000 kg, got 0"),
        ("body/cubes/0/id", "a b", "body/cubes/0/id", "expected an id (1 to 64 letters"),
        ("body/cubes/1/id", "a", "body/cubes/1/id", "there is a cube 'a' already"),
        ("body/joints/1", {**LINK, "id": "hip"}, "body/joints/1/id", "there is a joint 'hip' already"),
        ("body/joints/0/cube2", "bb", "body/joints/0/cube2", "there is no cube 'bb'; did you mean b?"),
        ("body/joints/0/cube2", "a", "body/joints/0/cube2", "joint 'hip' joins 'a' to itself"),
        ("body/joints/1", {**LINK, "cube2": "b"}, "body/joints/1", "'a' and 'b' are joined by 'hip' already"),
        ("body/joints/0/type", "fixed", "body/joints/0/motor", "is a fixed; only a hinge or a slide can have a motor"),
        ("body/joints/0/limits", [1, -1], "body/joints/0/limits", "limit of joint 'hip', 1, is above the upper, -1"),
        ("body/joints/0/motor/range", [1, 1], "body/joints/0/motor/range", "both ends of the motor of joint 'hip'"),
        ("body/cubes/2", C, "body/cubes/2", "'c' is not joined to the rest of the body"),
        ("body/joints/0", None, "body/cubes/1", "'b' is not joined to the rest of the body"),
        ("body/cubes/0/position", [0, 0.1, 0], "body/cubes/0/position", "'a' reaches 0.1 m below the ground"),
        ("sensors", [{"type": "up", "cube": "aa"}], "sensors/0/cube", "there is no cube 'aa'; did you mean a?"),
        ("sensors", [{"type": "up", "cube": "x*"}], "sensors/0/cube", "no cube fits 'x*'"),
        ("sensors", [{"type": "up"}], "sensors/0", "must have either a joint or a cube"),
        ("sensors", [{"type": "up", "joint": "hip"}], "sensors/0/type", "a joint has no sensor 'up', only position"),
        ("sensors", [{"type": "height", "cube": "a", "axis": "x"}], "sensors/0/axis", "height is one number"),
        ("sensors", [{"type": "height", "cube": "*", "id": "h"}], "sensors/0/id", "'*' fits 2 cubes"),
        ("sensors", [{"type": "height", "cube": "*"}] * 2, "sensors/1", "there is a sensor 'a.height' already"),
    ],
)  # fmt: skip
def test_a_mistake_in_a_genome_is_reported_with_its_path(path: str, value: Any, place: str, message: str) -> None:
    findings = problems(changed(path, value))
    assert any(at == place and message in words for at, words in findings), findings


def test_cubes_that_overlap_must_be_joined() -> None:
    document = changed("body/cubes/2", {"id": "c", "size": 0.2, "mass": 1, "position": [0.5, 0.35, 0]})
    document["body"]["joints"].append(LINK)
    assert problems(document) == [("body/cubes/2", "'b' and 'c' overlap by 0.05 m, and no joint joins them")]
    document["body"]["joints"][1]["cube1"] = "b"
    assert len(Genome(document).body.cubes) == 3


@given(st.floats(0, 0.2), st.floats(0, math.tau), st.floats(0, math.tau), st.booleans())
@settings(max_examples=60, deadline=None)
def test_overlap_of_rotated_boxes_is_exact(gap: float, turn: float, tilt: float, apart: bool) -> None:
    """Two boxes face to face, a gap or an overlap between them, turned together."""
    if gap < 2e-4:
        return
    document = changed("body/joints/0", {**LINK, "cube2": "b", "type": "fixed"})
    middle, cubes = np.array([0.0, 3.0, 0.0]), document["body"]["cubes"]
    axis = np.array([math.cos(turn) * math.cos(tilt), math.sin(tilt), -math.sin(turn) * math.cos(tilt)])
    way = axis * (0.4 + (gap if apart else -gap))
    cubes[0] |= {"position": middle.tolist(), "rotation": [0, turn, tilt]}
    cubes[1] |= {"position": (middle + way).tolist(), "rotation": [0, turn, tilt]}
    far = {"id": "far", "size": 0.1, "mass": 1, "position": [0, 8, 0]}
    document["body"]["cubes"].append(far)
    document["body"]["joints"] = [{**LINK, "id": f"j{i}", "cube1": name, "cube2": "far"} for i, name in enumerate("ab")]
    if apart:
        Genome(document)
    else:
        ((place, message),) = problems(document)
        assert place == "body/cubes/1" and f"overlap by {gap:.3g} m" in message


def test_all_mistakes_of_a_genome_are_reported_at_once() -> None:
    document = changed("body/cubes/0/size", -1)
    document["body"]["joints"][0]["motor"]["mode"], document["extra"] = "force", 1
    assert {at for at, _ in problems(document)} == {"body/cubes/0/size", "body/joints/0/motor/mode", "extra"}
    document = changed("body/cubes/2", C)
    document["body"]["joints"][0] |= {"cube2": "z", "limits": [1, 0]}
    document["sensors"] = [{"type": "touch", "cube": "y"}]
    assert [at for at, _ in problems(document)] == [
        "body/joints/0/limits", "body/joints/0/cube2", "body/cubes/1", "body/cubes/2", "sensors/0/cube",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "document", [None, 3, [], {}, {"body": 1}, {"body": {"cubes": [1]}}, {"name": float("nan")}, {"x": object()}]
)
def test_a_document_that_is_no_genome_is_refused(document: Any) -> None:
    assert problems(document)


@pytest.mark.parametrize("text", [b"", b"{", b'{"a":1,"a":2}', b"\xff", b"[1e999]"])
def test_genome_files_must_be_strict_json(text: bytes) -> None:
    with pytest.raises(DocumentError):
        Genome.parse(text)


def test_a_brain_must_fit_the_body() -> None:
    document = {**pair(), "brain": {"kind": "sine", "oscillators": [{"motor": "hipp"}]}}
    with pytest.raises(DocumentError, match="did you mean hip"):
        Genome(document).brain()
    with pytest.raises(DocumentError, match="has no brain"):
        Genome(pair()).brain()
    document["brain"]["oscillators"][0]["motor"] = "*"
    brain = Genome(document).brain()
    assert list(brain.outputs) == ["hip"]


# -- what a genome is -------------------------------------------------------------------------------------------------


def test_a_brain_is_checked_as_often_as_one_asks() -> None:
    Genome(pair()).check_brain()  # there is none, and none that is bad
    bad = Genome({**pair(), "brain": {"kind": "sine", "oscillators": [{"motor": "nobody", "frequency": 1}]}})
    for _ in range(2):
        with pytest.raises(DocumentError, match="there is no motor 'nobody'"):
            bad.check_brain()
    good = Genome.load("walker")
    for _ in range(2):
        good.check_brain()


def test_equal_documents_have_equal_hashes() -> None:
    genome = Genome(pair())
    text = json.dumps(pair(), indent=3, sort_keys=True).replace('"mass": 1', '"mass": 1.0')
    assert Genome.parse(text.encode()).hash == genome.hash == Genome(genome.document).hash
    assert len(genome.hash) == 64
    for other in (changed("name", "other"), changed("body/cubes/0/mass", 1.5), changed("body/cubes/0/friction", 1)):
        assert Genome(other).hash != genome.hash
    # Canonical JSON and SHA-256, as the page says: anybody can compute it.
    small = {"format": "nmes-genome/1", "name": "é", "body": {"cubes": [C]}}
    canonical = (
        '{"body":{"cubes":[{"id":"c","mass":1,"position":[0,0.2,0.3],"size":0.2}]},"format":"nmes-genome/1","name":"é"}'
    )
    assert Genome(small).hash == hashlib.sha256(canonical.encode()).hexdigest()


def test_reading_a_genome_does_not_change_the_document() -> None:
    document = pair()
    before = copy.deepcopy(document)
    genome = Genome(document)
    genome.document["body"].clear()
    document["name"] = "changed"
    assert genome.document == before


def test_creatures_of_one_body_share_it_and_others_do_not() -> None:
    document = pair()
    body = Genome(document).body
    swinging = {"kind": "sine", "oscillators": [{"motor": "*", "frequency": 1, "amplitude": 1}]}
    assert Genome({**document, "name": "other", "brain": swinging}).body is body
    heavier = copy.deepcopy(document)
    heavier["body"]["cubes"][0]["mass"] = 2
    assert Genome(heavier).body.mass == body.mass + 1
    assert Genome({**document, "sensors": []}).body.sensors == ()
    assert Genome(document).body.sensors == body.sensors != ()


def test_what_a_body_senses_by_default_follows_from_it() -> None:
    sensors = [sensor.id for sensor in Genome(pair()).body.sensors]
    assert sensors[:3] == ["hip.position", "hip.velocity", "a.height"]
    assert len(sensors) == 12


def test_sensor_patterns_match_the_body_s_parts() -> None:
    findings = Genome(
        {**pair(), "sensors": [{"type": "spin", "cube": "?", "axis": "y"}, {"type": "effort", "joint": "h*"}]}
    )
    assert [sensor.id for sensor in findings.body.sensors] == ["a.spin.y", "b.spin.y", "hip.effort"]


# -- graphs -----------------------------------------------------------------------------------------------------------


def graph(*connections: Document, root: str = "body", **parts: Any) -> Document:
    """A graph: parts by name, each [size, recursive_limit]."""
    part_documents = [
        {"id": name, "size": size, "recursive_limit": limit, "joint": {"type": "hinge"}}
        for name, (size, limit) in parts.items()
    ]
    return {"root": root, "parts": part_documents, "connections": list(connections)}


def grown(document: Document) -> Genome:
    return Genome({"format": "nmes-genome/1", "name": "grown", "body": {"graph": document}})


def test_a_recursive_part_repeats_up_to_its_limit() -> None:
    body = grown(graph({"from": "body", "to": "body", "face": "+x", "scale": 0.5}, body=([1, 0.4, 0.4], 3))).body
    assert [cube.id for cube in body.cubes] == ["body", "body.2", "body.3"]
    assert [cube.size for cube in body.cubes] == [(1, 0.4, 0.4), (0.5, 0.2, 0.2), (0.25, 0.1, 0.1)]
    assert [cube.position[0] for cube in body.cubes] == pytest.approx([0.5, 1.25, 1.625])
    assert [cube.mass for cube in body.cubes] == pytest.approx([80, 10, 1.25])
    assert [(joint.id, joint.cube1, joint.cube2) for joint in body.joints] == [
        ("body.2", "body", "body.2"), ("body.3", "body.2", "body.3"),
    ]  # fmt: skip
    assert body.bounds[0][1] == pytest.approx(0)


@pytest.mark.parametrize(
    ("face", "at", "place"),
    [
        ("+x", [0, 0], (1.0, 0, 0)),
        ("-x", [0, 0], (-1.0, 0, 0)),
        ("+y", [0, 0], (0, 0.7, 0)),
        ("-y", [0.5, 0], (0.25, -0.7, 0)),
        ("+z", [0, 1], (0, 0.2, 0.8)),
        ("-z", [-1, 0], (-0.5, 0, -0.8)),
    ],
)
def test_a_part_grows_away_from_the_face_that_it_stands_on(face: str, at: list[float], place: Any) -> None:
    body = grown(
        graph({"from": "body", "to": "leg", "face": face, "at": at}, body=([1, 0.4, 0.6], 1), leg=([1, 0.2, 0.2], 1))
    ).body
    root, leg = body.cubes
    assert np.subtract(leg.position, root.position).tolist() == pytest.approx(place)
    axis = "xyz".index(face[1])
    low, high = body.bounds
    assert high[axis] - low[axis] == pytest.approx([1, 0.4, 0.6][axis] + 1)


def test_mirrored_parts_are_mirror_images_and_move_as_such() -> None:
    document = graph(
        {"from": "body", "to": "hip", "face": "+z", "at": [0.5, 0], "rotation": [0.2, 0.3, 0.1], "mirror": "z"},
        {"from": "hip", "to": "leg", "face": "-y", "at": [0.8, 0.1], "rotation": [0, 0.4, 0.2]},
        body=([1, 0.3, 0.5], 1),
        hip=([0.4, 0.2, 0.2], 1),
        leg=([0.5, 0.1, 0.1], 1),
    )  # fmt: skip
    for part in document["parts"][1:]:
        part["joint"] = {
            "type": "hinge", "axis": [0.3, 1, 0.4], "motor": {"mode": "position", "range": [-1, 1], "max_effort": 500}
        }  # fmt: skip
    genome = grown(document)
    assert [cube.id for cube in genome.body.cubes] == ["body", "hip", "leg", "hip.mirror", "leg.mirror"]
    assert [(j.id, j.cube1) for j in genome.body.joints][2:] == [("hip.mirror", "body"), ("leg.mirror", "hip.mirror")]
    world = World({"mode": "lockstep", "gravity": [0, 0, 0]})
    client = world.join()
    world.execute(client, {"type": "spawn_creature", "genome": genome.document, "name": "t", "position": [0, 9, 0]})
    world.drive(client, "t", np.array([0.4, -0.3, 0.4, -0.3]))
    for _ in range(120):
        world.tick()
    names, states = world.poses()
    middle = states[0, 2]
    for one, other in (("t.hip", "t.hip.mirror"), ("t.leg", "t.leg.mirror")):
        left, right = states[names.index(one)], states[names.index(other)]
        assert left[:2].tolist() == pytest.approx(right[:2].tolist(), abs=1e-5)
        assert left[2] - middle == pytest.approx(middle - right[2], abs=1e-5)
        qx, qy, qz, qw = left[3:7]
        assert abs(float(np.dot(right[3:7], (-qx, -qy, qz, qw)))) == pytest.approx(1, abs=1e-5)


def test_mirrored_parts_of_mirrored_parts_have_unique_names() -> None:
    document = graph(
        {"from": "body", "to": "side", "face": "+x", "mirror": "x"},
        {"from": "side", "to": "leg", "face": "+z", "mirror": "z"},
        body=(0.4, 1), side=(0.2, 1), leg=([0.5, 0.1, 0.1], 1),
    )  # fmt: skip
    body = grown(document).body
    assert [cube.id for cube in body.cubes] == [
        "body", "side", "leg", "leg.mirror", "side.mirror", "leg.2.mirror", "leg.2",
    ]  # fmt: skip
    assert {joint.id: joint.cube1 for joint in body.joints} == {
        "side": "body", "leg": "side", "leg.mirror": "side",
        "side.mirror": "body", "leg.2": "side.mirror", "leg.2.mirror": "side.mirror",
    }  # fmt: skip


def test_terminal_parts_grow_at_the_end_only() -> None:
    document = graph(
        {"from": "body", "to": "body", "face": "+x"},
        {"from": "body", "to": "hand", "face": "+y", "terminal": True},
        body=(0.4, 4), hand=(0.2, 1),
    )  # fmt: skip
    body = grown(document).body
    assert [(joint.cube1, joint.cube2) for joint in body.joints if joint.cube2.startswith("hand")] == [
        ("body.4", "hand")
    ]


def test_scaling_a_part_scales_its_limits_springs_and_effort() -> None:
    document = graph({"from": "body", "to": "leg", "face": "+x", "scale": 2}, body=(1, 1), leg=(0.5, 1))
    document["parts"][1]["joint"] = {
        "type": "slide",
        "limits": [-0.1, 0.2],
        "stiffness": 3,
        "motor": {"mode": "position", "range": [0, 0.1], "max_effort": 7},
    }
    (joint,) = grown(document).body.joints
    assert (joint.limits, joint.stiffness, joint.motor.max_effort if joint.motor else 0) == ((-0.2, 0.4), 24, 56)


def link(face: str, end: str = "body", **more: Any) -> Document:
    return {"from": "body", "to": end, "face": face, **more}


@pytest.mark.parametrize(
    ("document", "place", "message"),
    [
        (graph(root="boddy", body=(1, 1)), "root", "there is no part 'boddy'"),
        (graph(link("+x", "x"), body=(1, 1)), "connections/0/to", "no part 'x'"),
        (graph(link("up"), body=(1, 1)), "connections/0/face", "expected one of"),
        (graph(link("+x", at=[2, 0]), body=(1, 1)), "connections/0/at/0", "expected a number from -1 to 1"),
        (graph(link("+x", scale=5), body=(1, 3)), "", "grows part 'body', 3 times over, to an edge of 25 m"),
        (graph(link("+y"), link("+z"), body=(0.1, 20)), "", f"more than {MOST_CUBES} cubes"),
        (
            graph(link("+y", "leg", mirror="z"), body=(1, 1), leg=(0.3, 1)),
            "",
            "'leg' and 'leg.mirror' overlap by 0.3 m",
        ),
    ],
)
def test_a_graph_that_cannot_grow_is_refused_with_the_reason(document: Document, place: str, message: str) -> None:
    findings, place = problems_of_graph(document), f"body/graph/{place}".rstrip("/")
    assert any(at == place and message in words for at, words in findings), findings


def problems_of_graph(document: Document) -> list[tuple[str, str]]:
    with pytest.raises(DocumentError) as caught:
        grown(document)
    return list(caught.value.problems)


def test_a_graph_that_grows_without_end_is_refused_quickly() -> None:
    faces = ("+x", "+y", "-y", "+z", "-z")
    many = [{"from": "body", "to": "body", "face": face, "mirror": "z"} for face in faces]
    assert "more than" in problems_of_graph(graph(*many, body=(0.1, 64)))[0][1]


_numbers = st.floats(-1, 1).map(lambda value: round(value, 3))
_connection = st.fixed_dictionaries(
    {
        "from": st.sampled_from("abc"),
        "to": st.sampled_from("abc"),
        "face": st.sampled_from(["+x", "-x", "+y", "-y", "+z", "-z"]),
        "at": st.tuples(_numbers, _numbers).map(list),
        "rotation": st.tuples(_numbers, _numbers, _numbers).map(list),
        "scale": st.floats(0.5, 1.2).map(lambda value: round(value, 3)),
    },
    optional={"mirror": st.sampled_from("xyz"), "terminal": st.booleans()},
)
_motor = {"mode": "position", "range": [-0.5, 0.5], "max_effort": 5}
_part = st.fixed_dictionaries(
    {
        "size": st.tuples(*[st.floats(0.05, 0.5).map(lambda value: round(value, 3))] * 3).map(list),
        "recursive_limit": st.integers(1, 4),
        "joint": st.sampled_from(
            [{"type": "fixed"}, {"type": "pin"}, {"type": "hinge", "motor": _motor}, {"type": "slide", "motor": _motor}]
        ),
    }
)
_graph = st.builds(
    lambda parts, connections: {
        "root": "a",
        "parts": [{"id": name, **part} for name, part in zip("abc", parts, strict=True)],
        "connections": connections,
    },
    st.tuples(_part, _part, _part),
    st.lists(_connection, max_size=6),
)


@given(_graph)
@settings(max_examples=120, deadline=None)
def test_any_graph_grows_into_a_valid_body_or_is_refused_with_the_reason(document: Document) -> None:
    try:
        genome = grown(document)
    except DocumentError as error:
        assert error.problems and all(words for _, words in error.problems)
        return
    body = genome.body
    assert len(body.joints) == len(body.cubes) - 1 < MOST_CUBES
    assert body.bounds[0][1] == pytest.approx(0, abs=1e-6)
    assert genome.expanded().body == body
    assert grown(copy.deepcopy(document)).body == body
    world = World({"mode": "lockstep"})
    client = world.join()
    reply = world.execute(client, {"type": "spawn_creature", "genome": genome.document, "name": "c"})
    assert reply["type"] == "creature_spawned", reply
    creature = world.creature("c")
    for _ in range(3):
        world.drive(client, "c", np.full(len(creature.motors), 0.5))
        world.tick()
    assert world.fault is None
    assert np.isfinite(creature.sense()).all()


def test_a_graph_grows_the_same_in_every_process() -> None:
    """Random graphs, in fresh processes with other seeds of hashing."""
    code = (
        "import random, sys, hashlib, json\n"
        "from nmes.errors import DocumentError\nfrom nmes.genome import Genome\n"
        "r, total = random.Random(5), hashlib.sha256()\n"
        "for n in range(60):\n"
        "    parts = [{'id': i, 'size': [r.uniform(.05, .5) for _ in 'xyz'], 'recursive_limit': r.randint(1, 4),"
        " 'joint': {'type': r.choice(['hinge', 'slide'])}} for i in 'abc']\n"
        "    links = [{'from': r.choice('abc'), 'to': r.choice('abc'), 'face': r.choice('+-') + r.choice('xyz'),"
        " 'at': [r.uniform(-1, 1), r.uniform(-1, 1)], 'rotation': [r.uniform(-2, 2) for _ in 'xyz'],"
        " 'scale': r.uniform(.4, 1.1), **({'mirror': r.choice('xyz')} if r.random() < .5 else {})} for _ in range(4)]\n"
        "    try:\n"
        "        graph = {'root': 'a', 'parts': parts, 'connections': links}\n"
        "        g = Genome({'format': 'nmes-genome/1', 'name': 'x', 'body': {'graph': graph}})\n"
        "        total.update(json.dumps(g.expanded().document).encode())\n"
        "    except DocumentError as error:\n"
        "        total.update(error.message.encode())\n"
        "print(total.hexdigest())"
    )
    runs = {
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={"PYTHONHASHSEED": seed}
        ).stdout
        for seed in ("0", "7")
    }
    assert len(runs) == 1


def test_an_expanded_genome_expands_to_itself() -> None:
    document = graph(
        {"from": "body", "to": "body", "face": "+x", "rotation": [0.1, 0.2, 0.3]}, body=([0.3, 0.2, 0.1], 9)
    )
    assert read_body(grow(document), None, place="body/graph")[1] == grown(document).expanded().body


# -- files and names --------------------------------------------------------------------------------------------------


def test_genomes_are_loaded_by_file_or_name(tmp_path: Path) -> None:
    path = tmp_path / "pair.json"
    path.write_text(json.dumps(pair()))
    assert Genome.load(path).hash == Genome(pair()).hash
    with pytest.raises(DocumentError, match=r"no genome 'walkr'.*did you mean walker\?"):
        Genome.load("walkr")
    with pytest.raises(DocumentError, match="nor such a file"):
        Genome.load(tmp_path)


def random_graph(seed: int) -> Document:
    """A graph of up to five parts, which may grow in circles, turned, scaled and mirrored anyhow."""
    choice = random.Random(seed)
    names = "abcde"[: choice.randint(1, 5)]
    parts: list[Document] = []
    for name in names:
        size = [round(choice.uniform(0.05, 0.6), 3) for _ in range(3)]
        part: Document = {"id": name, "size": size, "recursive_limit": choice.randint(1, 5)}
        kind = choice.choice(["fixed", "hinge", "slide", "conetwist", "pin", None])
        if kind:
            part["joint"] = {"type": kind}
            if choice.random() < 0.5:
                part["joint"]["axis"] = [choice.choice([-1, 0, 0.5, 1]), 1, choice.random()]
            if kind in ("hinge", "slide") and choice.random() < 0.7:
                part["joint"]["motor"] = {"mode": "position", "range": [-choice.random(), 1], "max_effort": 10}
        parts.append(part)
    connections: list[Document] = []
    for _ in range(choice.randint(0, 7)):
        ends = {"from": choice.choice(names), "to": choice.choice(names)}
        connection: Document = {**ends, "face": choice.choice(["+x", "-x", "+y", "-y", "+z", "-z"])}
        if choice.random() < 0.5:
            connection["at"] = [choice.uniform(-1, 1), choice.uniform(-1, 1)]
        if choice.random() < 0.5:
            connection["rotation"] = [choice.uniform(-2, 2) for _ in range(choice.choice([3, 4]))]
        if choice.random() < 0.5:
            connection["scale"] = choice.choice([0.8, 0.9, 1.1, 0.7])
        if choice.random() < 0.4:
            connection["mirror"] = choice.choice("xyz")
        if choice.random() < 0.2:
            connection["terminal"] = True
        connections.append(connection)
    return {"root": names[0], "parts": parts, "connections": connections}


def test_graphs_grow_as_they_did_when_each_cube_was_carried_by_itself_to_the_last_bit() -> None:
    total = hashlib.sha256()
    for seed in range(100):
        try:
            total.update(json.dumps(grow(random_graph(seed))).encode())
        except DocumentError:
            total.update(b"refused")
    assert total.hexdigest() == "cdb0ddeb7206ac0a33a1c48f5e1d3d3388d999d390269c0abe0aee6b7db3164c"
