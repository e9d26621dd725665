"""Objectives and metrics: what they are worth, from when they count, and how a bad expression is refused."""

from __future__ import annotations

import math
from typing import Any

from nmes.conformance.case import Category, Row, Scope
from nmes.conformance.trial import Trial
from nmes.conformance.wire import Wire

OBJECTIVES = Category(19, "objectives")
case, table = OBJECTIVES.case, OBJECTIVES.table

SET, ASK = "set_objective", "compute_reward"
CLOSE = 1e-6


def aim(t: Trial, wire: Wire, expression: str, **fields: Any) -> None:
    """Sets an objective."""
    t.ask(wire, {"type": SET, "expression": expression, **fields}, "objective_set")


def worth(t: Trial, wire: Wire, **fields: Any) -> float:
    """Asks for the value of an objective or a metric."""
    return float(t.ask(wire, {"type": ASK, **fields}, "reward")["value"])


def put(t: Trial, wire: Wire, cube: str, **state: Any) -> None:
    """Puts a cube somewhere."""
    t.ask(wire, {"type": "set_cube_state", "cube_name": cube, **state}, "cube_state_set")


@table(
    1,
    "4.set_objective",
    [
        Row("precedence", ("1 + 2 * 3", 7)),
        Row("parentheses", ("(1 + 2) * 3", 9)),
        Row("whole-numbers-are-doubles", ("1 / 2", 0.5)),
        Row("minus", ("-2 - -3", 1)),
        Row("max", ("max(1, 3, 2)", 3)),
        Row("min", ("min(4, 3)", 3)),
        Row("functions", ("abs(-2) + sqrt(16) + exp(0) + log(1)", 7)),
        Row("a-choice", ("1 > 2 ? 3 : 4", 4)),
        Row("logic", ("!(1 > 2) && (2 >= 2 || 1 == 2) ? 5 : 6", 5)),
        Row("a-quantity", ("2 * height", 6)),
        Row("counts", ("cubes + mass", 3.5)),
    ],
    needs=(SET, ASK),
)
def expressions(t: Trial, row: tuple[str, float]) -> None:
    """An expression is worth what it says, of the cube at a height of 3 m that it is about."""
    wire = t.join()
    expression, value = row
    aim(t, wire, expression, cubes=[t.base(wire, mass=2.5)])
    t.close(worth(t, wire), value, CLOSE, f"the value of {expression}")


@table(
    2,
    "4.error.bad_expression",
    [
        Row("cut-off", "height +"),
        Row("two-signs", "1 +* 2"),
        Row("nothing", ""),
        Row("unknown-quantity", "heigth"),
        Row("unknown-function", "run(1)"),
        Row("a-list", "[1, 2]"),
        Row("text", "'height'"),
        Row("a-loop", "[1].all(x, x > 0)"),
        Row("no-number", "height > 1"),
        Row("two-expressions", "height; height"),
        Row("too-few-arguments", "max()"),
        Row("a-number-too-large", "1e400"),
    ],
    needs=(SET, ASK),
)
def bad_expressions(t: Trial, expression: str) -> None:
    """A bad expression is refused with its place, and the objective that was set before stays."""
    wire = t.join()
    cube = t.base(wire)
    aim(t, wire, "height", cubes=[cube])
    command = {"type": SET, "expression": expression, "cubes": [cube]}
    reply = t.refused(wire, command, "bad_expression", "expression")
    t.should(any(sign.isdigit() for sign in reply["message"]), "a message with the place of the mistake", reply)
    t.close(worth(t, wire), 3.0, CLOSE, "the objective that was set before")


@case(3, "4.set_objective", needs=(SET, ASK, "set_cube_state"))
def from_when_it_was_set(t: Trial) -> None:
    """An objective counts from when it was set, each by itself, also while others are set and replaced."""
    wire = t.join()
    cube = t.base(wire, position=t.at(0))
    aim(t, wire, "displacement.x", name="first", cubes=[cube])
    put(t, wire, cube, position=t.at(2))
    aim(t, wire, "displacement.x", name="second", cubes=[cube])
    t.close(worth(t, wire, objective="first"), 2.0, CLOSE, "the first objective")
    t.close(worth(t, wire, objective="second"), 0.0, CLOSE, "the second objective")
    put(t, wire, cube, position=t.at(3))
    aim(t, wire, "10 + displacement.x", name="first", cubes=[cube])
    t.close(worth(t, wire, objective="first"), 10.0, CLOSE, "the first objective, replaced")
    t.close(worth(t, wire, objective="second"), 1.0, CLOSE, "the second objective")


@case(4, "4.set_objective", needs=(SET, ASK))
def objectives_are_each_clients_own(t: Trial) -> None:
    """Nobody else's objective is asked or replaced."""
    one, two = t.join(), t.join()
    cube = t.base(one)
    aim(t, one, "1", cubes=[cube])
    t.refused(two, {"type": ASK}, "invalid", "objective")
    aim(t, two, "2", cubes=[cube])
    t.equal([worth(t, one), worth(t, two)], [1.0, 2.0], "what each is worth to its own client")


@case(5, "4.set_objective", needs=(SET, ASK))
def the_cube_spawned_last(t: Trial) -> None:
    """Without cubes and a creature, an objective is about the cube that this connection spawned last."""
    wire, other = t.join(), t.join()
    t.base(wire, position=t.at(y=2))
    t.base(wire, position=t.at(y=5))
    t.base(other, position=t.at(y=8))
    aim(t, wire, "height")
    t.close(worth(t, wire), 5.0, CLOSE, "height")


@case(6, "4.set_objective", needs=(SET, ASK))
def the_distance_from_a_target(t: Trial) -> None:
    """With a target, distance is measured from there; of several cubes, from their centre of mass."""
    wire = t.join()
    cubes = [t.base(wire, position=t.at(x), mass=mass) for x, mass in ((0, 1), (4, 3))]
    aim(t, wire, "distance", cubes=cubes, target=t.at(3, 7))
    t.close(worth(t, wire), 4.0, CLOSE, "distance")


@case(7, "4.set_objective", needs=(SET, ASK))
def another_cube_by_its_name(t: Trial) -> None:
    """An expression names other cubes of the world; one that there is not gets cube_not_found."""
    wire = t.join()
    one, two = t.base(wire), t.base(wire, position=t.at(2, 5))
    aim(t, wire, f'cube("{two}").height - height', cubes=[one])
    t.close(worth(t, wire), 2.0, CLOSE, "how much higher the other is")
    t.refused(wire, {"type": SET, "expression": 'cube("nobody").height', "cubes": [one]}, "cube_not_found")
    t.refused(wire, {"type": SET, "expression": "height", "cubes": ["nobody"]}, "cube_not_found")


@case(8, "4.compute_reward", needs=(SET, ASK))
def a_cube_that_is_gone(t: Trial) -> None:
    """An objective about a cube that is gone is refused, though another of its name has come."""
    wire = t.join()
    cube = t.spawn(wire)
    aim(t, wire, "height", cubes=[cube])
    t.ask(wire, {"type": "despawn_cube", "cube_name": cube}, "cube_despawned")
    t.refused(wire, {"type": ASK}, "cube_not_found")
    t.spawn(wire, cube_name=cube)
    t.refused(wire, {"type": ASK}, "cube_not_found")
    aim(t, wire, "height", cubes=[cube])
    worth(t, wire)


@case(9, "4.compute_reward", needs=(SET, ASK))
def a_value_that_is_no_number(t: Trial) -> None:
    """An objective that divides by zero gets bad_expression when it is asked, and only then."""
    wire = t.join()
    aim(t, wire, "1 / (height - height)", cubes=[t.base(wire)])
    t.refused(wire, {"type": ASK}, "bad_expression")
    t.fence(wire)


@case(10, "4.set_objective", needs=(SET, ASK))
def sixteen_objectives(t: Trial) -> None:
    """A connection has 16 objectives; one more gets limit_reached, and one of the same name replaces."""
    wire = t.join()
    cube = t.base(wire)
    for n in range(16):
        aim(t, wire, str(n), name=f"o{n}", cubes=[cube])
    t.refused(wire, {"type": SET, "expression": "1", "name": "o16", "cubes": [cube]}, "limit_reached")
    aim(t, wire, "99", name="o3", cubes=[cube])
    t.equal([worth(t, wire, objective=f"o{n}") for n in (2, 3, 15)], [2.0, 99.0, 15.0], "values")


@case(11, "4.set_objective", needs=(SET, ASK, "set_cube_state", "stepping"), scope=Scope.TIME)
def over_time(t: Trial) -> None:
    """Words before a quantity say what is made of it over the ticks: start, min, max, mean, final."""
    wire = t.join()
    cube = t.base(wire, position=t.at(y=3))
    for name in ("start", "min", "max", "mean", "final"):
        aim(t, wire, f"{name}.height", name=name, cubes=[cube])
    aim(t, wire, "time", name="time", cubes=[cube])
    for y in (6.0, 2.0, 5.0):
        put(t, wire, cube, position=t.at(y=y))
        t.ask(wire, {"type": "step"}, "stepped")
    expected = {"start": 3.0, "min": 2.0, "max": 6.0, "mean": 4.0, "final": 5.0, "time": 3 / t.probe.tick_rate}
    for name, value in expected.items():
        t.close(worth(t, wire, objective=name), value, CLOSE, name)


@case(12, "4.compute_reward", needs=(SET, ASK, "stepping"), scope=Scope.TIME)
def asking_changes_nothing(t: Trial) -> None:
    """What is asked at every tick is worth the same in the end as what is asked once."""
    wire = t.join()
    cube = t.spawn(wire, linear_velocity=[1, 2, 0])
    for name in ("often", "once"):
        aim(t, wire, "max.height + mean.speed", name=name, cubes=[cube])
    for _ in range(20):
        t.ask(wire, {"type": "step"}, "stepped")
        worth(t, wire, objective="often")
    t.equal(worth(t, wire, objective="often"), worth(t, wire, objective="once"), "the value")


@table(
    13,
    "4.compute_reward",
    [
        Row("distance", ({"metric": "distance"}, 5.0)),
        Row("distance-from-a-target", ({"metric": "distance", "target": (0, 0)}, math.hypot(3, 7))),
        Row("displacement", ({"metric": "displacement"}, 3.0)),
        Row("displacement-along-an-axis", ({"metric": "displacement", "axis": [0, -2, 0]}, -4.0)),
        Row("height", ({"metric": "height"}, 7.0)),
        Row("uprightness", ({"metric": "uprightness"}, math.cos(0.5))),
        Row("energy", ({"metric": "energy"}, 0.0)),
    ],
    needs=(ASK, "set_cube_state"),
)
def metrics(t: Trial, row: tuple[dict[str, Any], float]) -> None:
    """A metric is what the state of its cube says, counted from where it was spawned."""
    wire = t.join()
    fields, value = row
    cube = t.base(wire, position=t.at(0, 3))
    put(t, wire, cube, position=t.at(3, 7), rotation=[0, 0, 0.5])
    if "target" in fields:
        fields = {**fields, "target": t.at(*fields["target"])}
    reply = t.ask(wire, {"type": ASK, "cube": cube, **fields}, "reward")
    t.close(reply["value"], value, 1e-3, fields["metric"])
    t.should(reply.get("metric") == fields["metric"] and reply.get("cube_name") == cube, "metric and cube_name", reply)


@case(14, "4.compute_reward", needs=(ASK, "stepping"), scope=Scope.TIME)
def metrics_in_motion(t: Trial) -> None:
    """The metrics speed and height are those of the cube's state, tick after tick."""
    wire = t.join()
    cube = t.spawn(wire, position=t.at(y=30), linear_velocity=[2, 1, 0])
    for _ in range(5):
        t.ask(wire, {"type": "step", "ticks": 5}, "stepped")
        info = t.info(wire, cube)
        t.close(worth(t, wire, metric="height", cube=cube), info["position"][1], CLOSE, "height")
        t.close(worth(t, wire, metric="speed", cube=cube), math.hypot(*info["linear_velocity"]), CLOSE, "speed")


@case(15, "4.compute_reward", needs=(ASK, "joint.hinge", "stepping"), scope=Scope.TIME)
def motors_spend_energy(t: Trial) -> None:
    """What a motor has worked is in the energy of both its cubes, and does not become less."""
    wire = t.join()
    base, wheel = t.base(wire, position=t.at(0, 5)), t.spawn(wire, position=t.at(2, 5), mass=2)
    motor = {"position": t.at(2, 5), "axis": [0, 0, 1], "motor_target_velocity": 5, "motor_max_force": 20}
    t.join_cubes(wire, base, wheel, "hinge", **motor)
    spent = []
    for _ in range(4):
        t.advance(wire, 0.25)
        spent.append(worth(t, wire, metric="energy", cube=wheel))
        t.close(worth(t, wire, metric="energy", cube=base), spent[-1], CLOSE, "energy of the other cube")
    t.true(spent[0] > 0 and spent == sorted(spent), "energy that begins above 0 and grows", spent)
    # A cube of 1 m and 2 kg turning at 5 rad/s has 1/2 * 1/3 * 25 J.
    t.close(spent[-1], 25 / 6, 1.5, "energy")


@case(16, "4.compute_reward", needs=(SET, ASK))
def a_metric_or_an_objective(t: Trial) -> None:
    """A metric and an objective together get invalid, and so does an objective that was not set."""
    wire = t.join()
    aim(t, wire, "1", cubes=[t.base(wire)])
    t.refused(wire, {"type": ASK, "objective": "objective", "metric": "height"}, "invalid")
    t.refused(wire, {"type": ASK, "objective": "another"}, "invalid", "objective")


@case(17, "4.set_objective", needs=(SET, ASK, "lockstep", "reset"), scope=Scope.WORLD)
def a_reset_forgets_objectives(t: Trial) -> None:
    """After a reset no objective is set."""
    wire = t.join()
    aim(t, wire, "1", cubes=[t.base(wire)])
    t.ask(wire, {"type": "reset"}, "world_reset")
    t.refused(wire, {"type": ASK}, "invalid")
