"""Settings for all tests, and the figures that tests note with `record_property`."""

import pytest
from hypothesis import settings

# A busy machine is no failure.
settings.register_profile("nmes", deadline=None)
settings.load_profile("nmes")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Prints the figures that were noted."""
    passed = [report for report in terminalreporter.stats.get("passed", []) if report.when == "call"]
    noted = [figure for report in passed for figure in report.user_properties]
    if noted:
        terminalreporter.section("figures")
        for name, value in noted:
            terminalreporter.line(f"{name:<44} {value}")
