"""Options for pytest: `pytest --pyargs nmes.conformance --nmes-target HOST:PORT`.

It is loaded by pytest wherever nmes is installed, so it only adds the options; the tests are in `test_conformance`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest

__all__ = ["pytest_addoption"]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds the options."""
    group = parser.getgroup("nmes", "conformance of an NMES server")
    group.addoption("--nmes-target", metavar="HOST:PORT", help="The server to judge.")
    group.addoption("--nmes-password", metavar="TEXT", help="Its password; better in the variable NMES_PASSWORD.")
    group.addoption("--nmes-timeout", type=float, default=5.0, help="How long one wait for it may take, in s (5).")
    group.addoption("--nmes-seed", type=int, default=0, help="Of all that is drawn (0).")
