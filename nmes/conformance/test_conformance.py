"""The suite as tests, one a case, for somebody's own CI; `plugin` has the options.

The cases are run together when the first test asks for its result, so that they can wait side by side; `-k` and test
ids choose which are run.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

import pytest

from nmes.conformance import CASES, Case, Options, Result, Target, Verdict, run
from nmes.conformance.report import describe
from nmes.errors import visible


@pytest.fixture(scope="session")
def results(request: pytest.FixtureRequest) -> Mapping[str, Result]:
    """Runs the cases whose tests were selected; returns their results by number."""
    config = request.config
    address = config.getoption("--nmes-target")
    if address is None:
        pytest.skip("no --nmes-target HOST:PORT")
    host, _, port = address.rpartition(":")
    password = config.getoption("--nmes-password") or os.environ.get("NMES_PASSWORD")
    if not host or not port.isdecimal() or password is None:
        raise pytest.UsageError("give --nmes-target HOST:PORT, and a password in NMES_PASSWORD")
    numbers = [case.number for item in request.session.items if (case := case_of(item)) is not None]
    target = Target(host.strip("[]"), int(port), password, config.getoption("--nmes-timeout"))
    report = run(target, Options(only=numbers, seed=config.getoption("--nmes-seed")))
    return {result.case.number: result for result in report.results}


def case_of(item: pytest.Item) -> Case | None:
    """Returns the case of one of this file's tests; None for others."""
    if not isinstance(item, pytest.Function) or item.originalname != "test_case":
        return None
    case = item.callspec.params.get("case")
    return case if isinstance(case, Case) else None


@pytest.mark.parametrize("case", CASES, ids=[case.number for case in CASES])
def test_case(case: Case, results: Mapping[str, Result]) -> None:
    """A server does what a case's title says."""
    result = results[case.number]
    if result.verdict in (Verdict.SKIPPED, Verdict.UNIMPLEMENTED):
        pytest.skip(visible(f"{result.verdict}: {result.reason}"))
    if result.verdict is Verdict.NON_STRICT:
        pytest.xfail(visible(f"not strict: expected {result.expected}, received {result.received}"))
    if result.verdict is not Verdict.OK:
        pytest.fail(describe(result), pytrace=False)
