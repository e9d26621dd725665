"""Worlds that are created and closed over the wire: by whom, from what, how many, and how they are listed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st

from nmes import AsyncClient, Client
from nmes.cli import main
from nmes.errors import CommandFailed, Disconnected, WorldError
from nmes.playback import replay
from nmes.protocol import validate_reply
from nmes.recording import Recording
from nmes.server.catalog import PAGE, Catalog
from processes import process, ready
from servers import PASSWORD, PATIENCE, Served, served, types

PLAIN = {"backend": "ballistic", "mode": "lockstep"}
TEMPLATES: dict[str, dict[str, Any]] = {
    "default": PLAIN,
    "moon": {**PLAIN, "gravity": [0, -1.62, 0], "seed": 7},
    "broken": {"backend": "ballistic", "scene": {"type": "heightfield"}},
}
MAKERS = {"ann": "the word of ann", "bob": "the word of bob"}


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Served]:
    options: dict[str, Any] = {"makers": MAKERS, "catalog": Catalog(TEMPLATES, most=5, most_each=2)}
    with served({"name": "first"}, record_to=tmp_path, passwords={"first": "of first"}, **options) as running:
        yield running


def code(server: Served, password: str, verb: str, *arguments: Any, **options: Any) -> str:
    """Returns the code with which a host refuses to do something."""
    with pytest.raises(CommandFailed) as refused:
        getattr(server.client(password=password), verb)(*arguments, **options)
    return refused.value.code


def names(client: Client) -> list[str]:
    return [world["world"] for world in client.worlds()]


# -- created ---------------------------------------------------------------------------------------------------------


def test_a_created_world_is_one_like_any_other(server: Served, tmp_path: Path) -> None:
    asker = server.client()
    told = asker.create_world("red", template="moon")
    assert (told["world"], told["port"], told["frame"], told["backend"]) == ("red", server.port, 0, "ballistic")
    assert names(asker) == ["first", "red"]
    with server.client(world="red") as client:
        info = client.get_world_info()
        assert (info["config"]["gravity"], info["seed"]) == ([0, -1.62, 0], 7)
        client.step(3)
    assert asker.create_world("green", seed=99)["world"] == "green"
    with server.client(world="green") as client:
        assert client.get_world_info()["seed"] == 99
    asker.close_world("red")
    (recording,) = tmp_path.glob("red-*.mcap")
    assert replay(recording).verdict == "reproduced" and Recording(recording).complete


async def test_an_awaiting_client_creates_and_closes(server: Served) -> None:
    asker = AsyncClient(port=server.port, password=PASSWORD, timeout=PATIENCE)
    assert (await asker.create_world("red"))["world"] == "red"
    assert [world["world"] for world in await asker.close_world("first")] == ["red"]


def test_the_answer_is_one_valid_message_and_then_the_connection_ends(server: Served) -> None:
    with server.peer(None) as peer:
        peer.say({"type": "auth", "password": PASSWORD, "create": {"world": "red"}, "id": 5}, {"type": "ping"})
        (answer,) = map(json.loads, peer.rest())
    validate_reply(answer)
    assert (answer["type"], answer["id"], len(answer["worlds"])) == ("world_list", 5, 1)


@pytest.mark.parametrize(
    ("asked", "expected", "says"),
    [
        ({"world": "first"}, "world_exists", "a world 'first' already"),
        ({"world": "red", "template": "mooon"}, "template_not_found", "no template 'mooon'; did you mean moon?"),
        ({"world": "red", "template": "broken"}, "world_unavailable", "no scenery"),
        ({"world": "two words"}, "invalid", "create/world"),
        ({"template": "moon"}, "invalid", "world"),
        ({"world": "red", "seed": -1}, "invalid", "seed"),
        ({"world": "red", "seed": True}, "invalid", "seed"),
        ("red", "invalid", "create"),
    ],
)
def test_who_asks_for_a_world_that_cannot_be_is_told_why(server: Served, asked: Any, expected: str, says: str) -> None:
    with server.peer(None) as peer:
        peer.say({"type": "auth", "password": PASSWORD, "create": asked})
        (answer,) = map(json.loads, peer.rest())
    validate_reply(answer)
    assert answer["code"] == expected and says in answer["message"]
    assert names(server.client()) == ["first"]
    assert server.client().create_world("red")["world"] == "red"  # the name is free


def test_a_world_may_have_the_longest_name_there_is(server: Served, tmp_path: Path) -> None:
    name = "𐎠" * 128
    server.client().create_world(name)
    server.client().close_world(name)
    assert len([path for path in tmp_path.iterdir() if path.name.startswith("𐎠")]) == 1


# -- who may, and how many -------------------------------------------------------------------------------------------


def test_a_maker_may_create_close_enter_and_see_his_own_worlds_and_no_others(server: Served) -> None:
    ann, bob = server.client(password=MAKERS["ann"]), server.client(password=MAKERS["bob"])
    assert names(ann) == []
    ann.create_world("red")
    bob.create_world("blue")
    assert (names(ann), names(bob), names(server.client())) == (["red"], ["blue"], ["first", "red", "blue"])
    with server.client(password=MAKERS["ann"]) as client:  # who names none gets his first
        assert client.welcome["world"] == "red"
    assert code(server, MAKERS["ann"], "create_world", "blue") == "world_exists"
    for other in ("blue", "first", "none"):
        assert code(server, MAKERS["ann"], "close_world", other) == "world_not_found"
        with pytest.raises(CommandFailed) as refused:
            server.client(password=MAKERS["ann"], world=other).connect()
        assert refused.value.code == "auth_failed"
    assert ann.close_world("red") == []
    assert names(server.client()) == ["first", "blue"]


def test_neither_a_guess_nor_the_password_of_a_world_creates_any(server: Served) -> None:
    for password in ("guess", "of first"):
        assert code(server, password, "create_world", "red") == "auth_failed"
    with server.peer(None) as peer:
        peer.say({"type": "auth", "password": "guess", "create": {"world": "red"}, "list": True})
        assert types(peer.rest()) == ["error"]
    assert names(server.client()) == ["first"]


def test_limits_are_of_each_maker_and_of_all_and_end_with_a_world(server: Served) -> None:
    for name, word in MAKERS.items():
        for number in (1, 2):
            server.client(password=word).create_world(f"{name}-{number}")
    assert code(server, MAKERS["ann"], "create_world", "ann-3") == "limit_reached"
    assert code(server, PASSWORD, "create_world", "sixth") == "limit_reached"
    server.client(password=MAKERS["ann"]).close_world("ann-1")
    assert code(server, MAKERS["bob"], "create_world", "bob-3") == "limit_reached"  # there is room, but not for him
    server.client(password=MAKERS["ann"]).create_world("ann-3")
    server.client().close_world("first")
    server.client().create_world("fifth")
    assert names(server.client()) == ["ann-2", "bob-1", "bob-2", "ann-3", "fifth"]


# -- the list --------------------------------------------------------------------------------------------------------


def test_a_long_list_comes_in_pages_and_clients_put_them_together() -> None:
    many = [f"w{number}" for number in range(2 * PAGE + 3)]
    with served(*({"name": name} for name in many), lazy=True) as server:
        assert names(server.client()) == many
        sizes: list[int] = []
        start: int | None = 0
        while start is not None:
            with server.peer(None) as peer:
                peer.say({"type": "auth", "password": PASSWORD, "list": True, "start": start})
                (answer,) = map(json.loads, peer.rest())
            validate_reply(answer)
            sizes.append(len(answer["worlds"]))
            start = answer["next"]
        assert sizes == [PAGE, PAGE, 3]
        assert len(server.client().close_world("w7")) == len(many) - 1


def test_a_server_whose_list_does_not_end_keeps_nobody(server: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    endless = {"type": "world_list", "worlds": [], "next": 5}
    monkeypatch.setattr(type(server.host), "list_worlds", lambda *_: endless)
    assert server.client().worlds() == []


@settings(max_examples=15)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 9)), max_size=60), st.integers(0, 60))
def test_pages_hold_nothing_twice_and_leave_out_nothing_that_stays(steps: list[tuple[bool, int]], turn: int) -> None:
    catalog = Catalog({}, 10_000, 10_000)
    for number in range(PAGE + 5):
        catalog.add({"name": f"old-{number}"})
    listed, start = [offer.name for offer in catalog.page(0)[0]], catalog.page(0)[1]
    made = 0
    for index, (creates, number) in enumerate(steps):
        if index == turn:
            break
        if creates:
            made += 1
            catalog.add({"name": f"new-{made}"})
        elif f"old-{number * 100 + 3}" in catalog:
            catalog.remove(f"old-{number * 100 + 3}")
    while start is not None:
        page, start = catalog.page(start)
        listed += [offer.name for offer in page]
    assert len(listed) == len(set(listed))
    assert {offer.name for offer in catalog.page(0)[0]} <= set(listed)
    assert all(f"new-{number}" in listed for number in range(1, made + 1))


def test_makers_are_counted_each_by_himself() -> None:
    catalog = Catalog({}, 4, 1)
    catalog.add({"name": "a"}, "ann")
    with pytest.raises(WorldError, match="as many as one maker may"):
        catalog.add({"name": "b"}, "ann")
    catalog.add({"name": "b"}, "bob")
    catalog.remove("a")
    assert catalog.add({"name": "c"}, "ann").number == 3


# -- the command line ------------------------------------------------------------------------------------------------


def run(*arguments: str, password: str = PASSWORD) -> Result:
    return CliRunner().invoke(main, arguments, env={"NMES_PASSWORD": password})


def test_nmes_serve_has_templates_makers_and_one_port_for_many(tmp_path: Path) -> None:
    templates, makers = tmp_path / "templates", tmp_path / "makers"
    templates.mkdir()
    makers.mkdir()
    (templates / "moon.json").write_text(json.dumps(TEMPLATES["moon"]))
    (makers / "ann").write_text(MAKERS["ann"])
    (makers / "..data").mkdir()  # as Kubernetes mounts a Secret
    (makers / ".keep").touch()
    options = ["--templates", str(templates), "--makers", str(makers), "--max-worlds", "32", "--max-worlds-each", "1"]
    many = ["--worlds", "30", "--port-step", "0", "--port", "0", "--backend", "ballistic", "--mode", "lockstep"]
    with process("serve", "--no-record", *many, *options, NMES_PASSWORD=PASSWORD) as server:
        assert server.stdout is not None
        head = server.stdout.readline()
        assert head.startswith("30 worlds, 'main-1' to 'main-30', on 127.0.0.1:")
        address = head.split(" on ")[1].split(": ")[0]
        listed = json.loads(run("worlds", address, "--json").output)
        assert len(listed) == 30 and len({world["port"] for world in listed}) == 1
        shown = run("worlds", address, "--create", "red", "--template", "moon", password=MAKERS["ann"])
        assert shown.exit_code == 0 and shown.output.splitlines()[1].split()[0] == "red"
        refused = run("worlds", address, "--create", "blue", password=MAKERS["ann"])
        assert refused.exit_code == 1 and "ann has 1 worlds here" in refused.output
        assert run("worlds", address, "--create", "eco", "--template", "ecosystem").exit_code == 0  # one that ships
        assert "as many as it may" in run("worlds", address, "--create", "more").output
        with Client(port=int(address.split(":")[1]), password=MAKERS["ann"], world="red", timeout=PATIENCE) as client:
            assert client.get_world_info()["seed"] == 7
        assert run("worlds", address, "--create", "x", "--close").exit_code == 2
        assert run("worlds", address, "--template", "moon").exit_code == 2
        server.terminate()
        rest = server.communicate(timeout=PATIENCE)[0].splitlines()
        assert server.returncode == 0 and len(rest) < 8


def test_scripts_are_told_how_many_worlds_there_are() -> None:
    many = ["--worlds", "30", "--port-step", "0", "--port", "0", "--backend", "ballistic"]
    with process("serve", "--json", "--no-record", *many, NMES_PASSWORD=PASSWORD) as server:
        line = ready(server)
        assert line["world_count"] == 30 and "worlds" not in line
        with Client(port=line["port"], password=PASSWORD, world="main-30", timeout=PATIENCE) as client:
            assert client.welcome["world"] == "main-30"


@pytest.mark.parametrize(
    ("file", "text", "says"),
    [
        ("bad.json", "{", "bad.json"),
        ("bad.json", '{"substeps": 0}', "substeps"),
        ("default.json", "{}", "default.json"),
        ("ann", PASSWORD, "opens something else already"),
        ("ann", "", "is empty"),
    ],
)
def test_a_folder_that_does_not_fit_is_refused(file: str, text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / file).write_text(text)
    option = "--templates" if file.endswith(".json") else "--makers"
    outcome = run("serve", "--port", "0", "--no-record", option, str(tmp_path))
    assert outcome.exit_code == 2 and says in outcome.output and "Traceback" not in outcome.output


def test_more_worlds_than_there_may_be_are_refused() -> None:
    outcome = run("serve", "--no-record", "--worlds", "30", "--max-worlds", "20", "--port-step", "0")
    assert outcome.exit_code == 2 and "30 worlds are more than --max-worlds 20 allows" in outcome.output


def test_a_host_that_cannot_create_worlds_is_an_error(server: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    with server.client() as entered:
        welcome = entered.welcome
    monkeypatch.setattr(type(server.host), "list_worlds", lambda *_: welcome)
    with pytest.raises((CommandFailed, Disconnected)) as failed:
        server.client().create_world("red")
    assert failed.value.code == "unsupported"
