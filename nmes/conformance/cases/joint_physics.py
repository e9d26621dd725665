"""The laws of physics for cubes that are joined: what joints hold, what motors, servos and limits do."""

from __future__ import annotations

import functools
import math
from typing import Any

from nmes.conformance.case import Category, Row, Scope
from nmes.conformance.laws import GIVE, STEPS, STILL, fallen
from nmes.conformance.rotation import same_turn
from nmes.conformance.trial import Trial
from nmes.conformance.wire import Message, Wire

JOINT_PHYSICS = Category(13, "physics")
case, table = JOINT_PHYSICS.case, JOINT_PHYSICS.table


# -- joints -----------------------------------------------------------------------------------------------------------


def pair(t: Trial, wire: Wire, kind: str, y: float = 30.0, **spin: Any) -> tuple[str, str, str]:
    """Returns two cubes side by side in the air, and their joint."""
    one = t.spawn(wire, position=t.at(-0.75, y), **spin)
    two = t.spawn(wire, position=t.at(0.75, y))
    return one, two, t.join_cubes(wire, one, two, kind)


@case(24, "4.create_joint", needs=("time", "joint.fixed"), scope=Scope.TIME)
def fixed_joints_hold(t: Trial) -> None:
    """Two cubes joined fast fly, and turn, as one."""
    wire = t.join()
    one, two, _ = pair(t, wire, "fixed")
    push = {"type": "apply_physics", "cube_name": two, "impulse": [0, 3, 0]}
    t.ask(wire, push, "physics_applied")
    t.advance(wire, 0.5)
    first, second = together(t, wire, one, two)
    t.close(math.dist(first["position"], second["position"]), 1.5, GIVE, "distance")
    if t.probe.stepping:  # by the clock the two may be told at different moments
        same_turn(t, second["quaternion"], first["quaternion"])
    t.true(abs(first["rotation"][2]) > 0.2, "a pair that turns", first["rotation"])


def together(t: Trial, wire: Wire, one: str, two: str) -> tuple[Any, Any]:
    """Returns the states of two cubes at one moment, as far as the server can tell them so."""
    if t.probe.claims("get_world_state"):
        first, second = t.ask(wire, {"type": "get_world_state", "cubes": [one, two]}, "world_state")["cubes"]
        return first, second
    wire.say({"type": "get_cube_info", "cube_name": one}, {"type": "get_cube_info", "cube_name": two})
    return wire.reply("cube_info"), wire.reply("cube_info")


@case(25, "4.create_joint", needs=("time", "joint.fixed"), scope=Scope.TIME)
def a_fixed_joint_to_a_base_carries(t: Trial) -> None:
    """A cube joined fast to a base hangs in the air."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(y=5)), t.spawn(wire, position=t.at(1.25, 5))
    t.join_cubes(wire, base, name)
    for info in t.watch(wire, name, 0.5):
        t.close(info["position"], t.at(1.25, 5), GIVE, "position")


@case(26, "4.remove_joint", needs=("time", "joint.fixed", "remove_joint"), scope=Scope.TIME)
def a_removed_joint_lets_go(t: Trial) -> None:
    """A cube whose joint is removed falls."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(y=15)), t.spawn(wire, position=t.at(1.25, 15))
    joint = t.join_cubes(wire, base, name)
    t.advance(wire, 0.2)
    t.ask(wire, {"type": "remove_joint", "joint_name": joint}, "joint_removed")
    fallen(t, t.until(wire, name, 0.7, lambda info: info["position"][1] < 14, "a fall of 1 m"), 15, 0.9)


@case(27, "4.despawn_cube", needs=("time", "joint.fixed"), scope=Scope.TIME)
def a_despawned_base_lets_go(t: Trial) -> None:
    """A cube whose base is despawned falls."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(y=15)), t.spawn(wire, position=t.at(1.25, 15))
    t.join_cubes(wire, base, name)
    t.advance(wire, 0.2)
    t.ask(wire, {"type": "despawn_cube", "cube_name": base}, "cube_despawned")
    fallen(t, t.until(wire, name, 0.7, lambda info: info["position"][1] < 14, "a fall of 1 m"), 15, 0.9)


@case(28, "4.create_joint", needs=("time", "joint.hinge"), scope=Scope.TIME)
def a_hinge_is_a_pendulum(t: Trial) -> None:
    """A cube on a hinge swings about the anchor, at its distance."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(-1, 10)), t.spawn(wire, position=t.at(1, 10))
    t.join_cubes(wire, base, name, "hinge", position=t.at(0, 10))
    lowest = 10.0
    for info in t.watch(wire, name, 1.0):
        t.close(math.dist(info["position"], t.at(0, 10)), 1.0, GIVE, "distance from the anchor")
        lowest = min(lowest, info["position"][1])
    t.true(lowest < 9.3, "a cube that swings down", f"lowest at {lowest:.2f} m")


@case(29, "4.create_joint", needs=("3d", "time", "joint.hinge"), scope=Scope.TIME)
def a_hinge_turns_about_its_axis_only(t: Trial) -> None:
    """A hinge about y carries a cube, which turns about y and about nothing else."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(-1, 10)), t.spawn(wire, position=t.at(1, 10))
    t.join_cubes(wire, base, name, "hinge", position=t.at(0, 10), axis=[0, 1, 0])
    t.ask(wire, {"type": "apply_physics", "cube_name": name, "angular_impulse": [1, 2, 1]}, "physics_applied")
    turned = 0.0
    for info in t.watch(wire, name, 0.5):
        t.close(info["position"][1], 10.0, GIVE, "height")
        t.close([info["angular_velocity"][0], info["angular_velocity"][2]], [0.0, 0.0], 0.2, "turns about x and z")
        turned = max(turned, abs(info["angular_velocity"][1]))
    t.true(turned > 0.3, "a turn about y", turned)


@case(30, "4.create_joint", needs=("time", "joint.slide"), scope=Scope.TIME)
def a_slide_slides_along_its_axis_only(t: Trial) -> None:
    """A slide along x carries a cube, which moves along x and does not turn."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(-2, 10)), t.spawn(wire, position=t.at(0, 10))
    t.join_cubes(wire, base, name, "slide")
    t.ask(wire, {"type": "apply_physics", "cube_name": name, "impulse": [2, 1, 0]}, "physics_applied")
    for info in t.watch(wire, name, 0.5):
        t.close(info["position"][1:], [10.0, 0.0], GIVE, "y and z")
        t.close(info["rotation"], [0.0] * 3, GIVE, "rotation")
    t.true(info["position"][0] > t.at(0.3)[0], "a cube that slides along x", info["position"])


@case(31, "4.create_joint", needs=("time", "joint.slide"), scope=Scope.TIME)
def a_slide_downwards_falls(t: Trial) -> None:
    """A cube on a slide along y falls, straight down."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(-2, 10)), t.spawn(wire, position=t.at(0, 10))
    t.join_cubes(wire, base, name, "slide", axis=[0, 1, 0])
    info = t.until(wire, name, 0.6, lambda info: info["position"][1] < 9.2, "a fall of 0.8 m")
    t.close(info["position"][0], t.at()[0], GIVE, "x")
    t.close(info["rotation"], [0.0] * 3, GIVE, "rotation")


@case(32, "4.create_joint", needs=("joint.hinge", *STEPS), scope=Scope.TIME)
def joints_keep_momentum(t: Trial) -> None:
    """A joint inside a pair in free flight changes nothing of its momentum."""
    wire = t.join()
    one = t.spawn(wire, position=t.at(-0.75, 50), linear_velocity=[1, 0, 0], angular_velocity=[0, 0, 2])
    two = t.spawn(wire, position=t.at(0.75, 50), mass=2.0)
    t.join_cubes(wire, one, two, "hinge")
    t.ask(wire, {"type": "step"}, "stepped")

    def total() -> float:
        first, second = together(t, wire, one, two)
        return float(first["linear_velocity"][0] + 2 * second["linear_velocity"][0])

    before = total()
    t.ask(wire, {"type": "step", "ticks": round(0.5 * t.probe.tick_rate)}, "stepped")
    t.close(total(), before, 0.05, "momentum along x")


@case(33, "4.create_joint", needs=("time", "joint.hinge"), scope=Scope.TIME)
def joined_cubes_do_not_collide(t: Trial) -> None:
    """Cubes that are joined may overlap and do not push each other."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(0, 10)), t.spawn(wire, position=t.at(0, 9.5))
    t.join_cubes(wire, base, name, "hinge", position=t.at(0, 10))
    for info in t.watch(wire, name, 0.3):
        t.close(info["position"], t.at(0, 9.5), GIVE, "position")


# -- motors -----------------------------------------------------------------------------------------------------------


@table(
    34,
    "4.set_joint_param",
    [
        Row("about-z", ([0, 0, 1], 2.0)),
        Row("backwards", ([0, 0, 1], -2.0)),
        Row("about-minus-z", ([0, 0, -1], 2.0)),
        Row("about-y", ([0, 1, 0], 2.0), ("3d",)),
        Row("about-x", ([1, 0, 0], 2.0), ("3d",)),
    ],
    needs=("time", "joint.hinge", "motor"),
    scope=Scope.TIME,
)
def hinge_motors(t: Trial, row: tuple[list[float], float]) -> None:
    """A hinge's motor turns the second cube about the axis, with the velocity that it is set to."""
    axis, speed = row
    wire = t.join()
    base, name = t.base(wire, position=t.at(-3, 10)), t.spawn(wire, position=t.at(0, 10))
    joint = t.join_cubes(wire, base, name, "hinge", position=t.at(0, 10), axis=axis)
    set_params(t, wire, joint, motor_max_force=1000, motor_target_velocity=speed)
    velocity = [speed * value for value in axis]
    t.until(wire, name, 1.0, lambda info: math.dist(info["angular_velocity"], velocity) < 0.1, f"turns with {velocity}")
    for info in t.watch(wire, name, 0.3):
        t.close(info["angular_velocity"], velocity, 0.15, "angular velocity")
        t.close(info["position"], t.at(0, 10), GIVE, "position")


def set_params(t: Trial, wire: Wire, joint: str, **params: float | bool) -> None:
    """Sets parameters of a joint."""
    for name, value in params.items():
        command = {"type": "set_joint_param", "joint_name": joint, "param_name": name, "value": value}
        t.ask(wire, command, "joint_param_set")


@case(35, "4.set_joint_param", needs=("time", "joint.slide", "motor"), scope=Scope.TIME)
def slide_motors(t: Trial) -> None:
    """A slide's motor moves the second cube along the axis, with the velocity that it is set to."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(-4, 10)), t.spawn(wire, position=t.at(-2, 10))
    joint = t.join_cubes(wire, base, name, "slide", motor_target_velocity=1.5, motor_max_force=1000)
    t.until(wire, name, 1.0, lambda info: abs(info["linear_velocity"][0] - 1.5) < 0.1, "1.5 m/s along x")
    set_params(t, wire, joint, motor_target_velocity=-1.0)
    t.until(wire, name, 1.0, lambda info: abs(info["linear_velocity"][0] + 1.0) < 0.1, "-1 m/s along x")


@case(36, "4.set_joint_param", needs=("time", "joint.hinge", "motor"), scope=Scope.TIME)
def a_motor_switched_off(t: Trial) -> None:
    """A motor that is switched off, or has no force, drives nothing."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(-3, 10)), t.spawn(wire, position=t.at(0, 10))
    joint = t.join_cubes(wire, base, name, "hinge", position=t.at(0, 10))
    set_params(t, wire, joint, motor_target_velocity=3, motor_enabled=False)
    t.advance(wire, 0.3)
    t.close(t.info(wire, name)["angular_velocity"][2], 0.0, STILL, "angular velocity while switched off")
    set_params(t, wire, joint, motor_max_force=0, motor_enabled=True)
    t.advance(wire, 0.3)
    t.close(t.info(wire, name)["angular_velocity"][2], 0.0, STILL, "angular velocity without force")


@case(37, "4.set_joint_param", needs=("time", "joint.slide", "motor"), scope=Scope.TIME)
def a_weak_motor(t: Trial) -> None:
    """A motor gives no more than its largest force: 1 N moves 2 kg by 0.25 m in the first second."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(-4, 10)), t.spawn(wire, position=t.at(-2, 10), mass=2.0)
    t.join_cubes(wire, base, name, "slide", motor_max_force=1, motor_target_velocity=50)
    info = t.until(wire, name, 1.5, lambda info: info["linear_velocity"][0] > 0.3, "a cube that speeds up")
    way, speed = info["position"][0] - t.at(-2)[0], info["linear_velocity"][0]
    t.close(speed, math.sqrt(2 * 0.5 * way), 0.1, f"velocity after {way:.3f} m with 1 N / 2 kg")


@table(
    38,
    "4.set_joint_param",
    [Row("upwards", 3.0), Row("downwards", -3.0)],
    needs=("time", "joint.hinge", "motor", "limits"),
    scope=Scope.TIME,
)
def limits_hold(t: Trial, speed: float) -> None:
    """A motor does not drive a joint over its limits."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(-3, 10)), t.spawn(wire, position=t.at(0, 10))
    fields = {"limits": [-0.5, 0.5], "motor_max_force": 20, "motor_target_velocity": speed}
    t.join_cubes(wire, base, name, "hinge", position=t.at(0, 10), **fields)
    for info in t.watch(wire, name, 0.8):
        t.true(abs(info["rotation"][2]) < 0.65, "a turn of no more than 0.5 rad", info["rotation"])
    t.close(info["rotation"][2], math.copysign(0.5, speed), 0.15, "rotation in the end")


@case(39, "4.set_joint_param", needs=("time", "joint.hinge", "servo"), scope=Scope.TIME)
def servos(t: Trial) -> None:
    """A servo takes its joint to the position that it is set to."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(-3, 10)), t.spawn(wire, position=t.at(0, 10))
    joint = t.join_cubes(wire, base, name, "hinge", position=t.at(0, 10), motor_max_force=1000)
    for target in (0.8, -0.4):
        set_params(t, wire, joint, target_position=target)
        t.until(wire, name, 4.0, functools.partial(turned_to, target), f"a turn to {target} rad")


def turned_to(angle: float, info: Message) -> bool:
    """Whether a cube is turned by an angle about z."""
    return abs(float(info["rotation"][2]) - angle) < 0.05


@case(40, "4.get_joint_info", needs=("time", "joint.hinge", "motor", "get_joint_info"), scope=Scope.TIME)
def a_joint_tells_its_motion(t: Trial) -> None:
    """A joint's position and velocity are those of its second cube against its first."""
    wire = t.join()
    base, name = t.base(wire, position=t.at(-3, 10)), t.spawn(wire, position=t.at(0, 10))
    joint = t.join_cubes(wire, base, name, "hinge", position=t.at(0, 10), motor_target_velocity=1, motor_max_force=1000)
    t.until(wire, name, 1.0, lambda info: info["rotation"][2] > 0.4, "a turn of 0.4 rad")
    cube = t.info(wire, name)
    info = t.ask(wire, {"type": "get_joint_info", "joint_name": joint}, "joint_info")
    t.close(info["position"], cube["rotation"][2], 0.1, "position")
    t.close(info["velocity"], cube["angular_velocity"][2], 0.1, "velocity")
