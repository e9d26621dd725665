"""The objectives of one client over the wire, and the metrics of `compute_reward`.

Hides which cubes an objective observes once it is set, and what is measured at every tick so that its value can be
asked for at any time. The quantities are those of `nmes.objective.trajectory`, the same to the last bit as those of an
episode that was evaluated.

Invariants: an objective counts from when it was set; nothing here changes the simulation; an objective that observes a
cube which is gone stays refused until it is set anew.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from math import dist, hypot
from typing import Any

import numpy as np
import numpy.typing as npt

from nmes import protocol
from nmes.backend import Array
from nmes.backend.rotation import rotate, total
from nmes.errors import SimulationFault, WorldError
from nmes.objective import Objective
from nmes.objective.trajectory import ObservedBodies, RunningQuantities, touches
from nmes.schemas.documents import JsonObject
from nmes.world.entities import Cube, Entities

__all__ = ["ClientObjectives", "metric"]

logger = logging.getLogger(__name__)

_MOST_OBJECTIVES = 16  # objectives of one client: each may cost something at every tick
_ANYWHERE = frozenset({"cubes", "energy", "mass", "time", "work"})  # quantities of no place


class _ClientObjective:
    """One objective, from when it was set.

    Args:
        objective: The expression.
        cubes: The body that it observes: its cubes by the ids that expressions have for them.
        others: The other cubes that the expression names.
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
        self._cubes = [*cubes.values(), *others.values()]
        self._numbers = [cube.body for cube in self._cubes]
        aim = None if target is None else (float(target[0]), float(target[1]), float(target[2]))
        sizes = np.array([cube.size for cube in self._cubes])
        masses = np.array([cube.mass for cube in self._cubes])
        shapes = tuple(cube.shape for cube in self._cubes)
        self._observed = ObservedBodies((*cubes, *others), len(cubes), sizes, masses, entities.tick_rate, aim, shapes)
        self._uses_contacts = any(quantity.name == "contacts" for quantity in objective.needs)
        self._uses_states = any(quantity.name not in _ANYWHERE for quantity in objective.needs)
        self._uses_energy = any(quantity.name in ("energy", "work") for quantity in objective.needs)
        # The motors of its body, also those that came later or are gone, and the sums of their powers.
        self._motors: list[int] = []
        self._watts: Array = np.zeros(0)
        self._metered: tuple[int, ...] | None = None  # the meter's numbers that the two lines below belong to
        self._here: npt.NDArray[np.intp] = np.zeros(0, np.intp)
        self._there: npt.NDArray[np.intp] = np.zeros(0, np.intp)
        self._quantities = RunningQuantities(self._observed, objective.needs, *self._row(entities)[::2])

    def _row(self, entities: Entities) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
        """Returns the states, the motors' work and the contacts now, as `RunningQuantities.add` takes them."""
        simulation, numbers = entities.simulation, self._numbers
        if self._uses_contacts:
            contacts = touches(simulation, numbers, self._observed.body)
        else:
            contacts = np.zeros((len(numbers), 2), np.bool_)
        # To read where cubes are costs as much as all the rest.
        states = simulation.states(numbers) if self._uses_states else np.zeros((len(numbers), 13))
        return states, self._watts / entities.tick_rate, contacts

    def missing(self, entities: Entities) -> str | None:
        """Returns the name of one of its cubes that is gone, or None."""
        if self._version != entities.version:
            self._version = entities.version
            return next((cube.name for cube in self._cubes if entities.cubes.get(cube.name) is not cube), None)
        return None

    def tick(self, entities: Entities) -> None:
        """Measures the quantities after a tick, where they need every tick."""
        if self._uses_energy:
            self._meter(entities)
        if self._quantities.watches:
            self._quantities.add(*self._row(entities))

    def _meter(self, entities: Entities) -> None:
        """Adds the power of each motor of the body in the last tick."""
        meter = entities.meter
        if self._metered is not meter.numbers:
            self._metered = meter.numbers
            own = {entities.joint(name).number for cube in self.body.values() for name in cube.joints}
            now = [number for number in meter.numbers if number in own]
            self._motors += [number for number in sorted(now) if number not in self._motors]
            self._watts = np.append(self._watts, np.zeros(len(self._motors) - len(self._watts)))
            self._here = np.array([self._motors.index(number) for number in now], np.intp)
            self._there = np.array([meter.numbers.index(number) for number in now], np.intp)
        self._watts[self._here] += meter.powers()[self._there]

    def value(self, entities: Entities, frame: int) -> float:
        """Returns the objective's value now.

        Raises:
            WorldError: `bad_expression`: it is no finite number.
        """
        self._quantities.ticks = frame - self._frame
        return self.objective.value(self._quantities.values(*self._row(entities)))

    def state(self) -> JsonObject:
        """Returns the objective as plain JSON data, for `restored`."""
        return {
            "expression": self.objective.text,
            "cubes": {part: cube.name for part, cube in self.body.items()},
            "others": {part: cube.name for part, cube in self.others.items()},
            "target": None if self._observed.target is None else list(self._observed.target),
            "frame": self._frame,
            "tally": self._quantities.state(),
            "motors": self._motors,
            "watts": self._watts.tolist(),
        }

    @classmethod
    def restored(cls, state: Mapping[str, Any], entities: Entities) -> _ClientObjective:
        """Rebuilds an objective from its `state`.

        Raises:
            WorldError: Its cubes are not there, or its expression is none.
            ValueError: Its parts do not fit together.
        """
        cubes, others = (
            {part: entities.cube(name) for part, name in state[key].items()} for key in ("cubes", "others")
        )
        objective = cls(Objective(state["expression"]), cubes, others, state["target"], entities, state["frame"])
        objective._quantities.resume(state["tally"])
        objective._motors, objective._watts = list(state["motors"]), np.array(state["watts"], np.float64)
        return objective


class ClientObjectives:
    """The objectives of one client, by name."""

    def __init__(self) -> None:
        self._objectives: dict[str, _ClientObjective] = {}
        # Those that cannot be asked any more, no more than there may be of the others, and the cube that is gone.
        self._lost: dict[str, str | None] = {}

    def __len__(self) -> int:
        return len(self._objectives)

    def set(self, entities: Entities, frame: int, cubes: Mapping[str, Cube], command: JsonObject) -> JsonObject:
        """Executes a `set_objective` command; returns the reply.

        Args:
            entities: Where the cubes are.
            frame: Now.
            cubes: The cubes that it observes, by the ids that the expression may use for them beside their names.
            command: The command.

        Raises:
            WorldError: `bad_expression`, `cube_not_found` for a cube that it names, `limit_reached`.
        """
        objective = Objective(command["expression"])
        name = command.get("name", protocol.COMMANDS["set_objective"].defaults["name"])
        if name not in self._objectives and len(self._objectives) >= _MOST_OBJECTIVES:
            raise WorldError("limit_reached", f"this connection has its {_MOST_OBJECTIVES} objectives already")
        others: dict[str, Cube] = {}
        for quantity in objective.needs:
            if quantity.cube is not None and quantity.cube not in cubes:
                others[quantity.cube] = entities.cube(quantity.cube, "expression")
            if quantity.name == "contacts":
                entities.require("contacts", "contacts", "expression")
        target = entities.fields.position(command["target"]) if "target" in command else None
        self._objectives[name] = _ClientObjective(objective, cubes, others, target, entities, frame)
        self._lost.pop(name, None)
        needs = [str(quantity) for quantity in objective.needs]
        return {"type": "objective_set", "name": name, "cubes": [cube.name for cube in cubes.values()], "needs": needs}

    def cubes(self, name: str | None) -> list[Cube]:
        """Returns the cubes that an objective observes, of the default one if none is named; none if it is not set."""
        objective = self._objectives.get(protocol.COMMANDS["set_objective"].defaults["name"] if name is None else name)
        return [] if objective is None else [*objective.body.values(), *objective.others.values()]

    def tick(self, entities: Entities) -> None:
        """Measures the quantities of all objectives after a tick."""
        self._set_lost_aside(entities)
        for name, objective in list(self._objectives.items()):
            try:
                objective.tick(entities)
            except SimulationFault:
                raise
            except Exception as error:  # a mistake of ours in what one client has set: no other need know
                logger.error("objective %r failed", name, exc_info=error)
                self._set_aside(name, None)

    def _set_lost_aside(self, entities: Entities) -> None:
        """Sets the objectives aside that observe a cube which is gone."""
        for name, objective in list(self._objectives.items()):
            missing = objective.missing(entities)
            if missing is not None:
                self._set_aside(name, missing)

    def _set_aside(self, name: str, missing: str | None) -> None:
        del self._objectives[name]
        self._lost[name] = missing
        if len(self._lost) > _MOST_OBJECTIVES:
            del self._lost[next(iter(self._lost))]  # the oldest

    def value(self, entities: Entities, frame: int, name: str | None) -> JsonObject:
        """Returns an objective's value now, as `reward` has it; the default objective's if none is named.

        Raises:
            WorldError: `invalid`: there is none; `cube_not_found`: a cube that it is about is gone; `bad_expression`:
                its value is no finite number; `internal`: a mistake of ours.
        """
        self._set_lost_aside(entities)
        name = protocol.COMMANDS["set_objective"].defaults["name"] if name is None else name
        if name in self._lost:
            missing = self._lost[name]
            if missing is None:
                raise WorldError("internal", f"objective {name!r} failed; see the server's log", "objective")
            message = f"objective {name!r} is about the cube {missing!r}, which is gone"
            raise WorldError("cube_not_found", message, "objective")
        if name not in self._objectives:
            known = f"this connection has set {', '.join(map(repr, self._objectives)) or 'none'}"
            raise WorldError("invalid", f"objective: there is no objective {name!r}; {known}", "objective")
        try:
            value = self._objectives[name].value(entities, frame)
        except WorldError as error:
            reason = error.message.removeprefix(f"{error.path}: ")
            raise WorldError(error.code, f"objective {name!r}: {reason}", "objective") from error
        return {"type": "reward", "value": value, "objective": name}

    def state(self, entities: Entities) -> JsonObject:
        """Returns the objectives as plain JSON data, for `restored`."""
        self._set_lost_aside(entities)
        return {"set": {name: objective.state() for name, objective in self._objectives.items()}, "lost": self._lost}

    @classmethod
    def restored(cls, state: Mapping[str, Any], entities: Entities) -> ClientObjectives:
        """Rebuilds the objectives from their `state`.

        Raises:
            WorldError: A cube is not there, or an expression is none.
            ValueError: Their parts do not fit together.
        """
        objectives = cls()
        objectives._objectives = {
            name: _ClientObjective.restored(values, entities) for name, values in state["set"].items()
        }
        objectives._lost = dict(state["lost"])
        return objectives


def metric(entities: Entities, cube: Cube, command: JsonObject) -> JsonObject:
    """Returns the value of a `compute_reward` command's metric for a cube, as `reward` has it.

    Raises:
        WorldError: `invalid`: in a planar world its axis has no direction in the plane.
    """
    name = command["metric"]
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
        value = dist(state.position, entities.fields.position(command.get("target", cube.origin)))
    else:
        axis = entities.fields.position(command.get("axis", protocol.COMMANDS["compute_reward"].defaults["axis"]))
        if not any(axis):
            raise WorldError("invalid", "axis: must have a direction in the plane of this world", "axis")
        displacement = (a - b for a, b in zip(state.position, cube.origin, strict=True))
        value = total(a * b for a, b in zip(displacement, axis, strict=True)) / hypot(*axis)
    return {"type": "reward", "value": value, "metric": name, "cube_name": cube.name}
