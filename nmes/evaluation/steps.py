"""The steps of an episode, which are a world's ordinary inputs; and the first of them, until creatures are at rest.

Whoever evaluates does the steps; whoever proves compares them with a recording.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from enum import Enum
from typing import Final, NamedTuple, TypeVar

import numpy as np

from nmes import protocol
from nmes.backend import Array
from nmes.errors import WorldError
from nmes.evaluation.setting import Setting
from nmes.genome.body import Body
from nmes.schemas.documents import JsonObject
from nmes.world import World

__all__ = ["ANY_CONTROLS", "Drive", "Rest", "Step", "perform", "settle"]

T = TypeVar("T")

_REST_TIME = 0.25  # s
_REST_SPEED = 0.05  # of the body's size in a second: in a whole episode it would not come farther than that size
_NUDGE = 0.1  # of the body's size: as far as one may be moved that is set down where it touches another
_CLOSE = 0.05  # m between the balls around two cubes that may have touched within a tick


class _AnyControls(Enum):
    ANY_CONTROLS = "any controls"


ANY_CONTROLS: Final = _AnyControls.ANY_CONTROLS
"""Whatever controls a creature is driven with."""


class Drive(NamedTuple):
    """A step that drives a creature.

    Attributes:
        creature: Its name.
        controls: What with, array (motors,); or anything.
        optional: Whether it may be left alone instead, since it has no brain.
    """

    creature: str
    controls: Array | _AnyControls
    optional: bool = False


Step = bytes | Drive | None
"""What comes next: a command, controls to drive a creature with, or a tick."""


def perform(world: World, client: int, steps: Generator[Step, None, T]) -> T:
    """Does steps in the world that they are for; returns what they come to.

    Args:
        world: The world.
        client: Who does them.
        steps: Each is done before the next is asked for.

    Raises:
        WorldError: The world refuses a command.
    """
    drive, tick = world.drive, world.tick
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            value: T = end.value
            return value
        if step is None:
            tick()
        elif isinstance(step, Drive):
            assert isinstance(step.controls, np.ndarray)
            drive(client, step.creature, step.controls)
        else:
            reply = protocol.decode(world.handle(client, protocol.parse(step)))
            if reply["type"] == "error":
                raise WorldError(reply["code"], reply["message"], reply.get("field"))


def settle(
    world: World, setting: Setting, names: Sequence[str], commands: Sequence[JsonObject]
) -> Generator[Step, None, tuple[dict[str, Rest], dict[str, str]]]:
    """Yields the steps that set creatures down, and the ticks until all are at rest, or it takes too long.

    It is over too where one of them comes to another and moves it: nobody may win a match before it begins.

    Args:
        world: New and empty.
        setting: How long that is.
        names: The creatures'.
        commands: What sets them down.

    Returns:
        How each of them came to rest, by name; and of those that cannot begin so, the reason.
    """
    for command in commands:
        yield protocol.encode(command)
    creatures = [world.creature(name) for name in names]
    rests = {creature.name: Rest(creature.present, setting) for creature in creatures}
    tracks = [world.track([*creature.cubes.values()], [], [], setting.settle_limit_ticks) for creature in creatures]
    looked, encounters, came = 0, _Encounters([*rests.values()]), None  # rows; and who came to another
    while world.frame < setting.settle_ticks or not all(rest.reached for rest in rests.values()):
        if world.frame == setting.settle_limit_ticks or came is not None:
            break
        yield None
        if world.fault is not None:
            break
        for track in tracks:
            track.note()
        if world.frame >= setting.settle_ticks:  # the ticks before are looked at all at once
            blocks = [track.states(looked, track.rows) for track in tracks]
            for rest, block in zip(rests.values(), blocks, strict=True):
                rest.look(block)
            looked = tracks[0].rows
            came = encounters.look(blocks) if len(creatures) > 1 else None
    if came is not None:
        reason = "before the start a part of it came to the place of another, whom it moved"
        return rests, {names[came]: f"displaced: {reason}"}
    reasons = {name: rest.why_not(world.frame) for name, rest in rests.items()}
    return rests, {name: reason for name, reason in reasons.items() if reason is not None}


class _Encounters:
    """Tells who of some creatures has come to another, and moved it, while all come to rest.

    That is whoever first had a part nearer to the place of another than to its own. Contacts do not tell: a limb that
    strikes may be off again at the end of the tick, and whom it strikes is moved farther than it is.

    Args:
        rests: Of the creatures.
    """

    def __init__(self, rests: Sequence[Rest]) -> None:
        self._rests, self._rows = rests, 0
        self._crossed: dict[int, int] = {}  # those with such a part, and the row of the first
        self._near: set[tuple[int, int]] = set()  # pairs of creatures that were near enough to touch

    def look(self, blocks: Sequence[Array]) -> int | None:
        """Takes the states of the same ticks of each creature, arrays (ticks, n, 13); returns who came to another."""
        for one, block in enumerate(blocks):
            ways = [_squares(block[:, :, 0] - rest.place[0], block[:, :, 2] - rest.place[1]) for rest in self._rests]
            others = np.stack(ways[:one] + ways[one + 1 :]).min(axis=0)
            rows = np.flatnonzero((others < ways[one]).any(axis=1))
            if len(rows):
                self._crossed.setdefault(one, self._rows + int(rows[0]))
            for other in range(one):
                if (one, other) not in self._near and self._come_near(one, other, blocks):
                    self._near |= {(one, other), (other, one)}
        self._rows += len(blocks[0])
        moved = [rest.moved > _NUDGE * rest.size for rest in self._rests]
        came = [one for one in self._crossed if any(moved[other] for by, other in self._near if by == one)]
        return min(came, key=lambda one: (self._crossed[one], one), default=None)

    def _come_near(self, one: int, other: int, blocks: Sequence[Array]) -> bool:
        reach = self._rests[one].arms[:, np.newaxis] + self._rests[other].arms + _CLOSE
        # A tick at a time: how many ticks and cubes there are is for tasks and genomes to say.
        for here, there in zip(blocks[one], blocks[other], strict=True):
            gaps = here[:, np.newaxis, :3] - there[:, :3]
            if (_squares(*np.moveaxis(gaps, 2, 0)) < reach * reach).any():
                return True
        return False


def _squares(*lengths: Array) -> Array:
    """Returns the sums of squares, from left to right."""
    total = lengths[0] * lengths[0]
    for length in lengths[1:]:
        total = total + length * length
    return total


class Rest:
    """Tells when a creature is at rest: for a while none of its corners was faster than a part of its size a second.

    Args:
        body: What of the creature's is there, which has just been set down.
        task: The task.

    Attributes:
        states: Of its cubes when it was looked at last, array (n, 13) as `Simulation.states` has them.
        speed: Of the fastest corner, when one was too fast last, m/s.
        size: The longest edge of the box around the body, m.
        arms: Half the diagonal of each of its cubes, array (n,), m.
        place: Where its centre of mass was over the ground when it was looked at first, x and z, m.
    """

    def __init__(self, body: Body, task: Setting) -> None:
        self.arms = np.array([math.hypot(*cube.size) / 2.0 for cube in body.cubes])
        self.size = body.size
        self._limit = _REST_SPEED * self.size
        self._rate, self._still = task.tick_rate, 0
        self._ticks = max(1, round(_REST_TIME * task.tick_rate))
        self._masses = np.array([cube.mass for cube in body.cubes])
        self._looked = False
        self.place = (0.0, 0.0)
        self.states: Array = np.zeros((len(body.cubes), 13))
        self.speed = 0.0

    @property
    def reached(self) -> bool:
        """Whether it has been at rest for long enough."""
        return self._still >= self._ticks

    @property
    def moved(self) -> float:
        """How far its centre of mass has come over the ground since it was looked at first, m."""
        x, z = self._centre_of(self.states)
        return math.hypot(x - self.place[0], z - self.place[1])

    def why_not(self, ticks: int) -> str | None:
        """Returns why it cannot begin as it is after so many ticks, in words; None if it can."""
        if not self.reached:
            return f"restless: not yet at rest after {ticks / self._rate:g} s: a corner moved at {self.speed:.2g} m/s"
        if self.moved > self.size:
            way = f"it came {self.moved:.2g} m from where it was set down, farther than its size, {self.size:.2g} m"
            return f"displaced: before the start {way}"
        return None

    def _centre_of(self, states: Array) -> tuple[float, float]:
        weighed = np.add.accumulate(states[:, :3] * self._masses[:, np.newaxis], axis=0)
        x, _, z = (weighed[-1] / np.add.accumulate(self._masses)[-1]).tolist()
        return x, z

    def look(self, states: Array) -> None:
        """Takes the states of the tick that has just ended, array (n, 13), or of several, array (ticks, n, 13)."""
        ticks = states.reshape(-1, len(self.arms), 13)
        if not self._looked:
            self._looked, self.place = True, self._centre_of(ticks[0])
        self.states = ticks[-1]
        squares = ticks[:, :, 7:13] * ticks[:, :, 7:13]
        speeds, spins = (np.sqrt(squares[:, :, i] + squares[:, :, i + 1] + squares[:, :, i + 2]) for i in (0, 3))
        for speed in (speeds + spins * self.arms).max(axis=1).tolist():
            if speed <= self._limit:
                self._still += 1
            else:
                self._still, self.speed = 0, speed
