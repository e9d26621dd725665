"""The laws of physics for single cubes: falling, forces and impulses, rest, contacts."""

from __future__ import annotations

import itertools
import math
from typing import Any

from nmes.conformance.case import Category, Row, Scope
from nmes.conformance.laws import GIVE, STEPS, STILL, TIME, G, fallen
from nmes.conformance.trial import Trial
from nmes.conformance.wire import Message

BODY_PHYSICS = Category(13, "physics")
case, table = BODY_PHYSICS.case, BODY_PHYSICS.table


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
    touches = t.info(wire, name)["contacts"]
    t.true(bool(touches), "a contact", touches)
    t.equal({contact["face"] for contact in touches}, {"-y"}, "the faces that touch")
    t.equal([contact["cube_name"] for contact in touches], [None] * len(touches), "what is touched")
    for contact in touches:
        t.close(contact["normal"], [0.0, 1.0, 0.0], 0.05, "normal")
    t.close(sum(contact["force"] for contact in touches), 2 * G, 0.2 * 2 * G, "the force of all contacts")


@case(23, "4.get_cube_info", needs=("time", "contacts"), scope=Scope.TIME)
def nothing_is_touched_in_the_air(t: Trial) -> None:
    """A cube that falls touches nothing."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=30))
    t.advance(wire, 0.1)
    t.equal(t.info(wire, name)["contacts"], [], "contacts")


@case(45, "3.8.1", needs=("time", "collision_groups", "config.collision_groups"), scope=Scope.TIME)
def groups(t: Trial) -> None:
    """A cube falls through a frozen one where the config lets their groups pass, and lands on it where it does not."""
    wire = t.join()
    config = t.probe.info["config"]["collision_groups"]
    passing = {frozenset((one, other)) for one, others in config.items() for other in others}
    for x, (one, other) in zip(
        (-4.0, 0.0, 4.0), itertools.combinations_with_replacement(sorted(config), 2), strict=False
    ):
        t.base(wire, position=t.at(x, 3), group=one)
        name = t.spawn(wire, position=t.at(x, 4.5), group=other)
        passes = frozenset((one, other)) in passing
        height = 0.5 if passes else 4.0

        def rests(info: Message, height: float = height) -> bool:
            return abs(info["position"][1] - height) < GIVE and math.hypot(*info["linear_velocity"]) < STILL

        t.until(wire, name, 3.0, rests, f"a cube of {other} {'below' if passes else 'at rest on'} one of {one}")


@case(46, "3.8.2", needs=("collision_groups",))
def an_unknown_group(t: Trial) -> None:
    """A cube of a group that the config has not is refused, and not made."""
    wire = t.join()
    name = t.name()
    command = {"type": "spawn_cube", "cube_name": name, "group": f"{t.probe.tag}-nobody"}
    t.equal(t.refused(wire, command, "invalid").get("field"), "group", "field")
    t.true(name not in t.cubes(wire), "no cube", name)


@case(47, "4.spawn_cube", needs=("time", "shape.sphere"), scope=Scope.TIME)
def a_ball_rests_on_its_lowest_point(t: Trial) -> None:
    """A ball that was spawned turned comes to rest at half its edge, and `cube_info` says what it is."""
    wire = t.join()
    name = t.spawn(wire, position=t.at(y=0.6), shape="sphere", rotation=[0.0, 0.0, 0.8])
    t.equal(t.info(wire, name).get("shape"), "sphere", "shape")

    def rests(info: Message) -> bool:
        return abs(info["position"][1] - 0.5) < GIVE and math.hypot(*info["linear_velocity"]) < STILL

    t.until(wire, name, 3.0, rests, "a ball at rest on the ground")


@case(48, "4.spawn_cube", needs=("shape.capsule",))
def a_capsule_that_is_none(t: Trial) -> None:
    """A capsule that is no longer than it is wide is refused, and not made."""
    wire = t.join()
    name = t.name()
    command = {"type": "spawn_cube", "cube_name": name, "shape": "capsule", "size": [1.0, 1.0, 1.0]}
    t.equal(t.refused(wire, command, "invalid").get("field"), "size", "field")
    t.true(name not in t.cubes(wire), "no cube", name)
