"""Numbers that callers give in Python, in whatever form: each public function takes them all, and refuses NaN."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nmes
from creatures import mlp, snake
from nmes.backend.arrays import floats
from nmes.errors import DocumentError, RejectedMessage, WorldError
from nmes.evaluation import Environments, Task
from nmes.evolution import Draw
from nmes.genome import Genome
from nmes.recording import Recorder, Recording
from nmes.world import World
from servers import served

Form = Callable[[Sequence[float]], Any]
FORMS: dict[str, Form] = {
    "float32": lambda values: np.array(values, np.float32),
    "float16": lambda values: np.array(values, np.float16),
    "big-endian": lambda values: np.array(values, ">f8"),
    "strided": lambda values: np.repeat(np.array(values), 2)[::2],
    "list": list,
    "tuple": tuple,
    "numpy scalars": lambda values: [np.float32(value) for value in values],
    "arrays of no dimension": lambda values: [np.array(value, np.float32) for value in values],
}
WHOLE: dict[str, Form] = {
    "int8": lambda values: np.array(values, np.int8),
    "uint16": lambda values: np.array(values, np.uint16),
    "ints": lambda values: [int(value) for value in values],
}
NO_NUMBERS = {
    "nan": [float("nan")] * 3,
    "numpy's nan": np.full(3, np.nan, np.float32),
    "inf": [float("inf")] * 3,
    "text": ["1", "0", "1"],
    "nothing": [None] * 3,
    "yes and no": np.array([True, False, True]),
    "complex": np.array([1j, 0, 0]),
    "ragged": [[1.0], 0.0, 1.0],
    "a number": 1.0,
}
HALVES = (0.5, -0.25, 1.0)  # which float16 has, too


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    world = World({"mode": "lockstep", "name": "w"})
    recorder = world.journal = Recorder(tmp_path / "run.mcap", world)
    yield world
    world.close()
    recorder.close()
    assert nmes.replay(Recording(tmp_path / "run.mcap")).verdict == "reproduced"


def enter(world: World) -> int:
    client = world.join()
    world.execute(client, {"type": "spawn_creature", "genome": snake(), "name": "c"})
    return client


def driven(world: World, form: Form, values: Sequence[float]) -> bytes:
    client = enter(world)
    for _ in range(3):
        world.drive(client, "c", form(values))
        world.tick()
    return world.digest()


@pytest.mark.parametrize("form", [*FORMS, *WHOLE])
def test_a_world_is_driven_with_any_row_of_numbers_and_its_recording_replays(world: World, form: str) -> None:
    values = (1.0, 0.0, 1.0) if form in WHOLE else HALVES
    plain = World({"mode": "lockstep", "name": "w"})
    assert driven(world, {**FORMS, **WHOLE}[form], values) == driven(plain, np.array, values)
    plain.close()


def test_a_single_is_driven_with_as_the_double_that_it_is(world: World) -> None:
    values = np.array([0.1, -0.3, 0.7], np.float32)
    plain = World({"mode": "lockstep", "name": "w"})
    wanted = driven(plain, lambda same: same, values.astype(float))  # type: ignore[arg-type]
    assert driven(world, lambda same: same, values) == wanted  # type: ignore[arg-type]
    assert wanted != driven(World({"mode": "lockstep", "name": "w"}), np.array, (0.1, -0.3, 0.7))
    plain.close()


@pytest.mark.parametrize("wrong", NO_NUMBERS)
def test_a_world_is_not_driven_with_what_is_no_row_of_numbers(world: World, wrong: str) -> None:
    client = enter(world)
    before = world.digest()
    with pytest.raises(WorldError) as refusal:
        world.drive(client, "c", NO_NUMBERS[wrong])
    where = {"invalid": "controls", "bad_json": "nothing that JSON has"}[refusal.value.code]
    assert where in refusal.value.message
    world.tick()
    idle = World({"mode": "lockstep", "name": "w"})
    enter(idle)
    assert idle.digest() == before
    idle.tick()
    assert world.digest() == idle.digest()
    idle.close()


@pytest.mark.parametrize("form", [*FORMS, *WHOLE])
def test_commands_in_this_process_take_any_numbers(world: World, form: str) -> None:
    make = {**FORMS, **WHOLE}[form]
    client = world.join()
    reply = world.execute(
        client, {"type": "spawn_cube", "cube_name": "a", "position": make([1, 2, 3]), "mass": make([2])[0]}
    )
    assert reply["type"] == "cube_list", reply
    assert world.execute(client, {"type": "get_cube_info", "cube_name": "a"})["position"] == [1.0, 2.0, 3.0]


def test_a_number_that_is_none_is_named_in_the_refusal_of_a_command(world: World) -> None:
    client = world.join()
    for wrong, text in ((float("nan"), "nan"), (np.float32("-inf"), "-inf"), (np.array(np.nan), "nan")):
        reply = world.execute(client, {"type": "spawn_cube", "position": [1, wrong, 3]})
        assert (reply["type"], reply["code"], reply["field"]) == ("error", "invalid", "position/1")
        assert reply["message"] == f"position/1: {text} is no number that JSON has"
    with pytest.raises(RejectedMessage, match="gravity/1: nan is no number"):
        World({"gravity": np.array([0, np.nan, 0])})
    with pytest.raises(DocumentError) as refusal:
        Genome({**snake(), "body": {"cubes": [{"id": "a", "mass": np.array([np.inf])}]}})
    assert list(refusal.value.problems) == [("body/cubes/0/mass/0", "inf is no number that JSON has")]


@pytest.mark.parametrize("form", FORMS)
def test_documents_take_any_numbers(form: str) -> None:
    expected, document = snake(), snake()
    for cube, plain in zip(document["body"]["cubes"], expected["body"]["cubes"], strict=True):
        plain["size"], plain["mass"] = [0.125, 0.0625, 0.25], 0.5
        cube["size"], cube["mass"] = FORMS[form]([0.125, 0.0625, 0.25]), FORMS[form]([0.5])[0]
    assert Genome(document).hash == Genome(expected).hash
    config = World({"gravity": FORMS[form]([0, -2.5, 0]), "tick_rate": np.array(30)}).config
    assert config["gravity"] == [0, -2.5, 0] and config["tick_rate"] == 30
    task = Task({**Task.load("walk").document, "duration": FORMS[form]([2.5])[0], "seeds": np.array([3, 1])})
    assert (task.duration, task.seeds) == (2.5, (3, 1))


@pytest.fixture(scope="module")
def environments() -> Environments:
    short = {**Task.load("walk").document, "name": "short", "duration": 1}
    return Environments(Genome(snake()), Task(short), 2, seeds=np.array([4, 9], np.int16))


@pytest.mark.parametrize("form", [*FORMS, *WHOLE])
def test_environments_take_any_numbers(environments: Environments, form: str) -> None:
    make, values = {**FORMS, **WHOLE}[form], (1.0, 0.0, 1.0) if form in WHOLE else HALVES
    begun = environments.reset(seed=5).copy()
    expected = environments.step(np.array([values, values]))[0].copy()
    seeds: list[Any] = [np.int64(5), [5, 6], np.array([5, 6]), (np.uint8(5), np.array(6)), np.array(5)]
    for seed in seeds:
        assert np.array_equal(environments.reset(seed=seed), begun)
    assert np.array_equal(environments.step([make(values), make(values)])[0], expected)
    environments.reset(seed=5)
    assert np.array_equal(environments.step(floats([values, values], "it").astype(np.float32))[0], expected)


@pytest.mark.parametrize("wrong", NO_NUMBERS)
def test_environments_do_not_move_with_what_is_no_number(environments: Environments, wrong: str) -> None:
    environments.reset(seed=5)
    with pytest.raises(ValueError, match="actions"):
        environments.step([NO_NUMBERS[wrong]] * 2)
    begun = environments.observations.copy()
    assert np.array_equal(environments.reset(seed=5), begun)


@pytest.mark.parametrize("wrong", [1.5, "1", [1.5, 2], [None, "2"], float("nan"), -1])
def test_environments_begin_with_no_other_seed_than_a_whole_number(environments: Environments, wrong: Any) -> None:
    with pytest.raises((TypeError, ValueError), match="seed"):
        environments.reset(seed=wrong)


@pytest.mark.parametrize("form", [*FORMS, *WHOLE])
def test_brains_take_any_numbers(form: str) -> None:
    make = {**FORMS, **WHOLE}[form]
    values = [0.5 * (i % 2) for i in range(16)] if form in FORMS else [float(i % 2) for i in range(16)]
    one, other = (Genome(snake(mlp(4))).brain() for _ in range(2))
    for brain in (one, other):
        brain.reset(1, 1 / 60)
    assert np.array_equal(one.step(make(values)), other.step(np.array(values)))
    parameters = one.to_vector()
    rounded = np.round(parameters * 4) / 4 if form in FORMS else np.abs(np.round(parameters))
    assert np.array_equal(one.with_vector(make(rounded.tolist())).to_vector(), rounded)


def test_draws_are_plain_numbers_whatever_their_bounds() -> None:
    seeds: list[Any] = [np.int64(3), np.array(3), 3]
    zero, one, two = (single(value) for value in (0.0, 1.0, 2.0))
    for seed in seeds:
        draw = Draw(seed, "a", seeds[0] + 4)
        assert draw.normals(2).tolist() == Draw(3, "a", 7).normals(2).tolist()
        assert type(draw.uniform(zero, one)) is float
        assert type(draw.normal(two)) is float and type(draw.count(np.array(0).item(), seeds[1])) is int
        assert draw.one_of("abc", [zero, one, zero]) == "b"
        assert draw.chance(one) is True
    draw = Draw(3)
    refused: list[Callable[[], object]] = [
        lambda: draw.uniform(float("nan"), 1.0),
        lambda: draw.chance(float("nan")),
        lambda: draw.normal(float("inf")),
        lambda: draw.one_of("abc", [1.0, float("nan"), 0.0]),
    ]
    for call in refused:
        with pytest.raises(ValueError, match="finite"):
            call()
    wrong: list[Any] = [1.5, float("nan"), "3"]
    for seed in wrong:
        with pytest.raises(TypeError):
            Draw(seed)


def single(value: float) -> Any:
    """Returns a number as a float32."""
    return np.float32(value)


@pytest.mark.parametrize("form", [*FORMS, *WHOLE])
def test_a_client_sends_any_numbers(form: str, client: nmes.Client) -> None:
    make = {**FORMS, **WHOLE}[form]
    name = client.spawn_cube(position=make([1, 2, 3]), mass=make([2])[0])["spawned"]
    assert client.get_cube_info(name)["position"] == [1.0, 2.0, 3.0]
    other = client.request({"type": "spawn_cube", "position": make([4, 5, 6])})["spawned"]
    assert client.get_cube_info(other)["position"] == [4.0, 5.0, 6.0]


@pytest.fixture(scope="module")
def client() -> Iterator[nmes.Client]:
    with served({"mode": "lockstep"}) as server, server.client() as connected:
        yield connected


def test_a_client_does_not_send_what_is_no_number(client: nmes.Client) -> None:
    numbers: list[Any] = [float("nan"), np.float32("inf"), np.array(np.nan)]
    for wrong in numbers:
        with pytest.raises(ValueError, match=r"position/1: (nan|inf) is no number"):
            client.spawn_cube(position=[1, wrong, 3])
    assert client.ping()["type"] == "pong"  # it goes on
