"""Episodes of one task that are run together, as rows of an engine: those of bodies of one layout, in step.

Hides how brains of one form are stepped at once, which rows still run, and that what is judged is judged a second of
ticks at a time. What comes of an episode is the `Judge`'s to say, as where it is run in a world of its own.

Invariant: each result has the same bits as that of the episode alone, whichever others are in the cohort.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from nmes.backend import Array, Contact, Places, Rows
from nmes.brain import Brain, BrainBatch, stack
from nmes.evaluation.episode import Handover
from nmes.evaluation.judge import Result
from nmes.evaluation.task import Task
from nmes.objective.trajectory import touches
from nmes.world.creature_rows import CreatureRows

__all__ = ["Entry", "PlaceOfRows", "run_cohort"]


@dataclass(frozen=True, eq=False, slots=True)
class Entry:
    """One episode that takes part.

    Attributes:
        handover: Its scene.
        brain: What drives it.
        form: What brains have in common that can be stacked; None where there is no brain.
        seed: Of whatever the brain draws.
    """

    handover: Handover
    brain: Brain | None
    form: str | None
    seed: int

    @classmethod
    def of(cls, handover: Handover, brain: Brain | None, seed: int) -> Entry:
        """Returns the entry of a scene and what drives it."""
        return cls(handover, brain, None if brain is None else brain.form(), seed)

    @property
    def kin(self) -> Hashable:
        """What entries must have in common to be of one cohort."""
        handover = self.handover
        watched = tuple(map(tuple, handover.watched))
        return handover.row.layout, handover.tick, handover.creature.plan, watched, self.brain is None


def run_cohort(entries: Sequence[Entry], task: Task) -> list[Result | None]:
    """Runs episodes of equal `kin` to their ends.

    Returns:
        Their results; None where only a world of its own can tell how the episode comes out.
    """
    cohort = _Cohort(entries, task)
    cohort.run()
    return cohort.results


class _Cohort:
    def __init__(self, entries: Sequence[Entry], task: Task) -> None:
        self._entries, self._task = entries, task
        self._first = first = entries[0].handover
        self._judges = [entry.handover.judge.again() for entry in entries]
        self.results: list[Result | None] = [None] * len(entries)
        feels = any(sensor.type == "touch" for sensor in first.creature.sensors)
        self._rows = first.row.rows(len(entries), contacts=feels or self._judges[0].touchy)
        self._rows.put(range(len(entries)), [entry.handover.row for entry in entries])
        self._creatures = CreatureRows(self._rows, first.creature)
        for place, entry in enumerate(entries):
            self._creatures.put(place, entry.handover.creature)
        self._track = self._rows.track(*first.watched, task.tick_rate, task.substeps)
        self._places: Places = np.arange(len(entries))  # of the rows that still run

    def run(self) -> None:
        """Runs all episodes; afterwards there are results."""
        task, tick = self._task, self._first.tick
        for controls in self._controls():
            self._advance(controls)
            tick += len(controls)
            if self._judges[0].touchy:
                self._feel(tick)
            last = tick == task.ticks
            if last or self._track.rows == task.tick_rate:
                self._look(last=last)
            if not len(self._places):
                return

    # -- brains -------------------------------------------------------------------------------------------------------

    def _controls(self) -> Iterator[Array]:
        """Yields the controls of the ticks that come next, array (ticks, places, motors); of no motors without brains.

        These are all ticks until the judges look, where no brain senses and nobody asks what touches what; else one.
        """
        groups: dict[str, list[int]] = {}
        for place, entry in enumerate(self._entries):
            if entry.form is not None:
                groups.setdefault(entry.form, []).append(place)
        stacks = [(places, self._stacked(places)) for places in map(np.array, groups.values())]
        motors = len(self._first.creature.body.outputs) if stacks else 0
        ahead = all(brains.open_loop for _, brains in stacks)
        block = self._task.tick_rate if ahead and not self._judges[0].touchy else 1
        sensed = np.array([entry.handover.senses for entry in self._entries])
        for tick in range(self._first.tick, self._task.ticks, block):
            controls = np.zeros((min(block, self._task.ticks - tick), len(self._entries), motors))
            for places, brains in stacks:
                controls[:, places] = brains.controls(len(controls)) if ahead else brains.step(sensed[places])
            yield controls
            if not ahead:
                sensed = self._creatures.sense()

    def _stacked(self, places: Places) -> BrainBatch:
        """Returns the brains of some entries, as far as they have come."""
        entries = [self._entries[place] for place in places]
        brains = stack([entry.brain for entry in entries if entry.brain is not None])
        brains.reset([entry.seed for entry in entries], 1.0 / self._task.tick_rate)
        for tick in range(self._first.tick):  # what they have lived through already
            if brains.open_loop:
                brains.controls(1)
            else:
                brains.step(np.array([entry.handover.sensed[tick] for entry in entries]))
        return brains

    def _advance(self, controls: Array) -> None:
        """Advances the rows that still run; those that the motors would refuse leave, to be refused in a world."""
        controls = controls[:, self._places]
        accepted = (np.abs(controls) <= 1.0).all(axis=(0, 2))
        if not accepted.all():
            controls = controls[:, accepted]
            self._leave(self._places[~accepted].tolist())
        if not len(self._places):
            return
        substeps = self._task.substeps
        if controls.shape[2]:
            lost = self._creatures.run(self._places, controls, substeps, self._track)
        else:
            lost = self._rows.run(self._places, (), controls, substeps, self._track)
        self._leave(lost)

    # -- rows ---------------------------------------------------------------------------------------------------------

    def _leave(self, places: Sequence[int]) -> None:
        if places:
            self._places = self._places[~np.isin(self._places, places)]

    def _feel(self, tick: int) -> None:
        """Tells the judges what touches what after a tick."""
        bodies = self._first.watched.bodies
        for place in self._places.tolist():
            judge = self._judges[place]
            scene = PlaceOfRows(self._rows, place)
            judge.touches[tick] = touches(scene, bodies, judge.trajectory.bodies.body)

    def _look(self, *, last: bool) -> None:
        """Has the new rows judged; those whose episode is over leave, with a result."""
        states, powers, positions = self._track.states(), self._track.powers(), self._track.positions()
        self._track.clear()
        over = []
        for place in self._places.tolist():
            judge = self._judges[place]
            ended = judge.take(states[place], powers[place], positions[place])
            if last or ended is not None:
                self.results[place] = judge.result(ended, None)
                over.append(place)
        self._leave(over)


@dataclass(frozen=True, slots=True)
class PlaceOfRows:
    """One place of the rows, as `touches` asks a simulation."""

    rows: Rows
    place: int

    def contacts(self, body: int) -> list[Contact]:
        """Returns the contacts of a body there."""
        return self.rows.contacts(self.place, body)
