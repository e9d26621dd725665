"""Creatures of one plan as rows of an engine: driven and sensed together, to the bits that each has by itself.

Each is alone in its scene, so that what it senses of others is 0, and nobody hears its voices.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nmes.backend import Array, BodyState, Places, Quaternion, Rows, RowsTrack, Vector
from nmes.world.creature import Creature
from nmes.world.senses import aim

__all__ = ["CreatureRows"]

_STILL: Vector = (0.0, 0.0, 0.0)
_UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)


class CreatureRows:
    """Creatures of one plan that are driven and sensed together, each in its place of an engine's rows.

    Args:
        rows: The places.
        plan: Any of the creatures.
    """

    def __init__(self, rows: Rows, plan: Creature) -> None:
        self._rows, self._plan = rows, plan
        shape = rows.count, len(plan.motors)
        self._low, self._half = np.zeros(shape), np.zeros(shape)
        self._scale = np.zeros((rows.count, len(plan.senses.joint_scale)))
        self._targets: list[BodyState | int | None] = [None] * rows.count

    def put(self, place: int, creature: Creature) -> None:
        """Takes a creature whose scene was put into a place of the rows."""
        self._low[place], self._half[place], self._scale[place] = (
            creature._low,
            creature._half,
            creature.senses.joint_scale,
        )
        target = creature.target
        if isinstance(target, str):
            cube = creature._entities.cubes.get(target)
            self._targets[place] = None if cube is None else cube.body
        else:
            self._targets[place] = None if target is None else BodyState(target, _UPRIGHT, _STILL, _STILL)

    def drive(self, places: Places, controls: Array) -> None:
        """Sets the targets of the motors in some places, as `Creature.drive`.

        Args:
            places: Which.
            controls: Shape (places, m + v), each from -1 to 1.
        """
        self._rows.set_motor_targets(places, self._plan._numbers, self._aims(places, controls))

    def run(self, places: Places, controls: Array, substeps: int, track: RowsTrack) -> list[int]:
        """Drives and advances some places for some ticks; see `Rows.run`.

        Args:
            places: Which.
            controls: Of each tick, shape (ticks, places, m + v), each from -1 to 1.
            substeps: How many engine steps a tick has.
            track: Where each tick is kept.

        Returns:
            The places that cannot go on as rows.
        """
        return self._rows.run(places, self._plan._numbers, self._aims(places, controls), substeps, track)

    def _aims(self, places: Places, controls: Array) -> Array:
        targets: Array = controls[..., : self._low.shape[1]] + 1.0  # nobody is there to hear the voices
        every = slice(None) if len(places) == self._rows.count else places  # the common case, which copies nothing
        targets *= self._half[every]
        targets += self._low[every]
        return targets

    def sense(self, body_state: Callable[[int], BodyState] | None = None) -> Array:
        """Returns the readings of `Creature.sense` in each place: a new array, shape (places, s).

        Args:
            body_state: Returns what `Rows.body_state` would, for whoever knows it already.
        """
        plan, rows = self._plan.senses, self._rows
        body_state = body_state or rows.body_state
        out = np.empty((rows.count, len(self._plan.sensors)))
        if plan.joint_numbers:
            readings = rows.joint_readings(plan.joint_numbers).reshape(rows.count, -1)
            out[:, plan.joint_rows] = readings[:, plan.joint_columns] * self._scale
        for read, body, columns, picked in plan.felt:
            felt = read(body_state(body))
            out[:, columns] = np.array(felt if picked is None else [felt[i] for i in picked]).T
        if plan.touch_bodies:
            out[:, plan.touch_rows] = rows.touching(plan.touch_bodies)
        if plan.aimed:
            self._sense_targets(out)
        for _, _, columns, _ in (*plan.seen, *plan.ears):
            out[:, columns] = 0.0  # each is alone in its scene
        for _, columns, _ in plan.smelled:
            out[:, columns] = 0.0  # where nothing grows
        return out

    def _sense_targets(self, out: Array) -> None:
        cubes = {target: self._states(target) for target in self._targets if isinstance(target, int)}
        for body, columns, picked in self._plan.senses.aimed:
            for place, (state, target) in enumerate(zip(self._states(body), self._targets, strict=True)):
                if target is None:
                    out[place, columns] = 0.0
                else:
                    cube = cubes[target][place] if isinstance(target, int) else target
                    seen = aim(state, cube.position, cube.linear_velocity)
                    out[place, columns] = [seen[i] for i in picked]

    def _states(self, body: int) -> list[BodyState]:
        """Returns the state of a body in each place."""
        state = self._rows.body_state(body)
        parts = (state.position, state.quaternion, state.linear_velocity, state.angular_velocity)
        columns = [list(zip(*np.array(part).tolist(), strict=True)) for part in parts]
        return [BodyState(*each) for each in zip(*columns, strict=True)]
