"""A role that may not, cannot: generated programs of two players, in which one tries what he likes."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pytest import MonkeyPatch

from nmes.world.commands import RIGHTS
from nmes.world.rights import Right, nothing
from role_programs import ATTEMPTS, INTRUDER, OWNER, VICTIM, Play, Step, program

WHO = [OWNER, VICTIM, VICTIM, INTRUDER, INTRUDER, INTRUDER]
PROGRAMS = st.lists(st.builds(Step, st.sampled_from(WHO), st.integers(0, 2**32)), min_size=10, max_size=40)


@settings(max_examples=25)
@given(PROGRAMS)
def test_what_an_intruder_does_leaves_a_victim_as_he_would_be_alone(steps: list[Step]) -> None:
    Play(steps, "ballistic", alone=True)


@settings(max_examples=4)
@given(PROGRAMS)
def test_no_command_of_an_intruder_changes_what_is_a_victims(steps: list[Step]) -> None:
    Play(steps, "mujoco", alone=False)


@pytest.mark.long
@settings(max_examples=500)
@given(PROGRAMS)
def test_five_hundred_programs_change_nothing_that_is_not_theirs(steps: list[Step]) -> None:
    Play(steps, "ballistic", alone=True)


@pytest.mark.long
@settings(max_examples=100)
@given(PROGRAMS)
def test_nor_do_a_hundred_with_motors(steps: list[Step]) -> None:
    Play(steps, "mujoco", alone=False)


# -- holes -----------------------------------------------------------------------------------------------------------

HOLES = [kind for kind in ATTEMPTS if RIGHTS[kind].kind != "look" and not kind.startswith("spawn")]
NEEDS_MOTORS = {"drive", "set_joint_param", "create_bone"}
SAMPLE = ["apply_physics", "give", "link_body_cubes", "reset", "set_joint_params"]


def check_caught(kind: str, monkeypatch: MonkeyPatch) -> None:
    """A world that does not look at what a command touches is found out by a program of some."""
    motors = kind in NEEDS_MOTORS
    backend, programs = ("mujoco", 40) if motors else ("ballistic", 100)
    monkeypatch.setitem(RIGHTS, kind, Right("act", nothing))
    with pytest.raises(AssertionError):
        for seed in range(programs):
            Play(program(seed), backend, alone=not motors)


@pytest.mark.parametrize("kind", SAMPLE)
def test_a_hole_in_a_command_is_found(kind: str, monkeypatch: MonkeyPatch) -> None:
    check_caught(kind, monkeypatch)


@pytest.mark.long
@pytest.mark.parametrize("kind", sorted(set(HOLES) - set(SAMPLE)))
def test_a_hole_in_any_other_command_is_found(kind: str, monkeypatch: MonkeyPatch) -> None:
    check_caught(kind, monkeypatch)


def test_the_programs_try_every_command_that_changes_what_is_there() -> None:
    changing = {kind for kind, right in RIGHTS.items() if right.kind not in (None, "look")}
    assert {kind for kind in changing if RIGHTS[kind].touches is not nothing} <= set(ATTEMPTS)
