"""What it takes to install packages: how long pip takes with all of them on disk, and how much there is afterwards.

Hides where the packages come from: no index is asked. Each is packed as a wheel again from what is installed here, by
its own list of files, with all that it may need; which of these it does need is up to pip. What is installed for
editing is built from its source.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import sysconfig
import tempfile
import time
import venv
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit
from urllib.request import url2pathname
from zipfile import ZIP_DEFLATED, ZipFile

from nmes.errors import MachineError, MissingPackage, visible

__all__ = ["InstallCost", "measure_installs"]

_REQUIREMENT: Final = re.compile(r"([A-Za-z0-9._-]+)\s*(?:\[([^\]]*)\])?")  # the package, and extras of it
_EXTRA: Final = re.compile(r"extra\s*==\s*[\"']([^\"']*)")  # the one for which alone something is required
_MADE: Final = ("RECORD", "INSTALLER", "REQUESTED", "direct_url.json")  # by whoever installs a wheel
_JUNK: Final = re.compile(r"\..*|build|dist|.*\.egg-info")  # of a source tree: nothing that a build asks for
_TOLD: Final = 5  # lines of what a command that failed said
_PLACES: Final = ("scripts", "purelib", "platlib")  # of an environment, by the names of `sysconfig`


@dataclass(frozen=True, slots=True)
class InstallCost:
    """What it takes to install some packages together in a fresh virtual environment.

    Attributes:
        asked: Their names, with commas between them.
        packages: How many there are afterwards, with those that they need.
        megabytes: Of all files of these, byte code included, MB.
        seconds: How long pip takes, with all wheels on disk, s.
        megabytes_over_first: The size over that of those that were asked for first.
        seconds_over_first: The time likewise.
    """

    asked: str
    packages: int
    megabytes: float
    seconds: float
    megabytes_over_first: float
    seconds_over_first: float


def measure_installs(asked: Sequence[str]) -> list[InstallCost]:
    """Installs packages that are installed here in fresh virtual environments, one after the other.

    Args:
        asked: Names of packages, one or more; where there are commas between some, these are installed together.

    Raises:
        MissingPackage: One that is asked for is not installed here, or pip is not.
        MachineError: One cannot be packed, built or installed (`cannot_measure`).
    """
    if find_spec("pip") is None:
        raise MissingPackage("to measure what it takes to install takes pip: python -m ensurepip")
    together = {each: [_normal(name) for name in each.split(",")] for each in asked}
    with tempfile.TemporaryDirectory(prefix="nmes-installs-") as folder:
        wheels = Path(folder, "wheels")
        wheels.mkdir()
        packages = _needed([name for names in together.values() for name in names])
        with ThreadPoolExecutor() as pool:
            list(pool.map(_pack, packages, [wheels] * len(packages)))
        homes = [Path(folder, f"environment-{number}") for number in range(len(together))]
        found = [_install(names, wheels, home) for names, home in zip(together.values(), homes, strict=True)]
    _, size, took = found[0]
    costs = zip(together, found, strict=True)
    return [InstallCost(each, *cost, cost[1] / size, cost[2] / took) for each, cost in costs]


def _install(names: Sequence[str], wheels: Path, home: Path) -> tuple[int, float, float]:
    """Returns how many packages there are then in a fresh environment, their size (MB), and what pip took (s)."""
    venv.create(home)
    places = {name: sysconfig.get_path(name, "venv", {"base": str(home), "platbase": str(home)}) for name in _PLACES}
    python = Path(places["scripts"], "python.exe" if os.name == "nt" else "python")
    began = time.perf_counter()
    _pip("--python", str(python), "install", "--no-index", "--find-links", str(wheels), *names)
    took = time.perf_counter() - began
    files = {path for name in _PLACES[1:] for path in Path(places[name]).rglob("*") if path.is_file()}
    packages = len({path for name in _PLACES[1:] for path in Path(places[name]).glob("*.dist-info")})
    return packages, sum(path.stat().st_size for path in files) / 1e6, took


def _pip(*arguments: str) -> None:
    """Runs pip, whatever it is told elsewhere.

    Raises:
        MachineError: It fails.
    """
    options = ("--isolated", "--disable-pip-version-check", "--no-input", "-q")
    done = subprocess.run([sys.executable, "-P", "-m", "pip", *options, *arguments], capture_output=True, check=False)
    if done.returncode:
        said = done.stderr.decode("utf-8", "replace").strip().splitlines()[-_TOLD:]
        raise MachineError("cannot_measure", "pip failed: " + visible("\n".join(said), keep="\n"))


# -- wheels -----------------------------------------------------------------------------------------------------------


def _needed(names: Sequence[str]) -> list[Distribution]:
    """Returns packages that are installed here, with all of those that they may need.

    What they need on other machines alone may be among them; what extras need that nobody asks for is not.

    Raises:
        MissingPackage: One of the names is not installed.
    """
    found: dict[str, Distribution] = {}
    seen, waiting = set[tuple[str, str]](), [(name, "") for name in names]  # each with one of its extras, or none
    while waiting:
        name, extra = waiting.pop()
        if (name, extra) in seen:
            continue
        seen.add((name, extra))
        try:
            package = found.setdefault(name, distribution(name))
        except (PackageNotFoundError, ValueError):  # an empty name is none that it takes
            if name in names:
                told = f"{visible(name)!r} is not installed here, and what is measured is packed from what is"
                raise MissingPackage(told) from None
            continue  # on other machines alone
        for line in package.requires or ():
            need, only = _REQUIREMENT.match(line), _EXTRA.search(line)
            if need is not None and extra == ("" if only is None else only[1]):
                wanted = ["", *re.split(r"[\s,]+", need[2] or "")]
                waiting += [(_normal(need[1]), each) for each in wanted]
    return list(found.values())


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _pack(package: Distribution, wheels: Path) -> None:
    """Packs a package as a wheel.

    Raises:
        MachineError: It does not tell its files, or cannot be built.
    """
    source = _source(package)
    if source is not None:
        _build(source, wheels)
        return
    name = _normal(package.name).replace("-", "_")
    listed = [file for file in package.files or () if ".." not in file.parts and "__pycache__" not in file.parts]
    # Some have packages of others in them, with lists of their own.
    records = [file for file in listed if file.match("*.dist-info/RECORD") and len(file.parts) == 2]
    if len(records) != 1:
        raise MachineError("cannot_measure", f"{name} does not tell its files: install it from a wheel")
    about = records[0].parent
    kept = [file for file in listed if not (file.parent == about and file.name in _MADE)]
    path = wheels / f"{name}-{package.version}-py3-none-any.whl"
    with ZipFile(path, "w", ZIP_DEFLATED, compresslevel=1, strict_timestamps=False) as wheel:
        for file in kept:
            wheel.write(str(package.locate_file(file)), file.as_posix())
        rows = [f'"{file.as_posix()}",,\n' for file in (*kept, *records)]
        wheel.writestr(records[0].as_posix(), "".join(rows))


def _source(package: Distribution) -> Path | None:
    """Returns where the source of a package is that is installed for editing; None of another."""
    told = json.loads(package.read_text("direct_url.json") or "{}")
    if not told.get("dir_info", {}).get("editable", False):
        return None
    return Path(url2pathname(unquote(urlsplit(told["url"]).path)))


def _build(source: Path, wheels: Path) -> None:
    """Builds a wheel of a source tree, in which nothing is written."""
    with tempfile.TemporaryDirectory(prefix="nmes-build-") as folder:
        for entry in source.iterdir():
            if not _JUNK.fullmatch(entry.name):
                Path(folder, entry.name).symlink_to(entry, entry.is_dir())
        _pip("wheel", "--no-deps", "--no-build-isolation", "-w", str(wheels), folder)
