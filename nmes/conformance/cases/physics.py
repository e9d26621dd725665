"""The laws of physics, with generous tolerances: any engine keeps them, in three dimensions and in the plane.

Where time passes by the clock, a law is put so that it can be seen in one answer: a cube that fell from rest by h has
the velocity sqrt(2 g h), whenever one looks.
"""

from __future__ import annotations

import functools
import math
from typing import Any

from nmes.conformance.case import Category, Row, Scope
from nmes.conformance.cases.commands import euler, same_turn
from nmes.conformance.trial import Trial
from nmes.conformance.wire import Message, Wire

PHYSICS = Category(13, "physics")
case, table = PHYSICS.case, PHYSICS.table

G = 9.81
TIME = ("time",)
STEPS = ("stepping", "step")
STILL = 0.05  # m/s or rad/s below which a cube is called still
GIVE = 0.05  # m by which a cube may sink, hover, or hang off its joint


def fallen(t: Trial, info: Message, height: float, least: float) -> None:
    """Makes sure that a cube which fell from rest at that height by at least `least` has the velocity for it."""
    drop = height - info["position"][1]
    t.true(drop > least, f"a cube that fell by more than {least} m", f"{drop:.3f} m")
    speed = math.sqrt(2 * G * drop)
    t.close(info["linear_velocity"][1], -speed, 0.08 * speed + 0.1, f"velocity after falling {drop:.3f} m")


def tick(t: Trial) -> float:
    """Returns the length of a tick in s."""
    return 1 / t.probe.tick_rate


@table(1, "3.1.2", [Row("1-kg", 1.0), Row("1-g", 0.001), Row("1-t", 1000.0)], needs=TIME, scope=Scope.TIME)
def falling(t: Trial, mass: float) -> None:
    """A cube falls along -y with 9.81 m/s², whatever its mass."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=20), mass=mass)
    info = t.until(wire, name, 0.7, lambda info: info["position"][1] < 18.5, "a fall of 1.5 m")
    fallen(t, info, 20, 1.5)
    t.close([info["position"][0], info["position"][2]], [t.at()[0], 0.0], 0.01, "x and z")


@case(2, "3.4.1", needs=STEPS, scope=Scope.TIME)
def falling_by_the_tick(t: Trial) -> None:
    """After half a second of ticks a falling cube has half a second's velocity and way."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=20))
    ticks = round(0.5 * t.probe.tick_rate)
    t.ask(wire, {"type": "step", "ticks": ticks}, "stepped")
    info = t.info(wire, name)
    seconds = ticks / t.probe.tick_rate
    t.close(info["linear_velocity"][1], -G * seconds, 0.02 * G * seconds, "velocity")
    t.close(info["position"][1], 20 - G * seconds**2 / 2, 0.05, "height")


@case(3, "3.1.2", needs=TIME, scope=Scope.TIME)
def throwing(t: Trial) -> None:
    """A thrown cube keeps its speed along x while it falls."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(-3, 20), linear_velocity=[3, 0, 0])
    info = t.until(wire, name, 0.7, lambda info: info["position"][1] < 18.5, "a fall of 1.5 m")
    t.close(info["linear_velocity"][0], 3.0, 0.1, "velocity along x")
    way = -3.0 * info["linear_velocity"][1] / G
    t.close(info["position"][0] - t.at(-3)[0], way, 0.1 * way + 0.05, "way along x")


@case(4, "3.1.2", needs=TIME, scope=Scope.TIME)
def throwing_up(t: Trial) -> None:
    """A cube thrown up with 5 m/s rises by 1.27 m and falls again."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=10), linear_velocity=[0, 5, 0])
    highest = 0.0
    for info in t.watch(wire, name, 0.8):
        highest = max(highest, info["position"][1])
    t.close(highest, 10 + 25 / (2 * G), 0.12, "the highest point")
    t.until(wire, name, 0.5, lambda info: info["linear_velocity"][1] < 0, "a cube that falls again")


@table(
    5,
    "3.1.2",
    [Row("cube", (1.0, 0.5)), Row("large", (2.0, 1.0)), Row("flat", ([1.0, 0.2, 1.0], 0.1))],
    needs=TIME,
    scope=Scope.TIME,
)
def resting(t: Trial, row: tuple[Any, float]) -> None:
    """A cube that is put on the ground stays there, half its height above y = 0."""
    size, half = row
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=half), size=size)
    for info in t.watch(wire, name, 0.5):
        t.close(info["position"], t.at(y=half), GIVE, "position")
    t.close(info["linear_velocity"], [0.0] * 3, STILL, "velocity")


@table(6, "3.1.2", [Row("1-m", 1.5), Row("10-m", 10.0)], needs=TIME, scope=Scope.TIME)
def landing(t: Trial, height: float) -> None:
    """A cube that falls on the ground comes to rest on it, and does not fall through."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=height), restitution=0.0)

    def rests(info: Message) -> bool:
        t.true(info["position"][1] > 0.5 - 0.3, "a cube above the ground", info)
        return abs(info["position"][1] - 0.5) < GIVE and math.hypot(*info["linear_velocity"]) < STILL

    t.until(wire, name, 4.0, rests, "a cube at rest on the ground")


@case(7, "3.1.2", needs=("time", "friction"), scope=Scope.TIME)
def friction(t: Trial) -> None:
    """Friction stops a cube that slides on the ground."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(-2, 0.5), friction=1.0, linear_velocity=[2, 0, 0])
    t.until(wire, name, 2.0, lambda info: abs(info["linear_velocity"][0]) < STILL, "a cube that has stopped")
    t.true(t.info(wire, name)["position"][0] < t.at(2)[0], "a way of less than 4 m", t.info(wire, name))


@case(8, "3.4.4", needs=TIME, scope=Scope.TIME)
def impulses(t: Trial) -> None:
    """An impulse changes the velocity by impulse / mass, once."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(-3, 20), mass=2.0)
    t.ask(wire, {"type": "apply_physics", "cube_name": name, "impulse": [6, 0, 0]}, "physics_applied")
    info = t.until(wire, name, 0.1, lambda info: info["linear_velocity"][0] > 1, "a velocity along x")
    t.close(info["linear_velocity"][0], 3.0, 0.1, "velocity along x")
    for info in t.watch(wire, name, 0.3):
        t.close(info["linear_velocity"][0], 3.0, 0.1, "velocity along x later")


@table(
    9,
    "3.4.4",
    [Row("apply_physics", "apply_physics"), Row("apply_force", "apply_force", ("apply_force",))],
    needs=TIME,
    scope=Scope.TIME,
)
def forces_last_a_tick(t: Trial, kind: str) -> None:
    """A force acts during one tick: the velocity changes by force / mass · tick, and no more."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(-3, 20), mass=2.0)
    force = 2.0 * 3.0 * t.probe.tick_rate
    t.ask(wire, {"type": kind, "cube_name": name, "force": [force, 0, 0]}, "physics_applied")
    info = t.until(wire, name, 0.1, lambda info: info["linear_velocity"][0] > 1, "a velocity along x")
    t.close(info["linear_velocity"][0], 3.0, 0.1, "velocity along x after the tick")
    for info in t.watch(wire, name, 0.3):
        t.close(info["linear_velocity"][0], 3.0, 0.1, "velocity along x later")


@case(10, "3.4.4", needs=STEPS, scope=Scope.TIME)
def forces_add_up(t: Trial) -> None:
    """Forces of several commands and clients before a tick add up."""
    one, two = t.join(), t.join()
    name = t.spawn(one, position=t.at(-3, 20))
    push = {"type": "apply_physics", "cube_name": name, "force": [t.probe.tick_rate, 0, 0]}
    for wire in (one, one, two):
        t.ask(wire, push, "physics_applied")
    t.ask(one, {"type": "step"}, "stepped")
    t.close(t.info(one, name)["linear_velocity"][0], 3.0, 0.05, "velocity along x")


@case(11, "3.4.4", needs=STEPS, scope=Scope.TIME)
def a_force_before_the_tick_is_not_felt(t: Trial) -> None:
    """Until the tick, a force or impulse changes nothing."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=20))
    t.ask(
        wire, {"type": "apply_physics", "cube_name": name, "impulse": [5, 0, 0], "force": [9, 9, 0]}, "physics_applied"
    )
    info = t.info(wire, name)
    t.close(info["linear_velocity"], [0.0] * 3, 1e-9, "velocity before the tick")


@case(12, "3.1.1", needs=TIME, scope=Scope.TIME)
def an_impulse_that_turns(t: Trial) -> None:
    """An angular impulse L about z turns a cube of mass m and edge s with L / (m s² / 6)."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=20), mass=3.0)
    t.ask(wire, {"type": "apply_physics", "cube_name": name, "angular_impulse": [0, 0, 1]}, "physics_applied")
    info = t.until(wire, name, 0.1, lambda info: info["angular_velocity"][2] > 0.5, "a turn about z")
    t.close(info["angular_velocity"], [0.0, 0.0, 2.0], 0.1, "angular velocity")


@case(13, "3.1.1", needs=TIME, scope=Scope.TIME)
def torques(t: Trial) -> None:
    """A torque turns a cube during one tick."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=20))
    torque = 2.0 / 6.0 * t.probe.tick_rate
    t.ask(wire, {"type": "apply_physics", "cube_name": name, "torque": [0, 0, torque]}, "physics_applied")
    t.until(wire, name, 0.1, lambda info: info["angular_velocity"][2] > 0.5, "a turn about z")
    for info in t.watch(wire, name, 0.2):
        t.close(info["angular_velocity"][2], 2.0, 0.1, "angular velocity about z")


@table(14, "3.1.1", [Row("x", [1, 0, 0]), Row("y", [0, 1, 0])], needs=("3d", "time"), scope=Scope.TIME)
def other_axes(t: Trial, axis: list[float]) -> None:
    """An angular impulse turns a cube about its own axis, not about another."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=20))
    spin = [value / 3 for value in axis]
    t.ask(wire, {"type": "apply_physics", "cube_name": name, "angular_impulse": spin}, "physics_applied")
    info = t.until(wire, name, 0.1, lambda info: math.hypot(*info["angular_velocity"]) > 0.5, "a turn")
    t.close(info["angular_velocity"], [2.0 * value for value in axis], 0.1, "angular velocity")


@case(15, "4.apply_physics", needs=TIME, scope=Scope.TIME)
def an_impulse_off_the_centre(t: Trial) -> None:
    """An impulse upwards at the right edge moves a cube up and turns it about +z."""
    wire = t.join()
    where = t.at(y=20)
    name = t.spawn(wire, position=where)
    command = {"type": "apply_physics", "cube_name": name, "impulse": [0, 1, 0], "at": [where[0] + 0.5, 20, 0]}
    # By the clock it falls meanwhile: the point is no longer at its height, which for an impulse upwards is all one.
    t.ask(wire, command, "physics_applied")
    info = t.until(wire, name, 0.1, lambda info: abs(info["angular_velocity"][2]) > 0.5, "a turn about z")
    t.close(info["angular_velocity"][2], 3.0, 0.2, "angular velocity about z")


@case(16, "3.1.4", needs=TIME, scope=Scope.TIME)
def spinning(t: Trial) -> None:
    """A cube that spins in the air goes on spinning, and turns as fast as it says."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=30), angular_velocity=[0, 0, 3])
    turned = 0.0
    last: Message | None = None
    for info in t.watch(wire, name, 0.5):
        t.close(info["angular_velocity"][2], 3.0, 0.1, "angular velocity about z")
        if last is not None:
            turned += (info["rotation"][2] - last["rotation"][2]) % (2 * math.pi)
        last = info
    fell = -last["linear_velocity"][1] / G if last is not None else 0.0
    t.close(turned, 3.0 * fell, 0.1 * 3.0 * fell + 0.15, "turn during the fall")


@case(17, "3.6.2", needs=TIME, scope=Scope.TIME)
def frozen_cubes_stay(t: Trial) -> None:
    """A frozen cube stays where it is, in the air, whatever acts on it."""
    wire = t.join()
    name = t.base(wire, position=t.at(y=5))
    for _ in range(3):
        act = {"force": [1000, 1000, 0], "impulse": [50, 50, 0], "torque": [0, 0, 100], "angular_impulse": [0, 0, 9]}
        t.ask(wire, {"type": "apply_physics", "cube_name": name, **act}, "physics_applied")
        t.advance(wire, 0.1)
        info = t.info(wire, name)
        t.close(info["position"], t.at(y=5), 1e-6, "position")
        t.close(info["rotation"], [0.0] * 3, 1e-6, "rotation")
        t.close(info["linear_velocity"], [0.0] * 3, 1e-6, "velocity")


@case(18, "4.freeze_cube", needs=("time", "freeze_cube"), scope=Scope.TIME)
def freezing_stops(t: Trial) -> None:
    """A cube that is frozen while it falls stays there; let go, it falls again from rest."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=30))
    t.advance(wire, 0.3)
    t.ask(wire, {"type": "freeze_cube", "cube_name": name, "freeze": True}, "cube_frozen")
    where = t.info(wire, name)["position"]
    t.advance(wire, 0.2)
    t.close(t.info(wire, name)["position"], where, 1e-6, "position while frozen")
    t.ask(wire, {"type": "freeze_cube", "cube_name": name, "freeze": False}, "cube_frozen")
    info = t.until(wire, name, 0.7, lambda info: info["position"][1] < where[1] - 1, "a fall of 1 m")
    fallen(t, info, where[1], 1.0)


@case(19, "4.freeze_cube", needs=("time", "freeze_cube"), scope=Scope.TIME)
def a_base_let_go(t: Trial) -> None:
    """A base that is let go falls."""
    wire = t.join()
    name = t.base(wire, position=t.at(y=20))
    t.advance(wire, 0.1)
    t.ask(wire, {"type": "freeze_cube", "cube_name": name, "freeze": False}, "cube_frozen")
    fallen(t, t.until(wire, name, 0.7, lambda info: info["position"][1] < 19, "a fall of 1 m"), 20, 1.0)


@case(20, "3.1.2", needs=("time", "collisions"), scope=Scope.TIME)
def cubes_carry_cubes(t: Trial) -> None:
    """A cube that falls on a frozen one comes to rest on it."""
    wire = t.join()
    t.base(wire, position=t.at(y=3))
    name = t.spawn(wire, position=t.at(y=4.5))

    def rests(info: Message) -> bool:
        return abs(info["position"][1] - 4) < GIVE and math.hypot(*info["linear_velocity"]) < STILL

    t.until(wire, name, 3.0, rests, "a cube at rest on the other")


@case(21, "3.1.1", needs=("collisions", *STEPS), scope=Scope.TIME)
def momentum(t: Trial) -> None:
    """Two cubes that collide in the air keep their momentum together."""
    wire = t.join()
    one = t.spawn(wire, position=t.at(-2, 50), mass=1.0, linear_velocity=[5, 0, 0])
    two = t.spawn(wire, position=t.at(1, 50), mass=3.0, linear_velocity=[-1, 0, 0])
    t.ask(wire, {"type": "step", "ticks": round(0.8 * t.probe.tick_rate)}, "stepped")
    speeds = [t.info(wire, name)["linear_velocity"][0] for name in (one, two)]
    t.true(speeds[0] < 4.5 and speeds[1] > -0.9, "a collision", speeds)
    t.close(speeds[0] + 3 * speeds[1], 2.0, 0.1, "momentum along x")


@case(22, "4.get_cube_info", needs=("time", "contacts"), scope=Scope.TIME)
def contacts(t: Trial) -> None:
    """A cube at rest on the ground touches it with its lower face, and is carried by its weight."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=0.5), mass=2.0)
    t.advance(wire, 0.5)
    found = t.info(wire, name)["contacts"]
    t.true(bool(found), "a contact", found)
    t.equal({contact["face"] for contact in found}, {"-y"}, "the faces that touch")
    t.equal([contact["cube_name"] for contact in found], [None] * len(found), "what is touched")
    for contact in found:
        t.close(contact["normal"], [0.0, 1.0, 0.0], 0.05, "normal")
    t.close(sum(contact["force"] for contact in found), 2 * G, 0.2 * 2 * G, "the force of all contacts")


@case(23, "4.get_cube_info", needs=("time", "contacts"), scope=Scope.TIME)
def nothing_is_touched_in_the_air(t: Trial) -> None:
    """A cube that falls touches nothing."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=30))
    t.advance(wire, 0.1)
    t.equal(t.info(wire, name)["contacts"], [], "contacts")


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
    wanted = [speed * value for value in axis]
    t.until(wire, name, 1.0, lambda info: math.dist(info["angular_velocity"], wanted) < 0.1, f"turns with {wanted}")
    for info in t.watch(wire, name, 0.3):
        t.close(info["angular_velocity"], wanted, 0.15, "angular velocity")
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


@case(41, "4.set_cube_state", needs=("time", "set_cube_state"), scope=Scope.TIME)
def a_cube_put_elsewhere_moves_on(t: Trial) -> None:
    """A cube that is put somewhere with a velocity moves on from there."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=20))
    t.advance(wire, 0.2)
    state = {"position": t.at(-2, 40), "linear_velocity": [4, 0, 0], "angular_velocity": [0, 0, 1]}
    t.ask(wire, {"type": "set_cube_state", "cube_name": name, **state}, "cube_state_set")
    info = t.until(wire, name, 0.6, lambda info: info["position"][1] < 39, "a fall of 1 m from there")
    fallen(t, info, 40, 0.9)
    t.close(info["linear_velocity"][0], 4.0, 0.1, "velocity along x")
    t.close(info["angular_velocity"][2], 1.0, 0.1, "angular velocity about z")


@case(42, "3.1.3", needs=("planar", "time"), scope=Scope.TIME)
def nothing_leaves_the_plane(t: Trial) -> None:
    """In a planar world nothing moves along z or turns about x and y, whatever is said."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=20), linear_velocity=[1, 0, 5], angular_velocity=[3, 4, 1])
    act = {"force": [0, 0, 100], "impulse": [0, 0, 5], "torque": [9, 9, 0], "angular_impulse": [1, 1, 0]}
    t.ask(wire, {"type": "apply_physics", "cube_name": name, **act}, "physics_applied")
    for info in t.watch(wire, name, 0.3):
        for part, index in (("position", 2), ("linear_velocity", 2), ("rotation", 0), ("angular_velocity", 1)):
            t.equal(info[part][index], 0, f"{part}/{index}")
    t.close(info["linear_velocity"][0], 1.0, 0.1, "velocity along x")


@case(43, "3.1.4", needs=("3d", "time"), scope=Scope.TIME)
def answers_agree_while_it_tumbles(t: Trial) -> None:
    """While a cube tumbles, its rotation and its quaternion say the same, and the quaternion is of unit length."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=40), angular_velocity=[2, 3, 1])
    for info in t.watch(wire, name, 0.5):
        same_turn(t, euler(*info["rotation"]), info["quaternion"])
        t.close(math.hypot(*info["quaternion"]), 1.0, 1e-4, "length of the quaternion")


@case(44, "4.spawn_cube", needs=("time", "restitution"), scope=Scope.TIME)
def restitution(t: Trial) -> None:
    """A cube with much restitution jumps off the ground, and one without stays on it."""
    wire = t.join()
    names = [t.spawn(wire, position=t.at(x, 1.5), restitution=much) for x, much in ((-2, 0.0), (2, 0.8))]
    heights: list[list[float]] = [[], []]
    for _ in t.watch(wire, names[0], 1.5):
        for name, seen in zip(names, heights, strict=True):
            seen.append(t.info(wire, name)["position"][1])
    rises = [max(seen[seen.index(min(seen)) :]) - min(seen) for seen in heights]
    t.true(rises[0] < 0.1, "the cube without restitution on the ground", f"it rises by {rises[0]:.2f} m")
    t.true(rises[1] > 0.2, "the other one rising by more than 0.2 m", f"it rises by {rises[1]:.2f} m")
