"""The program `nmes lab`, run in a process of its own, and asked as its pages ask it."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from browsers import Socket, get, socket_to
from nmes.backend import Array
from processes import process, ready
from servers import PATIENCE, until

__all__ = ["Frame", "RunningLab", "running_lab"]


class Frame(NamedTuple):
    """A binary frame: the scene's number, the world's frame, and an array (n, 7) of positions and quaternions."""

    scene: int
    frame: int
    poses: Array

    @classmethod
    def read(cls, data: bytes) -> Frame:
        scene, frame = struct.unpack_from("<II", data)
        return cls(scene, frame, np.frombuffer(data, "<f4", offset=8).reshape(-1, 7).astype(float))


class RunningLab:
    """A lab that runs."""

    def __init__(self, folder: Path, about: dict[str, Any]) -> None:
        self.folder = folder
        self.url: str = about["url"]
        self.port: int = about["port"]
        self.host_port: int = about["host_port"]
        self.token: str = about["token"]

    def ask(self, path: str, body: Any = None, method: str | None = None, token: str | None = "") -> tuple[int, Any]:
        """Asks; returns the status and the answer, parsed where it is JSON."""
        headers = {} if token is None else {"Authorization": f"Bearer {token or self.token}"}
        data = None if body is None else body if isinstance(body, bytes) else json.dumps(body).encode()
        method = method or ("GET" if body is None else "POST")
        status, answered, text = get(self.port, path, method, data, None, **headers)
        return status, json.loads(text) if answered.get("content-type") == "application/json" else text

    def good(self, path: str, body: Any = None, method: str | None = None) -> Any:
        """Asks for what must be answered well."""
        status, answer = self.ask(path, body, method)
        assert status == 200, answer
        return answer

    @contextmanager
    def socket(self, path: str = "/ws", **options: Any) -> Iterator[Socket]:
        """Opens one of its WebSockets."""
        with socket_to(
            self.port, path, additional_headers={"Authorization": f"Bearer {self.token}"}, **options
        ) as opened:
            yield opened

    @contextmanager
    def world(self, **auth: Any) -> Iterator[Socket]:
        """Joins a world, `main` unless another is named."""
        with self.socket() as joined:
            assert joined.ask({"type": "auth", "world": "main", **auth})["type"] == "auth_success"
            yield joined

    def ended(self, job: int) -> Any:
        """Returns how a job fared, once it has ended."""
        until(lambda: self.good(f"/api/jobs/{job}")["state"] == "ended", 6000)
        return self.good(f"/api/jobs/{job}")


@contextmanager
def running_lab(folder: Path, *options: str, **environment: str) -> Iterator[RunningLab]:
    """Runs a lab; in the end it is interrupted, and must end well and have logged no failure."""
    with process("lab", "--dir", str(folder), "--port", "0", "--json", *options, **environment) as program:
        yield RunningLab(folder, ready(program))
        program.terminate()
        output, errors = program.communicate(timeout=PATIENCE)
        assert (program.returncode, output) == (0, ""), errors
        assert "ERROR" not in errors and "Traceback" not in errors, errors
