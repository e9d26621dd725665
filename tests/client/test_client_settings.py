"""What a client is told before it connects: the password, and whom to trust."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Iterator
from pathlib import Path

import pytest
import trustme

from nmes import AsyncClient, Client
from nmes.errors import CommandFailed, Disconnected
from servers import PASSWORD, PATIENCE, Served, served


@pytest.fixture(scope="module")
def authority() -> trustme.CA:
    return trustme.CA()


@pytest.fixture
def certificates(authority: trustme.CA, tmp_path: Path) -> Path:
    path = tmp_path / "ca.pem"
    authority.cert_pem.write_to_path(str(path))
    return path


@pytest.fixture(scope="module")
def secret(authority: trustme.CA) -> Iterator[Served]:
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    authority.issue_cert("127.0.0.1").configure_cert(context)
    with served(tls=context) as running:
        yield running


@pytest.fixture(scope="module")
def server() -> Iterator[Served]:
    with served() as running:
        yield running


def test_the_password_is_that_of_the_environment_unless_one_is_given(
    server: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NMES_PASSWORD", PASSWORD)
    with Client(port=server.port, timeout=PATIENCE) as client:
        assert client.ping()["type"] == "pong"
        assert client.worlds()[0]["world"] == "main"
    with pytest.raises(CommandFailed) as refused:
        Client(port=server.port, password="another", timeout=PATIENCE).connect()
    assert refused.value.code == "auth_failed"

    async def ping() -> str:
        async with AsyncClient(port=server.port, timeout=PATIENCE) as client:
            return (await client.ping())["type"]

    assert asyncio.run(ping()) == "pong"


@pytest.mark.parametrize("variable", [None, ""])
def test_without_a_password_no_client_is_made(variable: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NMES_PASSWORD", raising=False)
    if variable is not None:
        monkeypatch.setenv("NMES_PASSWORD", variable)
    for kind in (Client, AsyncClient):
        with pytest.raises(ValueError, match="give password=, or set NMES_PASSWORD"):
            kind()


def test_a_file_of_certificates_is_trusted(secret: Served, certificates: Path) -> None:
    for path in (certificates, str(certificates)):
        with Client(port=secret.port, password=PASSWORD, tls_ca=path, timeout=PATIENCE) as client:
            assert client.worlds()[0]["world"] == "main"  # over another connection, which trusts the same
    with pytest.raises(Disconnected, match="certificate"):
        Client(port=secret.port, password=PASSWORD, tls=True, timeout=PATIENCE).connect()


def test_what_is_no_file_of_certificates_is_named(tmp_path: Path, certificates: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"nowhere\.pem"):
        Client(password="x", tls_ca=tmp_path / "nowhere.pem")
    (tmp_path / "empty.pem").write_text("hello")
    with pytest.raises(ValueError, match=r"empty\.pem has no certificates in PEM"):
        Client(password="x", tls_ca=tmp_path / "empty.pem")
    with pytest.raises(ValueError, match="not both"):
        Client(password="x", tls_ca=certificates, tls=ssl.create_default_context())
