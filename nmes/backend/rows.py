"""Many scenes of one structure, stepped all at once: what an engine may offer besides its Simulations.

A scene becomes a `Row` once nothing is left to be built in it (`Simulation.hand_over`); rows of equal `layout` go on in
`Rows`, in places that others take when they leave. A row cannot be edited, pushed or snapshotted: it has motors, which
are driven, and sensors.

Invariant: what a row does has the same bits as the simulation that it comes from, stepped on its own, whatever is in
the other places, and whatever the number of threads.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence

import numpy as np
import numpy.typing as npt

from nmes.backend.specs import Array, BodyState, Contact

__all__ = ["Places", "Row", "Rows", "RowsTrack"]

Places = npt.NDArray[np.intp]
"""Places of `Rows`, ascending."""


class Row(ABC):
    """One scene, as it was when it was handed over. It may be put into several places, and never changes.

    Attributes:
        layout: Rows of equal layout may be stepped together.
    """

    layout: Hashable

    @abstractmethod
    def rows(self, count: int, *, threads: int = 1, contacts: bool = False) -> Rows:
        """Returns places for rows of this layout, all empty.

        Args:
            count: How many.
            threads: How many threads step them.
            contacts: Whether `touching` and `contacts` will be asked.
        """


class RowsTrack(ABC):
    """A record of all places, as `Track` is one of a scene; `rows` is the number of rows that are kept."""

    rows: int

    @abstractmethod
    def note(self) -> None:
        """Keeps the present states and readings of all places as the next row, after a step."""

    @abstractmethod
    def clear(self) -> None:
        """Forgets all rows."""

    @abstractmethod
    def states(self) -> Array:
        """Returns the states of the bodies, array (places, rows, n, 13), as `Simulation.states` has them."""

    @abstractmethod
    def positions(self) -> Array:
        """Returns the positions of the joints, array (places, rows, m)."""

    @abstractmethod
    def powers(self) -> Array:
        """Returns the powers of the motors, array (places, rows, 2, m), as `Simulation.powers` has them."""


class Rows(ABC):
    """Places for scenes of one layout. What is read of an empty place means nothing.

    Bodies and joints are known by the numbers that they had in the simulations. But for `set_motor_targets` readings
    are those after the last `step`: of a row that was put since, they mean nothing.

    Attributes:
        count: The number of places.
    """

    count: int

    @abstractmethod
    def put(self, places: Sequence[int], rows: Sequence[Row]) -> None:
        """Begins scenes in places, whatever was there."""

    @abstractmethod
    def set_motor_targets(self, places: Places, joints: Sequence[int], targets: Array) -> None:
        """Sets the targets of motors in some places, array (places, joints), as `Simulation.set_motor_targets`."""

    @abstractmethod
    def step(self, places: Places, substeps: int) -> list[int]:
        """Advances the rows in some places by engine steps.

        Args:
            places: Which.
            substeps: How many.

        Returns:
            The places that cannot go on as rows: their engine failed, or what a sensor reads there can only be told by
            a simulation. What has happened is to be found out by running that scene alone; the place is empty now.
        """

    def run(self, places: Places, joints: Sequence[int], targets: Array, substeps: int, track: RowsTrack) -> list[int]:
        """Drives and advances the rows in some places for some ticks, and keeps all places in a track after each.

        An engine that takes many ticks in one call does it here; this goes tick by tick.

        Args:
            places: Which.
            joints: Those whose motors are driven; the targets of others stay what they are.
            targets: Of these motors in each tick, array (ticks, places, joints), as `set_motor_targets`.
            substeps: How many engine steps a tick has.
            track: It has room for so many ticks more.

        Returns:
            The places that cannot go on as rows, as `step`; what the track has of them means nothing.
        """
        lost: list[int] = []
        for tick in range(len(targets)):
            self.set_motor_targets(places, joints, targets[tick])
            gone = self.step(places, substeps)
            track.note()
            if gone:
                kept = ~np.isin(places, gone)
                places, targets = places[kept], targets[:, kept]
                lost += gone
        return lost

    @abstractmethod
    def body_state(self, body: int) -> BodyState:
        """Returns the pose and velocity of a body: each of its numbers an array (places,)."""

    @abstractmethod
    def joint_readings(self, joints: Sequence[int]) -> Array:
        """Returns a new array (places, n, 3), as `Simulation.joint_readings` has them."""

    @abstractmethod
    def touching(self, bodies: Sequence[int]) -> Array:
        """Returns a new array (places, n), as `Simulation.touching` has them."""

    @abstractmethod
    def contacts(self, place: int, body: int) -> list[Contact]:
        """Returns the contacts of a body in one place, as `Simulation.contacts` has them."""

    @abstractmethod
    def track(
        self, bodies: Sequence[int], joints: Sequence[int], motors: Sequence[int], rows: int, substeps: int
    ) -> RowsTrack:
        """Returns a track with room for some rows, each noted after a step of so many engine steps."""
