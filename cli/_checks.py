"""What `nmes doctor` looks at: each check says what it found, whether that is well, and what to do where it is not."""

from __future__ import annotations

import base64
import io
import json
import os
import platform
import re
import shutil
import socket
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Literal

from PIL import Image

from nmes.backend import Backend, entry_points_by_name, load_backend
from nmes.backend.probe import probe
from nmes.errors import BackendNotFound, NmesError, visible
from nmes.world import World

__all__ = ["Finding", "look_at_everything", "take_probes"]

_LITTLE, _TOO_LITTLE = 1_000_000_000, 100_000_000  # bytes of disk: a recording takes a few MB a minute
_FEW_FILES, _TOO_FEW_FILES = 1024, 32  # open at once: one a client; and what a host needs to begin
_EXTRA = re.compile(r"""extra\s*==\s*['"]([\w-]+)['"]""")
_COLLECTIONS = ("all", "dev", "bench")  # extras that nobody needs for a feature
# What engines print, also by libraries in C, goes elsewhere than the answer.
_PROBES = """
import json, os, sys
answer = os.dup(1)
os.dup2(2, 1)
import nmes.cli._checks as checks
os.write(answer, json.dumps(checks.take_probes(sys.argv[1:])).encode())
"""


@dataclass(frozen=True)
class Finding:
    """What a check found.

    Attributes:
        name: What was looked at.
        status: `ok`; `note` for what is as it may be, and good to know; `wrong` for what does not work.
        value: What was found.
        hint: What to do, where there is something to do.
    """

    name: str
    status: Literal["ok", "note", "wrong"]
    value: str
    hint: str = ""


def look_at_everything(port: int) -> Iterator[Finding]:
    """Yields what each check finds, in about two seconds; `port` is the one that a host is to listen on."""
    yield Finding("nmes", "ok", f"{version('nmes')} in {Path(__file__).parent.parent}")
    yield Finding("python", "ok", f"{platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores")
    yield from _packages()
    engines: dict[str, Backend] = {}
    for name in entry_points_by_name():
        yield _engine(name, engines)
    yield from _probes(list(engines))
    if "mujoco" in engines:
        yield _arenas(engines["mujoco"])
        yield _graphics()
    yield _port(port)
    for name, folder in (("this folder", Path.cwd()), ("temporary folder", Path(tempfile.gettempdir()))):
        yield _disk(name, folder)
    yield from _open_files()


def _packages() -> Iterator[Finding]:
    """Yields which of the packages that NMES needs are missing, and which extras are installed."""
    missing, extras = [], defaultdict[str, list[bool]](list)
    for line in requires("nmes") or ():
        requirement, _, marker = line.partition(";")
        name = re.split(r"[^\w.-]", requirement)[0]
        found = _is_installed(name)
        if extra := _EXTRA.search(marker):
            extras[extra[1]].append(found)
        elif not marker and not found:
            missing.append(name)
    if missing:
        yield Finding("packages", "wrong", f"not installed: {', '.join(missing)}", f"pip install {' '.join(missing)}")
    there = sorted(name for name, found in extras.items() if all(found) and name not in _COLLECTIONS)
    others = sorted(extras.keys() - set(there) - set(_COLLECTIONS))
    hint = f"pip install 'nmes[NAME]' adds one of: {', '.join(others)}" if others else ""
    yield Finding("extras", "ok", ", ".join(there) or "none", hint)


def _is_installed(name: str) -> bool:
    try:
        version(name)
    except PackageNotFoundError:
        return False
    return True


def _engine(name: str, engines: dict[str, Backend]) -> Finding:
    """Loads an engine, and puts it among those that could be."""
    try:
        backend = engines[name] = load_backend(name)
        if backend.defect is None:
            return Finding(f"engine {name}", "ok", backend.version())
        what, _, remedy = backend.defect.partition("; ")
        return Finding(f"engine {name}", "wrong", f"{backend.version()} is known to compute wrongly: {what}", remedy)
    except BackendNotFound as error:
        return Finding(f"engine {name}", "wrong", error.message)
    except Exception as error:  # it was imported, and breaks now
        return Finding(f"engine {name}", "wrong", f"{type(error).__name__}: {error}")


def take_probes(names: Iterable[str]) -> dict[str, str]:
    """Returns each engine's numeric probe, hexadecimal; of one that breaks meanwhile, the error."""
    probes = {}
    for name in names:
        try:
            probes[name] = probe(load_backend(name))
        except Exception as error:  # whatever a stranger's engine does
            probes[name] = f"{type(error).__name__}: {error}"
    return probes


def _probes(names: list[str]) -> Iterator[Finding]:
    """Yields what each engine's probe is, taken here and in a process of its own."""
    # -P: files of the working folder are not in its way.
    result = subprocess.run([sys.executable, "-P", "-c", _PROBES, *names], capture_output=True, check=False)
    again = json.loads(result.stdout) if result.returncode == 0 else None
    if again is None:
        said = result.stderr.decode("utf-8", "replace").strip().rpartition("\n")[2] or "nothing on standard error"
        value = f"ended with status {result.returncode}: {visible(said)}"
        yield Finding("another process", "wrong", value, "probes are taken here alone until what it says is mended")
    for name, here in take_probes(names).items():
        other = here if again is None else again[name]
        if here != other:
            value = f"{here}, and in another process {other}"
            hint = "what is recorded here is not reproduced: test the memory, look for what changes libraries"
            yield Finding(f"probe of {name}", "wrong", value, hint)
        elif re.fullmatch("[0-9a-f]+", here):
            yield Finding(f"probe of {name}", "ok", here)
        else:
            yield Finding(f"probe of {name}", "wrong", here, "ask its makers")


def _arenas(mujoco: Backend) -> Finding:
    why = mujoco.lacking.get("scene.arena")
    if why is None:
        return Finding("arenas", "ok", "dm-control is installed")
    return Finding("arenas", "note", f"none: {why}")


def _graphics() -> Finding:
    """Draws a cube, without a display."""
    world = World({"backend": "mujoco", "mode": "lockstep"})
    try:
        client = world.join()
        world.execute(client, {"type": "spawn_cube", "position": [0, 1, 0]})
        reply = world.execute(client, {"type": "get_camera", "width": 64, "height": 48})
    except NmesError as error:
        return _no_graphics(error.message)
    finally:
        world.close()
    if reply["type"] == "error":
        return _no_graphics(str(reply["message"]))
    with Image.open(io.BytesIO(base64.b64decode(reply["image"]))) as picture:
        if picture.convert("RGB").getcolors(1) is not None:
            return _no_graphics("pictures are of one colour")
    return Finding("graphics", "ok", f"OpenGL through {os.environ.get('PYOPENGL_PLATFORM', 'the system')}")


def _no_graphics(why: str) -> Finding:
    return Finding("graphics", "wrong", f"no films, pictures or cameras: {why}", "all else works without")


def _port(port: int) -> Finding:
    with socket.socket() as listener:
        if os.name == "posix":
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as a host does
        try:
            listener.bind(("127.0.0.1", port))
        except OSError as error:
            hint = "a host may be running already; nmes serve --port 0 finds a free port"
            return Finding(f"port {port}", "note", f"cannot be listened on: {error.strerror}", hint)
    return Finding(f"port {port}", "ok", "free")


def _disk(name: str, folder: Path) -> Finding:
    try:
        with tempfile.TemporaryFile(dir=folder):
            free = shutil.disk_usage(folder).free
    except OSError as error:
        return Finding(name, "wrong", f"{folder} cannot be written to: {error.strerror}", "work in another folder")
    value = f"{free / 1e9:.1f} GB free in {folder}"
    if free >= _LITTLE:
        return Finding(name, "ok", value)
    return Finding(name, "note" if free >= _TOO_LITTLE else "wrong", value, "recordings take a few MB a minute")


def _open_files() -> Iterator[Finding]:
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = sys.maxsize if hard == resource.RLIM_INFINITY else hard
    status: Literal["ok", "note", "wrong"] = (
        "ok" if most >= _FEW_FILES else "note" if most >= _TOO_FEW_FILES else "wrong"
    )
    hint = "" if status == "ok" else "each client of a host needs one; see `ulimit -Hn`"
    yield Finding("open files", status, "no limit" if most == sys.maxsize else f"at most {most}", hint)
