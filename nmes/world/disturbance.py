"""What the flaws of a creature's sensors and motors do: noise, delays and failures, the same in every run.

Hides how chance is drawn: a function of the world's seed, the creature, its age in ticks and the sensor or motor, by a
generator that counts (Philox 4x64-10; Salmon et al. 2011), so that nothing is remembered of it. Noise is the sum of
twelve even draws less six (Irwin-Hall): whole numbers until the last step, so that it has the same bits everywhere, a
standard deviation of 1, and no value beyond 6. What is remembered is what delays hold back. Invariants: to sense
changes nothing; restored from its `state`, it goes on bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from hashlib import blake2b
from typing import Final

import numpy as np

from nmes.backend import Array
from nmes.genome.sensors import Flaws
from nmes.schemas.documents import JsonObject
from nmes.world.snapshot import pack_array, unpack_array

__all__ = ["Disturbance"]

_WORDS: Final = 4  # of 64 bits, drawn for each sensor or motor: three for noise, one for whether it fails
_OLDEST: Final = 2**53  # ticks, which a double still counts
_SENSORS, _MOTORS = 0, 1  # the streams of what is drawn


class Disturbance:
    """The flaws of one creature that lives in a world.

    Args:
        sensors: Of each sensor; None: it has none.
        motors: Of each motor, likewise.
        rest: The controls with which motors aim at 0, or next to it, shape (m,).
        origin: What tells this creature from all others of all worlds.

    Attributes:
        drives: Whether motors are flawed: then they do as `tick` says, and not as they are told.
    """

    def __init__(
        self, sensors: Sequence[Flaws | None], motors: Sequence[Flaws | None], rest: Array, origin: str
    ) -> None:
        digest = blake2b(f"{origin}:flaws".encode(), digest_size=16).digest()
        self._key = np.frombuffer(digest, "<u8").astype(np.uint64)
        self._sensors, self._motors = _Flawed(sensors), _Flawed(motors)
        self.drives = bool(len(self._motors.columns))
        self._age = 0
        self._asked: Array | None = None
        self._aimed = rest
        self._motors.past = [rest[self._motors.columns]] * self._motors.longest

    def sensed(self, values: Array) -> Array:
        """Returns the disturbed readings where sensors without flaws would read `values`, shape (s,)."""
        flawed = self._sensors
        if len(flawed.columns):
            noisy, failed = self._disturbed(flawed, _SENSORS, values)
            values[flawed.columns] = np.where(failed, 0.0, noisy)
        return values

    def ask(self, controls: Array) -> None:
        """Notes with what the motors are driven from now on, shape (m,)."""
        self._asked = controls.copy()

    def tick(self, read: Callable[[], Array]) -> Array | None:
        """Goes on by a tick, which begins now.

        Args:
            read: Returns what sensors without flaws read now.

        Returns:
            The controls of the motors in that tick, shape (m,); None where they are not to be touched.
        """
        if self._sensors.longest:
            self._sensors.keep(read())
        controls = None
        if self.drives and self._asked is not None:
            flawed, controls = self._motors, self._asked.copy()
            noisy, failed = self._disturbed(flawed, _MOTORS, controls)
            controls[flawed.columns] = np.where(failed, self._aimed[flawed.columns], np.clip(noisy, -1.0, 1.0))
            flawed.keep(self._asked)
            self._aimed = controls
        self._age += 1
        return controls

    def _disturbed(self, flawed: _Flawed, stream: int, values: Array) -> tuple[Array, np.ndarray]:
        """Returns late values with their noise, of what is flawed, and which of them fail in this tick."""
        counter = np.array([0, self._age, stream, 0], np.uint64)
        words = np.random.Philox(key=self._key, counter=counter).random_raw(_WORDS * len(flawed.columns))
        parts = words.reshape(-1, _WORDS).astype("<u8").view("<u2").astype(np.int64)  # 16 of 16 bits each
        noise = (parts[:, :12].sum(axis=1) + 6 - 6 * 65536) / 65536.0
        chance = (parts[:, 12] * 65536 + parts[:, 13]) / 2.0**32
        return flawed.late(values) + flawed.noise * noise, chance < flawed.drop_out

    # -- state ------------------------------------------------------------------------------------------------------

    def memory(self) -> bytes:
        """Returns its state as bytes."""
        driven = [] if self._asked is None else [self._asked, self._aimed]
        return np.concatenate([[float(self._age)], *self._sensors.past, *driven, *self._motors.past]).tobytes()

    def state(self) -> JsonObject:
        """Returns its state as plain JSON data."""
        driven = None if self._asked is None else pack_array(np.array([self._asked, self._aimed]))
        past = {name: pack_array(np.array(flawed.past)) for name, flawed in self._named()}
        return {"age": self._age, "driven": driven, **past}

    def recall(self, state: JsonObject) -> None:
        """Takes up what `state` returned.

        Raises:
            ValueError: It is none of such a creature.
        """
        if state["age"] >= _OLDEST:
            raise ValueError("no creature is as old as that")
        self._age = state["age"]
        for name, flawed in self._named():
            past = unpack_array(state[name], max(1, len(flawed.columns)))
            if len(past) > flawed.longest or not np.isfinite(past).all():
                raise ValueError(f"what flaws remember of {name} is too much, or no numbers")
            flawed.past = list(past)
        if state["driven"] is not None:
            driven = unpack_array(state["driven"], len(self._aimed))
            if driven.shape[0] != 2 or not (np.abs(driven) <= 1.0).all() or not self.drives:
                raise ValueError("what flaws remember of motors is no control")
            self._asked, self._aimed = driven[0], driven[1]

    def _named(self) -> list[tuple[str, _Flawed]]:
        return [("sensors", self._sensors), ("motors", self._motors)]


class _Flawed:
    """What of some values is flawed, and how; and what of them a delay holds back.

    Attributes:
        columns: Which values, shape (k,).
        noise: Their standard deviations, shape (k,).
        drop_out: How likely each fails, shape (k,).
        longest: The longest delay, ticks.
        past: Their values at the ticks before, the last one last; no more than `longest`.
    """

    def __init__(self, flaws: Sequence[Flaws | None]) -> None:
        flawed = [(column, each) for column, each in enumerate(flaws) if each is not None]
        self.columns = np.array([column for column, _ in flawed], np.intp)
        self.noise = np.array([each.noise for _, each in flawed])
        self.drop_out = np.array([each.drop_out for _, each in flawed])
        self._delays = [each.delay for _, each in flawed]
        self.longest = max(self._delays, default=0)
        self.past: list[Array] = []

    def keep(self, values: Array) -> None:
        """Remembers the values of a tick that begins."""
        if self.longest:
            self.past = [*self.past, values[self.columns]][-self.longest :]

    def late(self, values: Array) -> Array:
        """Returns the values as they were as many ticks ago as is their delay, or as long ago as is known."""
        late = values[self.columns]
        if self.past:
            for place, delay in enumerate(self._delays):
                if delay:
                    late[place] = self.past[-min(delay, len(self.past))][place]
        return late
