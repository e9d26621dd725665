"""`nmes backends`: list the physics engines that are installed."""

from __future__ import annotations

from typing import Any

import click
from rich.console import Console
from rich.table import Table

from nmes.backend import entry_points_by_name, load_backend
from nmes.cli._json import print_json
from nmes.errors import BackendNotFound

__all__ = ["command"]


@click.command("backends")
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
def command(as_json: bool) -> None:
    """List the physics engines that are installed.

    With version, dimensions and capabilities; and for one that cannot be loaded, or of which this version is known to
    compute wrongly, why, and what to install.

    For example:

    \b
        nmes backends --json
    """
    about = [_about(name) for name in entry_points_by_name()]
    if as_json:
        print_json(about)
        return
    table = Table("backend", "version", "dims", "capabilities", "package", box=None, pad_edge=False)
    for row in about:
        able = ", ".join(row["capabilities"]) if row["error"] is None else f"cannot be loaded: {row['error']}"
        if row["defect"] is not None:
            able = f"known to compute wrongly: {row['defect']}. {able}"
        dims = "" if row["dims"] is None else str(row["dims"])
        table.add_row(row["name"], row["version"] or "", dims, able, row["package"])
    Console(highlight=False, markup=False).print(table)


def _about(name: str) -> dict[str, Any]:
    package = entry_points_by_name()[name].dist
    about: dict[str, Any] = {
        "name": name,
        "version": None,
        "dims": None,
        "capabilities": [],
        "defect": None,
        "package": "" if package is None else f"{package.name} {package.version}",
        "error": None,
    }
    try:
        backend = load_backend(name)
        about |= {"version": backend.version(), "dims": backend.dims, "capabilities": sorted(backend.capabilities)}
        about["defect"] = backend.defect
    except BackendNotFound as error:
        about["error"] = error.message
    except Exception as error:  # it was imported, and breaks now
        about["error"] = f"{type(error).__name__}: {error}"
    return about
