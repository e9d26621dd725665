"""Settings for all tests: how long one may take, what Hypothesis draws, and the figures that tests record."""

import os
import signal

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.database import DirectoryBasedExampleDatabase
from hypothesis.internal.conjecture.providers import AVAILABLE_PROVIDERS, HypothesisProvider
from hypothesis.internal.constants_ast import Constants

from layout import ROOT

LONG_TIMEOUT = 3600.0  # s, for a test that is marked `long`; pyproject.toml has that of all others
FAILURES = ROOT / ".hypothesis" / "examples"


class ImportBlindProvider(HypothesisProvider):
    """Hypothesis' own source of examples, without the constants of whichever of our modules are imported by then.

    Which these are depends on the tests that ran before in the same process, and so would what is drawn.
    """

    _local_constants = Constants()


# What is started under `nohup`, or in the background of a script, ignores these signals, and so would all that the
# tests start, some of which is to be ended by them. The process that hands out the tests goes on ignoring them.
if "PYTEST_XDIST_WORKER" in os.environ:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)

AVAILABLE_PROVIDERS["hypothesis"] = ImportBlindProvider

# Everything that `CI` or the clock could decide is stated. A busy machine is no failure.
STEADY = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True, max_examples=100)
# `make test`: the same examples for everybody, every time.
settings.register_profile("nmes", STEADY, derandomize=True, database=None)
# `make test-long`: other examples every time, first of all those that failed before.
settings.register_profile("search", STEADY, derandomize=False, database=DirectoryBasedExampleDatabase(FAILURES))
settings.load_profile("nmes")


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_auto_num_workers() -> int:
    """Returns how many processes `-n auto` means: half as many again as cores, as tests wait for half of their time."""
    cores = os.cpu_count() or 1
    return cores + (cores + 1) // 2


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Gives long tests more time."""
    for item in items:
        if item.get_closest_marker("long") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(LONG_TIMEOUT))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Prints the figures that were recorded with `record_property`."""
    passed = [report for report in terminalreporter.stats.get("passed", []) if report.when == "call"]
    figures = [figure for report in passed for figure in report.user_properties]
    if figures:
        terminalreporter.section("figures")
        for name, value in figures:
            terminalreporter.line(f"{name:<44} {value}")
