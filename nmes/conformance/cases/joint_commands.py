"""What the commands about joints do: their replies, and their effects as other commands see them."""

from __future__ import annotations

import itertools
import math
from typing import Any

from nmes.conformance.case import Category, Row
from nmes.conformance.trial import Trial

JOINT_COMMANDS = Category(5, "commands")
case, table = JOINT_COMMANDS.case, JOINT_COMMANDS.table


@table(
    12,
    "4.create_joint",
    [
        Row(kind, kind, (f"joint.{'slide' if kind == 'slider' else kind}",))
        for kind in ("fixed", "hinge", "slide", "slider", "pin", "conetwist")
    ],
)
def joining(t: Trial, kind: str) -> None:
    """A joint is made, and both its cubes tell its name."""
    wire = t.join()
    one, two, other = (t.base(wire, position=t.at(x)) for x in (0, 1.5, 3))
    joint = t.join_cubes(wire, one, two, kind)
    for cube, joints in ((one, [joint]), (two, [joint]), (other, [])):
        t.equal(t.info(wire, cube)["joints"], joints, f"joints of {cube}")


@table(
    13,
    "4.get_joint_info",
    [
        Row(kind, kind, (f"joint.{'slide' if kind == 'slider' else kind}",))
        for kind in ("fixed", "hinge", "slide", "slider", "pin", "conetwist")
    ],
    needs=("get_joint_info",),
)
def joint_info(t: Trial, kind: str) -> None:
    """A new joint tells its cubes in their order, its type, its anchor halfway, and position 0."""
    wire = t.join()
    one, two = t.base(wire, position=t.at(0, 3)), t.base(wire, position=t.at(2, 4))
    joint = t.join_cubes(wire, one, two, kind)
    info = t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")
    t.equal([info["joint_name"], info["cube1"], info["cube2"]], [joint, one, two], "joint_name, cube1, cube2")
    t.equal(info["joint_type"], "slide" if kind == "slider" else kind, "joint_type")
    t.close(info["anchor"], t.at(1, 3.5), 0.01, "anchor")
    t.close([info["position"], info["velocity"]], [0.0, 0.0], 0.01, "position and velocity")
    if kind in ("hinge", "slide", "slider"):
        axis = [0.0, 0.0, 1.0] if kind == "hinge" else [1.0, 0.0, 0.0]
        t.close(info["axis"], axis, 1e-4, "axis")


@case(14, "4.create_joint", needs=("joint.hinge", "get_joint_info"))
def an_anchor_that_is_given(t: Trial) -> None:
    """A joint has the anchor that it is given."""
    wire = t.join()
    one, two = t.base(wire, position=t.at(0)), t.base(wire, position=t.at(2))
    joint = t.join_cubes(wire, one, two, "hinge", position=t.at(0.5, 3.5))
    info = t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")
    t.close(info["anchor"], t.at(0.5, 3.5), 0.01, "anchor")


@table(
    15,
    "4.create_joint",
    [
        Row("hinge-x", ("hinge", [2, 0, 0]), ("3d", "joint.hinge")),
        Row("hinge-y", ("hinge", [0, 0.5, 0]), ("3d", "joint.hinge")),
        Row("hinge-minus-z", ("hinge", [0, 0, -3]), ("joint.hinge",)),
        Row("slide-y", ("slide", [0, 7, 0]), ("joint.slide",)),
        Row("slide-oblique", ("slide", [1, 1, 0]), ("joint.slide",)),
        Row("slide-z", ("slide", [0, 0, 1]), ("3d", "joint.slide")),
    ],
    needs=("get_joint_info",),
)
def an_axis_that_is_given(t: Trial, row: tuple[str, list[float]]) -> None:
    """A joint has the axis that it is given, of unit length."""
    kind, axis = row
    wire = t.join()
    one, two = t.base(wire, position=t.at(0)), t.base(wire, position=t.at(2))
    joint = t.join_cubes(wire, one, two, kind, axis=axis)
    info = t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")
    length = math.hypot(*axis)
    t.close(info["axis"], [value / length for value in axis], 1e-4, "axis")


@case(16, "4.get_joint_list", needs=("joint.fixed", "get_joint_list"))
def joint_list(t: Trial) -> None:
    """The list of joints has each with type and cubes, in order of creation, and only while it is there."""
    wire = t.join()
    cubes = [t.base(wire, position=t.at(n - 2)) for n in range(4)]
    joints = [t.join_cubes(wire, one, two) for one, two in itertools.pairwise(cubes)]
    joint_list = t.ask(wire, {"type": "get_joint_list"}, "joint_list")["joints"]
    mine = [joint for joint in joint_list if joint["joint_name"] in joints]
    expected = [
        {"joint_name": joint, "joint_type": "fixed", "cube1": one, "cube2": two}
        for joint, one, two in zip(joints, cubes, cubes[1:], strict=False)
    ]
    summaries = [{name: joint[name] for name in expected[0]} for joint in mine]
    t.equal(summaries, expected, "the case's joints in the list")
    t.ask(wire, {"type": "despawn_cube", "cube_name": cubes[1]}, "cube_despawned")
    joint_list = t.ask(wire, {"type": "get_joint_list"}, "joint_list")["joints"]
    left = [joint["joint_name"] for joint in joint_list if joint["joint_name"] in joints]
    t.equal(left, joints[2:], "what is left of them")


@case(17, "4.remove_joint", needs=("joint.fixed", "remove_joint"))
def removing_a_joint(t: Trial) -> None:
    """A removed joint is gone from both cubes, which stay."""
    wire = t.join()
    one, two = t.base(wire), t.base(wire, position=t.at(1.5))
    joint = t.join_cubes(wire, one, two)
    reply = t.ask(wire, {"type": "remove_joint", "joint_name": joint}, "joint_removed")
    t.equal(reply["joint_name"], joint, "joint_name")
    for cube in (one, two):
        t.equal(t.info(wire, cube)["joints"], [], f"joints of {cube}")


PARAMETERS: dict[str, tuple[str, Any]] = {
    "motor_target_velocity": ("motor", 2.5),
    "motor_max_force": ("motor", 40.0),
    "motor_enabled": ("motor", True),
    "target_position": ("servo", 0.5),
    "stiffness": ("spring", 30.0),
    "damping": ("spring", 2.0),
    "limit_lower": ("limits", -1.0),
    "limit_upper": ("limits", 1.0),
    "limit_enabled": ("limits", True),
    "motor_max_impulse": ("motor", 0.5),
}


@table(
    18,
    "4.set_joint_param",
    [Row(name, name, (need,)) for name, (need, _) in PARAMETERS.items()],
    needs=("joint.hinge",),
)
def setting_a_parameter(t: Trial, name: str) -> None:
    """The reply to set_joint_param repeats joint, parameter and value, and get_joint_info tells it."""
    wire = t.join()
    joint = t.join_cubes(wire, t.base(wire), t.base(wire, position=t.at(1.5)), "hinge")
    value = PARAMETERS[name][1]
    command = {"type": "set_joint_param", "joint_name": joint, "param_name": name, "value": value}
    reply = t.ask(wire, command, "joint_param_set")
    t.equal([reply["joint_name"], reply["param_name"], reply["value"]], [joint, name, value], "the reply")
    if t.probe.claims("get_joint_info"):
        params = t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")["params"]
        t.true(name in params, f"{name} among the parameters", params)
        t.equal(params[name], value, name)


@case(19, "4.set_joint_param", needs=("joint.hinge", "motor", "get_joint_info"))
def a_target_enables_the_motor(t: Trial) -> None:
    """Setting motor_target_velocity enables the motor, when joining too."""
    wire = t.join()
    one, two, three = (t.base(wire, position=t.at(x)) for x in (0, 1.5, 3))
    plain = t.join_cubes(wire, one, two, "hinge")
    driven = t.join_cubes(wire, two, three, "hinge", motor_target_velocity=1.0)

    def enabled(joint: str) -> Any:
        return t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")["params"]["motor_enabled"]

    t.equal([enabled(plain), enabled(driven)], [False, True], "motor_enabled")
    command = {"type": "set_joint_param", "joint_name": plain, "param_name": "motor_target_velocity", "value": 1}
    t.ask(wire, command, "joint_param_set")
    t.equal(enabled(plain), True, "motor_enabled afterwards")


@case(48, "4.set_joint_params", needs=("joint.hinge", "motor", "limits", "set_joint_params", "get_joint_info"))
def setting_several_parameters(t: Trial) -> None:
    """The reply to set_joint_params repeats what was set, get_joint_info tells it, and all is set or none."""
    wire = t.join()
    joint = t.join_cubes(wire, t.base(wire), t.base(wire, position=t.at(1.5)), "hinge", limits=[-1, 1])
    command = {"type": "set_joint_params", "joint_name": joint}
    params = {"motor_target_velocity": 2.5, "motor_max_force": 40.0, "limit_upper": 0.5}
    reply = t.ask(wire, {**command, "params": params}, "joint_params_set")
    t.equal([reply["joint_name"], reply["params"]], [joint, params], "joint_name and params")
    t.refused(wire, {**command, "params": {"motor_target_velocity": 1.5, "limit_upper": -2.0}}, "invalid")
    told = t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")["params"]
    t.equal({name: told[name] for name in params}, params, "the parameters afterwards")


@case(49, "4.get_joints_for_cube", needs=("joint.fixed", "get_joints_for_cube"))
def the_joints_of_a_cube(t: Trial) -> None:
    """The joints of a cube are listed in order of creation, and those of others are not."""
    wire = t.join()
    cubes = [t.base(wire, position=t.at(n * 1.5)) for n in range(4)]
    joints = [t.join_cubes(wire, cubes[1], cubes[2]), t.join_cubes(wire, cubes[0], cubes[1])]
    for cube, expected in zip(cubes, ([joints[1]], joints, [joints[0]], []), strict=True):
        reply = t.ask(wire, {"type": "get_joints_for_cube", "cube_name": cube}, "joints_for_cube")
        t.equal([reply["cube_name"], reply["joints"]], [cube, expected], f"cube_name and joints of {cube}")


@case(50, "4.link_cube_chains", needs=("joint.fixed", "link_cube_chains"))
def linking_chains(t: Trial) -> None:
    """Neighbours in chains of cubes are joined, all of them or none, by joints that are called after them."""
    wire = t.join()
    a, b, c, d, other = (t.base(wire, position=t.at(n * 1.5 - 3)) for n in range(5))
    broken = {"type": "link_cube_chains", "chains": [[a, b], [c, "nobody-" + t.name()]]}
    t.refused(wire, broken, "cube_not_found")
    reply = t.ask(wire, {"type": "link_cube_chains", "chains": [[a, b, c], [c, d]]}, "cubes_linked")
    one, two, three = (f"joint_fixed_{cube}_{after}" for cube, after in ((a, b), (b, c), (c, d)))
    t.equal(reply["joints"], [one, two, three], "joints")
    for cube, joints in ((a, [one]), (b, [one, two]), (c, [two, three]), (d, [three]), (other, [])):
        t.equal(t.info(wire, cube)["joints"], joints, f"joints of {cube}")


@case(51, "4.link_body_cubes", needs=("joint.fixed", "link_body_cubes"))
def linking_a_body(t: Trial) -> None:
    """Cubes with a prefix that touch, or nearly touch, are joined; those farther apart and without it are not."""
    wire = t.join()
    near, gap, far = (t.base(wire, "body", position=t.at(x)) for x in (-2.0, -0.9, 1.5))
    other = t.base(wire, "other", position=t.at(2.5))
    command = {"type": "link_body_cubes", "prefix": near[: near.index("body") + len("body")]}
    joints = t.ask(wire, command, "cubes_linked")["joints"]
    t.true(len(joints) == 1, "one joint", joints)
    joints += t.ask(wire, {**command, "gap": 1.5}, "cubes_linked")["joints"]
    t.true(len(joints) == 2, "one joint more where the gap may be 1.5 m", joints)
    for cube, expected in ((near, joints[:1]), (gap, joints), (far, joints[1:]), (other, [])):
        t.equal(t.info(wire, cube)["joints"], expected, f"joints of {cube}")
