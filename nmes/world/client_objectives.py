"""What one client calls good: its objectives over the world, and the rewards that it asks for.

Hides which cubes an objective is about once it is set, and what must be noted at every tick so that it can be asked at
any time. The quantities are `nmes.trace`'s, and so the same to the last bit as those of an episode that was evaluated.

Invariants: an objective counts from when it was set; nothing here changes the simulation; an objective of which a cube
is gone stays refused until it is set anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import dist, hypot
from typing import Any

import numpy as np
import numpy.typing as npt

from nmes import protocol
from nmes.backend import Array
from nmes.backend.rotation import rotate
from nmes.errors import WorldError
from nmes.objective import Objective
from nmes.objective.trajectory import ObservedBodies, RunningQuantities, touches
from nmes.world.entities import Cube, Entities

__all__ = ["ClientObjectives", "metric"]

JsonObject = dict[str, Any]

_MOST = 16  # objectives of one client: each may cost something at every tick


class _ClientObjective:
    """One objective, from when it was set.

    Args:
        objective: What is to be known.
        cubes: Whom it is about: the body's cubes by the ids that expressions have for them.
        others: The other cubes that it names.
        target: Where `distance` is measured from, m.
        entities: Where the cubes are.
        frame: When it is set.
    """

    def __init__(
        self,
        objective: Objective,
        cubes: Mapping[str, Cube],
        others: Mapping[str, Cube],
        target: Sequence[float] | None,
        entities: Entities,
        frame: int,
    ) -> None:
        self.objective, self.body, self.others = objective, dict(cubes), dict(others)
        self._frame = frame
        self._version = entities.version
        held = [*cubes.values(), *others.values()]
        self._cubes = held
        self._bodies = [cube.body for cube in held]
        aim = None if target is None else (float(target[0]), float(target[1]), float(target[2]))
        sizes, masses = np.array([cube.size for cube in held]), np.array([cube.mass for cube in held])
        self._cast = ObservedBodies((*cubes, *others), len(cubes), sizes, masses, entities.tick_rate, aim)
        self._touched = any(quantity.name == "contacts" for quantity in objective.needs)
        self._works = any(quantity.name == "energy" for quantity in objective.needs)
        # The motors of its body, also those that came later or are gone, and the sums of their powers.
        self._motors: list[int] = []
        self._watts: Array = np.zeros(0)
        self._metered: tuple[int, ...] | None = None  # the meter's numbers that the two lines below belong to
        self._here: npt.NDArray[np.intp] = np.zeros(0, np.intp)
        self._there: npt.NDArray[np.intp] = np.zeros(0, np.intp)
        self._tally = RunningQuantities(self._cast, objective.needs, *self._row(entities)[::2])

    def _row(self, entities: Entities) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
        simulation, bodies = entities.simulation, self._bodies
        touched = (
            touches(simulation, bodies, self._cast.body) if self._touched else np.zeros((len(bodies), 2), np.bool_)
        )
        return simulation.states(bodies), self._watts / entities.tick_rate, touched

    def missing(self, entities: Entities) -> str | None:
        """Returns the name of one of its cubes that is gone, or None."""
        if self._version != entities.version:
            self._version = entities.version
            return next((cube.name for cube in self._cubes if entities.find(cube.name) is not cube), None)
        return None

    def tick(self, entities: Entities) -> None:
        """Notes what must be noted of a tick that has just ended."""
        if self._works:
            self._meter(entities)
        if self._tally.watches:
            self._tally.add(*self._row(entities))

    def _meter(self, entities: Entities) -> None:
        meter = entities.meter
        if self._metered is not meter.numbers:
            self._metered = meter.numbers
            ours = {entities.joint(name).number for cube in self.body.values() for name in cube.joints}
            now = [number for number in meter.numbers if number in ours]
            self._motors += [number for number in sorted(now) if number not in self._motors]
            self._watts = np.append(self._watts, np.zeros(len(self._motors) - len(self._watts)))
            self._here = np.array([self._motors.index(number) for number in now], np.intp)
            self._there = np.array([meter.numbers.index(number) for number in now], np.intp)
        self._watts[self._here] += meter.powers()[self._there]

    def value(self, entities: Entities, frame: int) -> float:
        """Returns what it is worth now.

        Raises:
            WorldError: `bad_expression`: it is no finite number.
        """
        self._tally.ticks = frame - self._frame
        return self.objective.value(self._tally.values(*self._row(entities)))

    def state(self) -> JsonObject:
        """Returns all of it as plain JSON data, for `restored`."""
        return {
            "expression": self.objective.text,
            "cubes": {part: cube.name for part, cube in self.body.items()},
            "others": {part: cube.name for part, cube in self.others.items()},
            "target": None if self._cast.target is None else list(self._cast.target),
            "frame": self._frame,
            "tally": self._tally.state(),
            "motors": self._motors,
            "watts": self._watts.tolist(),
        }

    @classmethod
    def restored(cls, state: Mapping[str, Any], entities: Entities) -> _ClientObjective:
        """Returns the one of which `state` told.

        Raises:
            WorldError: Its cubes are not there, or its expression is none.
            ValueError: What it says does not fit together.
        """
        cubes, others = (
            {part: entities.cube(name) for part, name in state[key].items()} for key in ("cubes", "others")
        )
        goal = cls(Objective(state["expression"]), cubes, others, state["target"], entities, state["frame"])
        goal._tally.resume(state["tally"])
        goal._motors, goal._watts = list(state["motors"]), np.array(state["watts"], np.float64)
        return goal


class ClientObjectives:
    """The objectives of one client, by name."""

    def __init__(self) -> None:
        self._goals: dict[str, _ClientObjective] = {}
        self._lost: dict[str, str] = {}  # objectives that cannot be asked any more, and the cube that is gone

    def __len__(self) -> int:
        return len(self._goals)

    def set(self, entities: Entities, frame: int, cubes: Mapping[str, Cube], c: JsonObject) -> JsonObject:
        """Executes a `set_objective` command; returns the reply.

        Args:
            entities: Where the cubes are.
            frame: Now.
            cubes: Whom it is about, by the ids that the expression may use for them beside the cubes' names.
            c: The command.

        Raises:
            WorldError: `bad_expression`, `cube_not_found` for a cube that it names, `limit_reached`.
        """
        objective = Objective(c["expression"])
        name = c.get("name", protocol.COMMANDS["set_objective"].defaults["name"])
        if name not in self._goals and len(self._goals) >= _MOST:
            raise WorldError("limit_reached", f"this connection has its {_MOST} objectives already")
        others: dict[str, Cube] = {}
        for quantity in objective.needs:
            if quantity.cube is not None and quantity.cube not in cubes:
                others[quantity.cube] = entities.cube(quantity.cube, "expression")
            if quantity.name == "contacts":
                entities.require("contacts", "contacts", "expression")
        self._goals[name] = _ClientObjective(objective, cubes, others, c.get("target"), entities, frame)
        self._lost.pop(name, None)
        needs = [str(quantity) for quantity in objective.needs]
        return {"type": "objective_set", "name": name, "cubes": [cube.name for cube in cubes.values()], "needs": needs}

    def tick(self, entities: Entities) -> None:
        """Notes what must be noted of a tick that has just ended."""
        self._look(entities)
        for goal in self._goals.values():
            goal.tick(entities)

    def _look(self, entities: Entities) -> None:
        """Puts aside the objectives of which a cube is gone."""
        for name, goal in list(self._goals.items()):
            gone = goal.missing(entities)
            if gone is not None:
                del self._goals[name]
                self._lost[name] = gone

    def value(self, entities: Entities, frame: int, name: str | None) -> JsonObject:
        """Returns what an objective is worth now, as `reward` has it; the default one if none is named.

        Raises:
            WorldError: `invalid`: there is none; `cube_not_found`: a cube that it is about is gone; `bad_expression`:
                its value is no finite number.
        """
        self._look(entities)
        name = protocol.COMMANDS["set_objective"].defaults["name"] if name is None else name
        if name in self._lost:
            said = f"objective {name!r} is about the cube {self._lost[name]!r}, which is gone"
            raise WorldError("cube_not_found", said, "objective")
        if name not in self._goals:
            there = f"this connection has set {', '.join(map(repr, self._goals)) or 'none'}"
            raise WorldError("invalid", f"objective: there is no objective {name!r}; {there}", "objective")
        try:
            value = self._goals[name].value(entities, frame)
        except WorldError as error:
            said = error.message.removeprefix(f"{error.path}: ")
            raise WorldError(error.code, f"objective {name!r}: {said}", "objective") from error
        return {"type": "reward", "value": value, "objective": name}

    def state(self, entities: Entities) -> JsonObject:
        """Returns all of them as plain JSON data, for `restored`."""
        self._look(entities)
        return {"set": {name: goal.state() for name, goal in self._goals.items()}, "lost": self._lost}

    @classmethod
    def restored(cls, state: Mapping[str, Any], entities: Entities) -> ClientObjectives:
        """Returns those of which `state` told.

        Raises:
            WorldError: A cube is not there, or an expression is none.
            ValueError: What they say does not fit together.
        """
        objectives = cls()
        objectives._goals = {name: _ClientObjective.restored(given, entities) for name, given in state["set"].items()}
        objectives._lost = dict(state["lost"])
        return objectives


def metric(entities: Entities, cube: Cube, c: JsonObject) -> JsonObject:
    """Returns what a metric of a `compute_reward` command is for a cube, as `reward` has it."""
    name = c["metric"]
    state = entities.simulation.body_state(cube.body)
    if name == "height":
        value = state.position[1]
    elif name == "speed":
        value = hypot(*state.linear_velocity)
    elif name == "uprightness":
        value = rotate(state.quaternion, (0.0, 1.0, 0.0))[1]
    elif name == "energy":
        value = entities.work(cube)
    elif name == "distance":
        value = dist(state.position, c.get("target", cube.origin))
    else:
        axis = c.get("axis", protocol.COMMANDS["compute_reward"].defaults["axis"])
        way = (a - b for a, b in zip(state.position, cube.origin, strict=True))
        value = sum(a * b for a, b in zip(way, axis, strict=True)) / hypot(*axis)
    return {"type": "reward", "value": value, "metric": name, "cube_name": cube.name}
