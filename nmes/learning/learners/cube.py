"""The cube of the paper's first tier: one cube in a world, pushed in one of four directions to a target.

    cube = TargetCube(seed=1)
    learner = learn_to_arrive(cube, episodes=1200)
    arrivals(cube, learner, range(1200, 1230))  # in how many of these it arrives

What is seen is the cube's velocity and where the target is from it; each of the four numbers is one of a few ranges,
so that there are 1,225 states. All goes through commands of the world, as for a client.

    with clock_world(rate=4.0) as world:  # of nmes.measure.clock: it ticks by the clock, and waits for nobody
        arrivals(TargetCube(seed=1, world=world), learner, range(1200, 1230))
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Callable, Iterable, Mapping
from math import cos, hypot, pi, sin
from typing import Final, Protocol

from nmes.errors import WorldError
from nmes.learning.learners.q_learning import QLearning
from nmes.learning.learners.q_table import Action, Dimension, q_table
from nmes.schemas.documents import JsonObject
from nmes.variation.draw import Draw
from nmes.world import World

__all__ = [
    "ACTIONS",
    "NEAR",
    "STATES",
    "TICKS",
    "CubeWorld",
    "TargetCube",
    "arrivals",
    "learn_to_arrive",
    "table_of_cube",
]

NEAR: Final = 0.5
"""How near the cube must come to the target, m, along the ground."""

_AWAY: Final = (-2.0, -0.75, -0.25, 0.25, 0.75, 2.0)  # m: between the ranges of where the target is, along x and z
_SPEEDS: Final = (-1.5, -0.4, 0.4, 1.5)  # m/s: between those of the cube's velocity
_BINS: Final = (len(_AWAY) + 1, len(_AWAY) + 1, len(_SPEEDS) + 1, len(_SPEEDS) + 1)
STATES: Final = _BINS[0] * _BINS[1] * _BINS[2] * _BINS[3]
"""How many states there are."""
_PUSHES: Final = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))
ACTIONS: Final = len(_PUSHES)
"""How many actions there are: to be pushed along x, against it, along z, and against it."""
_FORCE: Final = 4.0  # N, on a cube of 1 kg
TICKS: Final = 12
"""How many ticks a push lasts: 0.2 s."""
_PUSHES_AT_MOST: Final = 60  # in an episode: 12 s
_DISTANCE: Final = (2.0, 5.0)  # m: from the cube to the target at the start
_CHANCE, _LEAST, _SETTLED = 0.5, 0.02, 0.8  # of any action: at first, at last, and from which part of the episodes on
_NAME: Final = "cube"


class CubeWorld(Protocol):
    """Where the cube is."""

    @property
    def frame(self) -> int:
        """How many ticks it has made, as far as is known."""

    def do(self, command: JsonObject) -> JsonObject:
        """Carries out a command, and returns the reply.

        Raises:
            WorldError: It refuses the command.
        """

    def tick(self) -> None:
        """Goes on by a tick, or waits until it has."""

    def close(self) -> None:
        """Leaves it."""


class _OwnWorld:
    """A world in this process, which waits for whoever pushes."""

    def __init__(self, seed: int) -> None:
        self._world = World({"mode": "lockstep", "seed": seed})
        self._client = self._world.join()
        self.tick, self.close = self._world.tick, self._world.close

    @property
    def frame(self) -> int:
        return self._world.frame

    def do(self, command: JsonObject) -> JsonObject:
        reply = self._world.execute(self._client, command)
        if reply["type"] == "error":
            raise WorldError(reply["code"], reply["message"], reply.get("field"))
        return reply


class TargetCube:
    """A cube in a world, and a target that is elsewhere in each episode.

    Args:
        seed: Of the world and of where targets are.
        delay: How many ticks later than it is decided a push begins, at most `TICKS`: as with a client far away, to
            whom the world does not wait. Until then the push before goes on, if there was one.
        world: Where; in a world of its own, in lockstep, if left out.

    Attributes:
        seed: The same.
        distance: From the cube to the target, m, along the ground.
        pushes: How many there were.
        late: How many ticks the world was on when it was looked at again, over those that pushes should last, of all
            pushes together: 0 where it waits.
    """

    def __init__(self, seed: int, delay: int = 0, world: CubeWorld | None = None) -> None:
        self._world: CubeWorld = _OwnWorld(seed) if world is None else world
        self.seed, self.distance, self.pushes, self.late = seed, 0.0, 0, 0
        self._do("spawn_cube", cube_name=_NAME, position=[0, 0.5, 0], size=[1, 1, 1], mass=1.0, friction=0.05)
        self._target, self._left, self._delay, self._before = (0.0, 0.0), 0, delay, (0.0, 0.0)

    def begin(self, episode: int) -> int:
        """Puts the cube back to where it began, and the target to where it is in this episode; returns the state."""
        draw = Draw(self.seed, "target", episode)
        far, bearing = draw.uniform(*_DISTANCE), draw.uniform(-pi, pi)
        self._target, self._before = (far * cos(bearing), far * sin(bearing)), (0.0, 0.0)
        self._left = _PUSHES_AT_MOST
        still = {name: [0, 0, 0] for name in ("linear_velocity", "angular_velocity")}
        self._do("set_cube_state", cube_name=_NAME, position=[0, 0.5, 0], rotation=[0, 0, 0, 1], **still)
        self._look()
        return self._state

    def push(self, action: int) -> tuple[int, float, bool, bool]:
        """Pushes the cube for a fifth of a second.

        Returns:
            The state then, the reward (by how much it came nearer, m, and 1 where it arrives), whether it has arrived,
            and whether it is too late to go on.
        """
        before = self.distance
        began = self._world.frame
        while (tick := self._world.frame - began) < TICKS:
            x, z = self._before if tick < self._delay else _PUSHES[action]
            self._do("apply_physics", cube_name=_NAME, force=[_FORCE * x, 0.0, _FORCE * z])
            self._world.tick()
        self._before = _PUSHES[action]
        self._look()
        self.pushes, self.late, self._left = self.pushes + 1, self.late + tick - TICKS, self._left - 1
        arrived = self.distance < NEAR
        return self._state, before - self.distance + arrived, arrived, not self._left

    def close(self) -> None:
        """Ends the world."""
        self._world.close()

    def _look(self) -> None:
        state = self._do("get_cube_state", cube_name=_NAME)
        position, velocity = state["position"], state["linear_velocity"]
        away = [goal - here for goal, here in zip(self._target, (position[0], position[2]), strict=True)]
        self.distance = hypot(*away)
        places = [bisect(_AWAY, each) for each in away] + [bisect(_SPEEDS, velocity[axis]) for axis in (0, 2)]
        self._state = 0
        for place, count in zip(places, _BINS, strict=True):
            self._state = self._state * count + place

    def _do(self, kind: str, **fields: object) -> JsonObject:
        return self._world.do({"type": kind, **fields})


def learn_to_arrive(cube: TargetCube, episodes: int, tell: Callable[[int], None] = lambda _: None) -> QLearning:
    """Returns a learner that has pushed the cube for so many episodes, the first ones, less and less at random.

    Args:
        cube: The cube.
        episodes: How many.
        tell: Called with how many are over.
    """
    learner = QLearning(STATES, ACTIONS, QLearning.Options())
    for episode in range(episodes):
        state, over, draw = cube.begin(episode), False, Draw(cube.seed, "pushes", episode)
        chance = max(_LEAST, _CHANCE * (1.0 - episode / (_SETTLED * episodes)))
        while not over:
            action = learner.choose(state, chance, draw)
            following, reward, arrived, late = cube.push(action)
            learner.learn(state, action, reward, following, arrived)
            state, over = following, arrived or late
        tell(episode + 1)
    return learner


def arrivals(cube: TargetCube, learner: QLearning, episodes: Iterable[int]) -> int:
    """Returns in how many of these episodes the cube arrives where nothing is left to chance."""
    count = 0
    for episode in episodes:
        state, arrived, late = cube.begin(episode), False, False
        while not (arrived or late):
            state, _, arrived, late = cube.push(learner.best(state))
        count += arrived
    return count


def table_of_cube(learner: QLearning, figures: Mapping[str, float]) -> JsonObject:
    """Returns the table that a learner of the cube has made, as a document.

    Args:
        learner: The learner.
        figures: What else is to be known of it.
    """
    dimensions = [
        *(Dimension(f"target along {axis}", "m", _AWAY) for axis in "xz"),
        *(Dimension(f"velocity along {axis}", "m/s", _SPEEDS) for axis in "xz"),
    ]
    names = ("push along x", "push against x", "push along z", "push against z")
    actions = [Action(name, push) for name, push in zip(names, _PUSHES, strict=True)]
    return q_table("A cube that is pushed to a target", dimensions, actions, learner, figures)
