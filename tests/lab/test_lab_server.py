"""The lab's doors: who is let in, what is told to browsers, and what names may lead to."""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from websockets.exceptions import InvalidStatus

from browsers import doors, get, socket_to
from journals import write_naming_journal
from labs import RunningLab, running_lab
from nmes.lab.server import application

SOCKETS = ("/ws", "/ws/poses", "/ws/poses?world=main", "/ws/recording?name=x")
PATHS = [
    ("GET", "/api/state"),
    ("GET", "/api/genomes"),
    ("POST", "/api/genomes/check"),
    ("POST", "/api/genomes/mutate"),
    ("GET", "/api/genomes/walker"),
    ("PUT", "/api/genomes/mine"),
    ("DELETE", "/api/genomes/mine"),
    ("GET", "/api/tasks"),
    ("GET", "/api/runs"),
    ("POST", "/api/runs"),
    ("GET", "/api/runs/x"),
    ("POST", "/api/runs/x/pause"),
    ("POST", "/api/runs/x/resume"),
    ("GET", "/api/runs/x/candidates/0/genome"),
    ("POST", "/api/runs/x/candidates/0/world"),
    ("GET", "/api/tables"),
    ("POST", "/api/tables"),
    ("GET", "/api/tables/x"),
    ("GET", "/api/recordings"),
    ("GET", "/api/recordings/x"),
    ("GET", "/api/recordings/x/file"),
    ("POST", "/api/recordings/x/replay"),
    ("POST", "/api/recordings/x/diff"),
    ("POST", "/api/recordings/x/fork"),
    ("POST", "/api/scores"),
    ("GET", "/api/leaderboards"),
    ("GET", "/api/leaderboards/x"),
    ("POST", "/api/leaderboards/x/verify"),
    ("POST", "/api/leaderboards/x/film"),
    ("GET", "/api/films/x/file"),
    ("GET", "/api/jobs"),
    ("GET", "/api/jobs/1"),
    ("POST", "/api/jobs/1/stop"),
    ("GET", "/api/nothing"),
    ("GET", "/api"),
]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningLab]:
    with running_lab(tmp_path_factory.mktemp("lab")) as running:
        yield running


def test_the_list_of_paths_in_this_file_is_that_of_the_api() -> None:
    from nmes.lab.api import ROUTES

    told = {
        (method, path.replace("{name}", "x").replace("{number}", "0").replace("{id}", "1")) for method, path in ROUTES
    }
    listed = {(method, path.replace("walker", "x").replace("mine", "x")) for method, path in PATHS[:-2]}
    assert told == listed
    assert callable(application)


@pytest.mark.parametrize(("method", "path"), PATHS)
def test_nothing_of_the_api_is_told_without_the_token(lab: RunningLab, method: str, path: str) -> None:
    body = b"{}" if method in ("POST", "PUT") else None
    for token in (None, "wrong", lab.token[:-1], lab.token + "x"):
        status, answer = lab.ask(path, body, method, token)
        assert (status, answer["error"]["code"]) == (401, "token_needed")
    for cookie in (f"nmes_lab_{lab.port}=wrong", f"nmes_lab_1={lab.token}", "nmes_lab", f"x; y={lab.token}"):
        assert get(lab.port, path, method, body, Cookie=cookie)[0] == 401
    assert get(lab.port, f"{path}?token={lab.token}", method, body)[0] == 401


@pytest.mark.parametrize("path", SOCKETS)
def test_no_websocket_opens_without_the_token_or_from_elsewhere(lab: RunningLab, path: str) -> None:
    for origin, whose in doors(lab.port).items():
        for token in (None, "wrong", lab.token):
            if (whose, token) == ("own", lab.token):
                continue
            headers = {} if token is None else {"Authorization": f"Bearer {token}"}
            with (
                pytest.raises(InvalidStatus) as refused,
                socket_to(lab.port, path, origin=origin, additional_headers=headers),
            ):
                pass
            assert refused.value.response.status_code == (401 if whose == "own" else 403)


def test_the_first_page_takes_the_token_into_a_cookie(lab: RunningLab) -> None:
    status, headers, _ = get(lab.port, lab.url.partition(str(lab.port))[2])
    assert (status, headers["location"]) == (303, "/")
    cookie = headers["set-cookie"]
    assert "HttpOnly" in cookie and "samesite=strict" in cookie.lower()
    cookie = cookie.partition(";")[0]
    for others in ("theme=dark", "of=another; {}=2", 'x="1', "[];", "a b=c"):  # of programs on the same machine
        assert get(lab.port, "/api/state", Cookie=f"{others}; {cookie}")[0] == 200, others
    with socket_to(lab.port, "/ws", additional_headers={"Cookie": cookie}) as browser:
        assert browser.ask({"type": "auth"})["type"] == "auth_success"
    status, headers, _ = get(lab.port, "/?token=wrong")
    assert status == 200 and "set-cookie" not in headers


@pytest.mark.parametrize("path", ["/", "/health", "/api/state", "/api/nothing", "/../../etc/passwd", "/%2e%2e/api.py"])
def test_browsers_are_told_to_load_nothing_from_elsewhere(lab: RunningLab, path: str) -> None:
    status, headers, body = get(lab.port, path)
    assert status in (200, 401, 404)
    assert headers["content-security-policy"].startswith("default-src 'self';")
    assert "http" not in headers["content-security-policy"] and "unsafe" not in headers["content-security-policy"]
    assert (headers["x-content-type-options"], headers["referrer-policy"]) == ("nosniff", "no-referrer")
    assert b"root:" not in body and b"import" not in body


def test_a_foreign_name_or_page_is_refused(lab: RunningLab) -> None:
    bearer = f"Bearer {lab.token}"
    assert get(lab.port, "/api/state", Host=f"evil.example:{lab.port}", Authorization=bearer)[0] == 403
    for origin, whose in doors(lab.port).items():
        status = get(lab.port, "/api/state", Origin=origin, Authorization=bearer)[0]
        assert status == (200 if whose == "own" else 403)


def test_the_password_may_be_left_out_with_the_token_and_is_looked_at_where_it_is_said(lab: RunningLab) -> None:
    with lab.socket() as browser:
        assert browser.ask({"type": "auth", "password": ""})["type"] == "auth_success"
    with lab.socket() as browser:
        assert browser.ask({"type": "auth", "password": "wrong"})["code"] == "auth_failed"
    for nonsense in ('{"type":"auth","type":"auth"}', "[]", '{"type":"ping"}'):
        with lab.socket() as browser:
            browser.say(nonsense)
            (message,), _ = browser.rest()
            assert message == "auth_failed" or message["type"] == "error"


NAMES = [
    "..",
    ".",
    "...",
    "..%2f..%2fsecret",
    "%2e%2e",
    "a%2fb",
    "a%00",
    ".hidden",
    "-rf",
    "x" * 300,
    "%ff",
    "a%20b",
    "<b>",
    "C:x",
]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["genomes", "runs", "recordings", "leaderboards"])
def test_no_name_leads_out_of_the_folder(lab: RunningLab, kind: str, name: str) -> None:
    (lab.folder.parent / "secret.json").write_text('{"secret": 1}')
    for method, body in (("GET", None), ("PUT", b"{}"), ("DELETE", None)):
        status, answer = lab.ask(f"/api/{kind}/{name}", body, method)
        assert status in (400, 404, 405), answer
        assert "secret" not in json.dumps(answer.get("result", "") if isinstance(answer, dict) else "")
    assert (lab.folder.parent / "secret.json").read_text() == '{"secret": 1}'


def test_no_link_is_followed(lab: RunningLab) -> None:
    secret = lab.folder.parent / "secret.mcap"
    secret.write_text("secret")
    for kind, suffix in (("recordings", ".mcap"), ("genomes", ".json"), ("leaderboards", ".sqlite")):
        os.symlink(secret, lab.folder / kind / f"link{suffix}")
        assert lab.ask(f"/api/{kind}/link")[0] == 404
        assert "link" not in {each["name"] for each in lab.good(f"/api/{kind}")["items"]}
    assert lab.ask("/api/recordings/link/file")[0] == 404
    os.symlink(lab.folder.parent, lab.folder / "runs" / "link")
    assert lab.ask("/api/runs/link")[0] == 404
    for name in ("genomes/../../secret", "../secret", str(secret)):
        run = {"kind": "evolve", "name": "out", "settings": {"task": "walk", "starts": [name]}}
        assert lab.ask("/api/runs", run)[0] == 422
        assert lab.ask("/api/scores", {"genome": name, "task": "walk"})[0] == 422
        assert lab.ask("/api/scores", {"genome": "walker", "task": name})[0] == 422


def test_what_is_too_long_or_no_json_is_refused(lab: RunningLab) -> None:
    status, answer = lab.ask("/api/genomes/check", b" " * (9 << 20))
    assert (status, answer["error"]["code"]) == (413, "request_too_large")
    for text in (b"{", b"\xff", b'{"a":1,"a":2}', b"[" * 300 + b"]" * 300):
        status, answer = lab.ask("/api/runs", text)
        assert status == 422 and answer["error"]["problems"]
    assert lab.ask("/api/runs", b"[]")[0] == 422


def test_a_folder_of_a_stranger_has_no_file_removed(tmp_path: Path) -> None:
    (precious := tmp_path / "thesis.txt").write_text("years of work")
    (folder := tmp_path / "lab").mkdir()
    with closing(sqlite3.connect(folder / ".index.sqlite")) as database, database:
        database.execute("CREATE TABLE items (x)")
    write_naming_journal(folder / ".index.sqlite", precious)
    with running_lab(folder) as lab:
        assert lab.good("/api/recordings")
    assert precious.exists()
