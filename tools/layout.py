"""Lays the tree out as it is once installed, for tools that do not follow setuptools' package-dir.

Type checkers and editors run no import hooks and import-linter walks real folders, so none sees that `backends/` is
`nmes.backends`. `python tools/layout.py TARGET` makes a tree of folders with symbolic links to the sources.
"""

from __future__ import annotations

import shutil
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SUPPORT = ROOT / "tests" / "support"  # what tests of all packages share, for programs that they start
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def lay_out(target: Path, copy: bool = False) -> None:
    """Makes `target` hold the package's files under their installed names, and nothing else.

    Args:
        target: The folder; what it held is deleted.
        copy: Whether it gets copies. Else it gets links, which stay true when files are added to the folders.
    """
    shutil.rmtree(target, ignore_errors=True)
    for package, folder in PROJECT["tool"]["setuptools"]["package-dir"].items():
        source, destination = ROOT / folder, target / package.replace(".", "/")
        if copy:
            shutil.copytree(source, destination, ignore=shutil.ignore_patterns("__pycache__"))
        elif "." in package:
            destination.symlink_to(source)
        else:
            # A link for each part, as the folders that are mapped into the package stand among them.
            destination.mkdir(parents=True)
            for part in source.iterdir():
                (destination / part.name).symlink_to(part)


if __name__ == "__main__":
    lay_out(Path(sys.argv[1]))
