"""The laws of physics, with generous tolerances: any engine keeps them, in three dimensions and in the plane.

Where time passes by the clock, a law is put so that it can be seen in one answer: a cube that fell from rest by h has
the velocity sqrt(2 g h), whenever one looks.

Those for single cubes and for joints have files of their own.
"""

from __future__ import annotations

import math

from nmes.conformance.case import Category, Scope
from nmes.conformance.cases.body_physics import BODY_PHYSICS
from nmes.conformance.cases.joint_physics import JOINT_PHYSICS
from nmes.conformance.laws import fallen
from nmes.conformance.rotation import euler, same_turn
from nmes.conformance.trial import Trial

PHYSICS = Category(13, "physics", parts=(BODY_PHYSICS, JOINT_PHYSICS))
case = PHYSICS.case


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
        for name, curve in zip(names, heights, strict=True):
            curve.append(t.info(wire, name)["position"][1])
    rises = [max(curve[curve.index(min(curve)) :]) - min(curve) for curve in heights]
    t.true(rises[0] < 0.1, "the cube without restitution on the ground", f"it rises by {rises[0]:.2f} m")
    t.true(rises[1] > 0.2, "the other one rising by more than 0.2 m", f"it rises by {rises[1]:.2f} m")
