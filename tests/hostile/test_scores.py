"""Scores that nobody earned: bodies that the solver flings, motors beyond all measure, bodies that never rest."""

from __future__ import annotations

from typing import Any

import pytest

from nmes.errors import DocumentError
from nmes.genome import Genome


def pair(kind: str = "slide", brain: dict[str, Any] | None = None, mass: float = 1.0, **joint: Any) -> dict[str, Any]:
    """The genome of two cubes side by side, with a joint between them."""
    cubes = [
        {"id": "a", "size": 1, "mass": mass, "position": [0, 0.5, 0]},
        {"id": "b", "size": 1, "mass": mass, "position": [1, 0.5, 0]},
    ]
    axis = {} if kind in ("fixed", "pin") else {"axis": [1, 0, 0] if kind == "slide" else [0, 0, 1]}
    joints = [{"id": "j", "cube1": "a", "cube2": "b", "type": kind, "anchor": [0.5, 0.5, 0], **axis, **joint}]
    genome = {"format": "nmes-genome/1", "name": "pair", "body": {"cubes": cubes, "joints": joints}}
    return genome if brain is None else {**genome, "brain": brain}


# -- limits that exclude the pose at rest -----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["hinge", "slide"])
@pytest.mark.parametrize("limits", [[56.7, 56.8], [-3, -1e-6], [1e-6, 2]])
def test_limits_that_exclude_the_pose_at_rest_are_refused(kind: str, limits: list[float]) -> None:
    with pytest.raises(DocumentError) as caught:
        Genome(pair(kind, limits=limits))
    ((path, message),) = caught.value.problems
    assert path == "body/joints/0/limits"
    assert message.startswith("the limits of joint 'j', ") and "exclude 0" in message


@pytest.mark.parametrize("kind", ["hinge", "slide"])
@pytest.mark.parametrize("limits", [[0, 0], [0, 1], [-1, 0], [-1, 2]])
def test_limits_may_end_at_the_pose_at_rest(kind: str, limits: list[float]) -> None:
    assert Genome(pair(kind, limits=limits)).body.joints[0].limits == tuple(limits)


def test_a_cone_contains_the_pose_at_rest_unless_it_is_negative() -> None:
    assert Genome(pair("conetwist", limits=[0, 0])).body.joints[0].limits == (0.0, 0.0)
    for limits in ([-0.1, 1], [1, -0.1]):
        with pytest.raises(DocumentError, match="must not be negative"):
            Genome(pair("conetwist", limits=limits))


def test_limits_of_a_graph_contain_the_pose_at_rest_after_growth_at_any_scale_and_in_mirrors() -> None:
    arm = {"id": "arm", "size": 0.2, "joint": {"type": "slide", "axis": [1, 0, 0], "limits": [0.1, 0.2]}}
    graph = {
        "root": "trunk",
        "parts": [{"id": "trunk", "size": 0.5}, arm],
        "connections": [{"from": "trunk", "to": "arm", "face": "+z", "mirror": "z", "scale": 0.5}],
    }
    genome = {"format": "nmes-genome/1", "name": "grown", "body": {"graph": graph}}
    with pytest.raises(DocumentError) as caught:
        Genome(genome)
    assert [path for path, _ in caught.value.problems] == ["body/graph"] * 2
    first, second = (message for _, message in caught.value.problems)
    assert "'arm', 0.05 to 0.1" in first and "'arm.mirror', 0.05 to 0.1" in second
    arm["joint"] = {"type": "slide", "axis": [1, 0, 0], "limits": [-0.1, 0.2]}
    assert [joint.limits for joint in Genome(genome).body.joints] == [(-0.05, 0.1)] * 2
