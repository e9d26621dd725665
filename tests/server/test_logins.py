"""Roles over the wire: which password leads to which, tokens by which players come back, and what stays secret."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from nmes import Client, protocol
from nmes.cli import main
from nmes.errors import CommandFailed
from nmes.playback import replay
from nmes.protocol import DELIMITER, EVENTS
from nmes.recording import Kind, Recording
from processes import process, ready
from role_programs import CONFIG, INTRUDER, OWNER, VICTIM, Play, program
from servers import PASSWORD, PATIENCE, Peer, Served, served

ROLES: dict[str, Any] = {"player": {}, "viewer": {}, "referee": {}}
WORDS = {"player": "for <players>", "viewer": "for viewers"}
OPEN = {"name": "open"}


@contextmanager
def playing(*more: dict[str, Any], record_to: Path | None = None, access_log: Path | None = None) -> Iterator[Served]:
    """Serves a world with roles, and others behind it."""
    configs = [{"name": "main", "roles": ROLES}, *more]
    with served(*configs, role_passwords=WORDS, record_to=record_to, access_log=access_log) as server:
        yield server


def enter(server: Served, password: str = PASSWORD, **fields: Any) -> tuple[Peer, dict[str, Any]]:
    """Returns a peer that has said `auth`, and the answer."""
    peer = Peer(server.port)
    return peer, peer.ask({"type": "auth", "password": password, **fields})


@pytest.mark.parametrize(
    ("password", "fields", "expected"),
    [
        (PASSWORD, {}, "owner"),
        (PASSWORD, {"role": "viewer"}, "viewer"),
        (PASSWORD, {"role": "referee"}, "referee"),
        (PASSWORD, {"role": "king"}, "role_not_found"),
        (WORDS["player"], {}, "player"),
        (WORDS["player"], {"role": "player"}, "player"),
        (WORDS["player"], {"role": "owner"}, "role_not_found"),
        (WORDS["player"], {"role": "viewer"}, "role_not_found"),
        (WORDS["viewer"], {"world": "main"}, "viewer"),
        (WORDS["viewer"], {"world": "open"}, "auth_failed"),
        (WORDS["viewer"], {"world": "nowhere"}, "auth_failed"),
        ("for <players", {}, "auth_failed"),
        ("", {}, "auth_failed"),
        (PASSWORD, {"world": "open", "role": "owner"}, "role_not_found"),
        (PASSWORD, {"world": "open", "token": "1-" + "0" * 64}, "auth_failed"),
        (WORDS["player"], {"close": "main"}, "auth_failed"),
    ],
)
def test_a_password_leads_to_its_role(password: str, fields: dict[str, Any], expected: str) -> None:
    with playing(OPEN) as server:
        peer, answer = enter(server, password, **fields)
        peer.socket.close()
        assert answer.get("role", answer.get("code")) == expected, answer


def test_the_raw_dialect_has_the_role_whose_password_it_says() -> None:
    with playing() as server, server.client() as owner:
        owner.spawn_cube("theirs")
        for word, expected in [(WORDS["player"], "not_allowed"), (PASSWORD, None)]:
            with Peer(server.port) as peer:
                peer.send(word.encode() + DELIMITER)
                assert peer.frame() == b"auth_success"
                peer.say({"type": "set_cube_state", "cube_name": "theirs", "position": [0, 5, 0]})
                assert peer.hear().get("code") == expected
                peer.say({"type": "set_color", "cube_name": "theirs", "color": [1, 0, 0]}, {"type": "get_cube_list"})
                assert peer.hear()["type"] == "cube_list"  # silent, refused or not


def test_an_open_world_tells_of_no_role() -> None:
    with playing(OPEN) as server:
        peer, answer = enter(server, world="open")
        peer.socket.close()
        assert {"role", "player", "token"}.isdisjoint(answer)


def test_a_token_makes_a_later_connection_the_same_players() -> None:
    with playing() as server, server.client(password=WORDS["player"]) as client:
        client.spawn_cube("mine")
        first = client.welcome
        assert (first["role"], first["player"]) == ("player", 1)
        client.reconnect()
        assert client.welcome == {**first, "client": first["client"] + 1}
        client.freeze_cube("mine", True)
        with server.client(password=WORDS["player"]) as stranger:
            assert stranger.welcome["player"] == 2 and stranger.token != client.token
            with pytest.raises(CommandFailed, match="the cube 'mine' belongs to player 1"):
                stranger.freeze_cube("mine", False)
            assert client.give(2, cube_name="mine") == {"type": "given", "player": 2, "cubes": ["mine"]}
            stranger.freeze_cube("mine", False)
            stranger.reconnect()
            assert stranger.get_cube_info("mine")["player"] == stranger.welcome["player"] == 2
        with server.client(token=client.token) as again:  # the host's password opens all roles
            assert (again.welcome["role"], again.welcome["player"]) == ("player", 1)


def test_a_token_is_good_for_its_player_role_and_world_alone() -> None:
    with playing({"name": "other", "roles": ROLES}) as server, server.client(password=WORDS["player"]) as client:
        token = str(client.token)
        code = token.partition("-")[2]
        second = server.client(password=WORDS["player"]).connect()
        attempts: list[tuple[str, dict[str, Any]]] = [
            (WORDS["viewer"], {"token": token}),
            (PASSWORD, {"token": token, "role": "viewer"}),
            (WORDS["player"], {"token": token, "world": "other"}),
            *((WORDS["player"], {"token": forged}) for forged in (f"2-{code}", f"01-{code}", "1-", "x", f"{token} ")),
            (WORDS["player"], {"token": f"1-{code[:-1]}{'0' if code[-1] != '0' else '1'}"}),
        ]
        for password, fields in attempts:
            peer, answer = enter(server, password, **fields)
            peer.socket.close()
            assert (answer.get("code"), answer.get("field")) == ("auth_failed", "token"), fields
            assert code not in json.dumps(answer)
        second.close()
        peer, answer = enter(server, WORDS["player"], token=token)
        peer.socket.close()
        assert answer["player"] == 1


def test_a_token_is_in_no_recording_log_or_answer(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    log = tmp_path / "access.log"
    with playing(record_to=tmp_path, access_log=log) as server:
        with server.client(password=WORDS["player"]) as client:
            token = str(client.token)
            client.spawn_cube("mine")
        peer, answer = enter(server, WORDS["player"], token=token)
        assert answer["token"] == token
        for frame in ({"type": "auth", "password": "x", "token": token}, {"type": "ping", "id": [token]}, [token]):
            peer.send(json.dumps(frame).encode() + DELIMITER)
        peer.send(f'{{"type":"{token}"}}'.encode() + DELIMITER)
        answers = [peer.frame() for _ in range(4)]
        peer.socket.close()
        peer, again = enter(server, WORDS["player"])
        peer.send(f'{{"type":"fly","id":"{again["token"]}"}}'.encode() + DELIMITER)  # one that this connection was told
        answers.append(peer.frame())
        peer.socket.close()
        tokens = [token, again["token"]]
    (path,) = tmp_path.glob("*.mcap")
    recording = Recording(path)
    kept = b"".join(record.data for record in recording if record.kind is not Kind.COMMAND)
    secrets = [token.encode() for token in tokens]
    said = [number for number, answer in enumerate(answers) if any(secret in answer for secret in secrets)]
    assert said == [1]  # a valid command is recorded and answered as it is, its id too
    kept = kept.replace(answers[1], b"")
    assert not any(secret in kept or secret in log.read_bytes() for secret in secrets)
    assert not any(token in caplog.text for token in tokens)
    joined = [record.about for record in recording if record.kind is Kind.JOINED]
    assert joined == [
        {"client": client, "event": "joined", "role": "player", "player": player}
        for client, player in ((1, 1), (2, 1), (3, 2))
    ]
    assert replay(path).verdict == "reproduced"


def test_who_may_not_step_does_not_step_through_a_barrier() -> None:
    with playing() as server, server.client() as owner, server.client(password=WORDS["viewer"]) as viewer:
        owner.set_mode("lockstep", barrier=True, agents=1)
        for _ in range(2):
            with pytest.raises(CommandFailed, match="the role 'viewer' may not step"):
                viewer.step()
        assert owner.get_world_info()["frame"] == 0
        assert owner.step()["frame"] == 1  # nor does anybody wait for the viewer


def test_a_batch_that_takes_long_is_judged_part_by_part() -> None:
    with playing() as server, server.client() as owner, server.client(password=WORDS["player"]) as player:
        owner.spawn_cube("theirs")
        commands: list[dict[str, Any]] = [{"type": "spawn_cube", "list": False} for _ in range(400)]
        commands += [{"type": "despawn_cube", "cube_name": "theirs"}, {"type": "step", "ticks": 500}]
        results = player.batch(commands)["results"]
        assert [result.get("code") for result in results[-3:]] == [None, "not_allowed", "not_allowed"]
        assert len(owner.get_cube_list()["cubes"]) == 401 and owner.get_world_info()["frame"] == 0


def test_the_worlds_own_password_opens_its_roles() -> None:
    with served({"name": "main", "roles": ROLES}, passwords={"main": "for main"}) as server:
        for fields, role in [({}, "owner"), ({"role": "viewer"}, "viewer")]:
            peer, answer = enter(server, "for main", **fields)
            peer.socket.close()
            assert answer["role"] == role


def test_a_role_without_a_world_that_has_it_opens_nothing() -> None:
    with served(OPEN, role_passwords={"player": "for players"}) as server:
        peer, answer = enter(server, "for players")
        peer.socket.close()
        assert answer["code"] == "auth_failed"


# -- nmes serve ------------------------------------------------------------------------------------------------------


def configured(folder: Path, **roles: Any) -> list[str]:
    """Writes a config and passwords; returns the options that name them."""
    config = {"backend": "ballistic", "mode": "lockstep", **({"roles": roles} if roles else {})}
    (folder / "config.json").write_text(json.dumps(config))
    for role, word in WORDS.items():
        (folder / role).write_text(f"{word}\nno more")
    return ["serve", "--port", "0", "--config", str(folder / "config.json")]


def test_nmes_serve_takes_a_password_for_each_role_and_a_resumed_world_knows_its_players(tmp_path: Path) -> None:
    options = [*configured(tmp_path, **ROLES), "--json", "--record", str(tmp_path / "kept")]
    given = [part for role in WORDS for part in ("--role", f"{role}={tmp_path / role}")]
    with process(*options, *given, NMES_PASSWORD=PASSWORD) as server:
        line = ready(server)
        assert line["roles"] == ["owner", *ROLES]
        with Client(port=line["port"], password=WORDS["player"], timeout=PATIENCE) as client:
            client.spawn_cube("mine")
            token = client.token
        server.terminate()
        assert server.wait(PATIENCE) == 0
    resumed = ["serve", "--port", "0", "--json", "--no-record", "--resume", line["recording"], *given]
    with process(*resumed, NMES_PASSWORD=PASSWORD) as server:
        line = ready(server)
        with Client(port=line["port"], password=WORDS["player"], timeout=PATIENCE) as client:
            assert client.welcome["player"] == 2
            with pytest.raises(CommandFailed, match="belongs to player 1"):
                client.despawn_cube("mine")
        with pytest.raises(CommandFailed, match="token is of no player"):  # tokens end with their host
            Client(port=line["port"], password=WORDS["player"], token=token, timeout=PATIENCE).connect()
        with Client(port=line["port"], password=PASSWORD, timeout=PATIENCE) as owner:
            assert owner.get_cube_info("mine")["player"] == 1


@pytest.mark.parametrize(
    ("roles", "says"),
    [
        ({}, "Everybody with the password may do everything: the world's config names no roles"),
        (ROLES, "Roles: owner (by the host's password), player (by its own password), viewer (by the host's password)"),
    ],
)
def test_nmes_serve_says_who_may_do_what(roles: dict[str, Any], says: str, tmp_path: Path) -> None:
    given = ["--role", f"player={tmp_path / 'player'}"] if roles else []
    with process(*configured(tmp_path, **roles), "--no-record", *given, NMES_PASSWORD=PASSWORD) as server:
        assert server.stdout is not None
        lines = [server.stdout.readline() for _ in range(4)]
        assert any(line.startswith(says) for line in lines), lines


@pytest.mark.parametrize(
    ("roles", "given", "says"),
    [
        ({}, ["player={player}"], "--role player: the world's config has no such role; it names no roles"),
        (ROLES, ["king={player}"], "has no such role; its roles are owner, player, viewer, referee"),
        (ROLES, ["player={player}", "player={viewer}"], "--role player is given twice"),
        (ROLES, ["player={player}", "viewer={player}"], "opens something else already"),
        (ROLES, ["player={host}"], "opens something else already"),
        (ROLES, ["player={nothing}"], "nothing"),
        (ROLES, ["player"], "say which role"),
        (ROLES, ["player="], "say which role"),
        ({"king": {"own": ["fly"]}}, [], "world config: roles/king/own/0: 'fly' is no command"),
        ({"king": 3}, ["king={player}"], "world config: roles/king"),
    ],
)
def test_roles_that_do_not_fit_are_refused_before_anything_is_served(
    roles: dict[str, Any], given: list[str], says: str, tmp_path: Path
) -> None:
    (tmp_path / "host").write_text(PASSWORD)
    names = {name: str(tmp_path / name) for name in ("player", "viewer", "host", "nothing")}
    options = [part for role in given for part in ("--role", role.format(**names))]
    arguments = [*configured(tmp_path, **roles), "--record", str(tmp_path / "kept"), *options]
    outcome = CliRunner().invoke(main, arguments, env={"NMES_PASSWORD": PASSWORD})
    assert outcome.exit_code == 2 and says in " ".join(outcome.output.split()), outcome.output
    assert not (tmp_path / "kept").exists()


def test_nmes_worlds_shows_a_player_the_worlds_with_his_role() -> None:
    with playing(OPEN, {"name": "third", "roles": {"viewer": {}}}) as server:
        for word, names in [(WORDS["player"], ["main"]), (WORDS["viewer"], ["main", "third"]), (PASSWORD, None)]:
            listed = [world["world"] for world in server.client(password=word).worlds()]
            assert listed == (names or ["main", "open", "third"])


# -- generated programs ----------------------------------------------------------------------------------------------


def heard(peer: Peer, message: dict[str, Any]) -> Any:
    """Returns the answer to a message, without the events that come before it."""
    peer.say(message)
    while (answer := peer.hear())["type"] in EVENTS:
        pass
    return answer


@pytest.mark.parametrize("seed", range(3))
def test_a_program_of_two_players_is_answered_alike_over_the_wire(seed: int) -> None:
    said = Play(program(seed), "ballistic", alone=True).said
    assert any(one.command is None for one in said) or seed > 0
    with served(CONFIG, role_passwords=WORDS) as server:
        peers, tokens = {}, {}
        for who, password in [(OWNER, PASSWORD), (VICTIM, WORDS["player"]), (INTRUDER, WORDS["player"])]:
            peers[who], welcome = enter(server, password)
            tokens[who] = welcome["token"]
        for who, command, reply in said:
            if command is None:
                peers[who].socket.close()
                peers[who], welcome = enter(server, WORDS["player"], token=tokens[who])
                assert welcome["token"] == tokens[who]
            else:
                assert heard(peers[who], command) == protocol.decode(protocol.encode(reply)), command
        for peer in peers.values():
            peer.socket.close()
