"""The conformance suite can fail: it finds what is wrong with servers that are broken on purpose."""

from __future__ import annotations

import dataclasses

import pytest
from pytest import MonkeyPatch

from defects import Defect, judge, unbroken
from nmes.conformance import CASES, CATEGORIES
from nmes.protocol import DELIMITER, Session
from selftest import BROKEN

SAMPLE = list(BROKEN.values())[1::5]


@pytest.mark.parametrize("defect", SAMPLE, ids=lambda defect: defect.name)
def test_a_sample_of_defects_is_caught(defect: Defect) -> None:
    check_caught(defect)


@pytest.mark.long
@pytest.mark.parametrize("defect", [d for d in BROKEN.values() if d not in SAMPLE], ids=lambda defect: defect.name)
def test_all_other_defects_are_caught(defect: Defect) -> None:
    check_caught(defect)


def check_caught(defect: Defect) -> None:
    judgement = judge(defect)
    assert judgement.caught, (judgement.named, judgement.others)


def test_the_same_cases_pass_without_the_defects() -> None:
    for config, judgement in unbroken(SAMPLE):
        assert judgement.clean, (config, judgement)


def test_a_server_without_a_defect_is_not_caught() -> None:
    defect = dataclasses.replace(BROKEN["a_reply_too_many"], break_it=lambda patch: None)
    assert not judge(defect).caught


def test_a_server_that_fails_every_case_counts_as_not_caught() -> None:
    def babble(patch: MonkeyPatch) -> None:
        patch.setattr(Session, "reply", lambda session, request, encoded: b"{}" + DELIMITER)
        patch.setattr(Session, "accept", lambda session, welcome: b"{}" + DELIMITER)

    judgement = judge(dataclasses.replace(BROKEN["a_reply_too_many"], break_it=babble))
    assert {result.verdict for result in judgement.named} == {"failed"}
    assert not judgement.caught


def test_every_category_has_defects_and_every_name_a_case() -> None:
    assert len(BROKEN) >= 170
    named = {number for defect in BROKEN.values() for number in defect.cases}
    assert named <= {case.number for case in CASES}
    assert {int(number.split(".")[0]) for number in named} == {category.number for category in CATEGORIES}
    assert all(defect.cases for defect in BROKEN.values())
    assert len({defect.does for defect in BROKEN.values()}) == len(BROKEN)
