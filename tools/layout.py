"""Lays the tree out as it is once installed, for tools that do not follow setuptools' package-dir.

Type checkers run no import hooks and import-linter walks real folders, so neither sees that `backends/` is
`nmes.backends`. `python tools/layout.py TARGET` makes a tree of folders with symbolic links to the sources.
"""

from __future__ import annotations

import os
import shutil
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SUPPORT = ROOT / "tests" / "support"  # what tests of all packages share, for programs that they start
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def lay_out(target: Path, copy: Callable[[str, str], object] = os.symlink) -> None:
    """Makes `target` hold the package's files under their installed names, and nothing else."""
    shutil.rmtree(target, ignore_errors=True)
    for package, folder in PROJECT["tool"]["setuptools"]["package-dir"].items():
        shutil.copytree(
            ROOT / folder,
            target / package.replace(".", "/"),
            copy_function=copy,
            ignore=shutil.ignore_patterns("__pycache__"),
        )


if __name__ == "__main__":
    lay_out(Path(sys.argv[1]))
