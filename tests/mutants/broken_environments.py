"""Environments of Gymnasium that do not do the same again: each has one fault, which upstream's checkers may pass."""

from __future__ import annotations

import itertools
import math
import os
import random
import threading
import time
from typing import Any, ClassVar

import gymnasium
import numpy as np

FAULTS: dict[str, type[Good]] = {}
EXPECTED: dict[str, str] = {}
"""What the report must say of each."""

# Nobody seeds these.
_NOISE = np.random.default_rng()


class Good(gymnasium.Env[Any, Any]):
    """A point that is pushed about, from a start that is drawn; it has no fault."""

    observation_space = gymnasium.spaces.Box(-1e6, 1e6, (3,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float64)

    def __init__(self) -> None:
        self.state = np.zeros(3)
        self.ticks = self.resets = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.ticks, self.resets = 0, self.resets + 1
        self.state = self.np_random.uniform(-1.0, 1.0, 3)
        return self.observe(), {"resets": 0}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.ticks += 1
        self.move(action)
        return self.observe(), self.reward(), self.ends(), self.ticks == 200, self.info()

    def move(self, action: Any) -> None:
        self.state = 0.9 * self.state + 0.1 * action

    def observe(self) -> Any:
        return self.state.copy()

    def reward(self) -> float:
        return float(self.state.sum())

    def ends(self) -> bool:
        return False

    def info(self) -> dict[str, Any]:
        return {"ticks": self.ticks}


def fault(expected: str) -> Any:
    """Enters a class among the faults, with what the report must say."""

    def enter(kind: type[Good]) -> type[Good]:
        FAULTS[kind.__name__] = kind
        EXPECTED[kind.__name__] = expected
        return kind

    return enter


@fault(r"episode 1, step 4: observation\[0, 1, 2\]")
class NoiseFromTheFourthStep(Good):
    def observe(self) -> Any:
        return self.state + (_NOISE.normal(size=3) if self.ticks >= 4 else 0.0)


@fault(r"episode 1, step 101: observation\[2\]")
class NoiseAfterAHundredSteps(Good):
    def observe(self) -> Any:
        return self.state + (_NOISE.normal() * np.array([0, 0, 1.0]) if self.ticks > 100 else 0.0)


@fault(r"episode 3, (reset|step \d+): observation")
class NoiseFromTheThirdEpisode(Good):
    """From the third episode after a seed."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        if seed is not None:
            self.resets = 0
        return super().reset(seed=seed)

    def observe(self) -> Any:
        return self.state + (_NOISE.normal() if self.resets > 2 else 0.0)


@fault("episode 1, step 1: reward differs")
class NoiseInTheReward(Good):
    def reward(self) -> float:
        return super().reward() + float(_NOISE.normal())


@fault(r"episode 1, step 1: info\['luck'\] differs")
class NoiseInTheInfo(Good):
    def info(self) -> dict[str, Any]:
        return {**super().info(), "luck": float(_NOISE.normal())}


@fault("observation of episode 1, reset was changed")
class TheSameBufferEachTime(Good):
    def __init__(self) -> None:
        super().__init__()
        self.buffer = np.zeros(3)

    def observe(self) -> Any:
        self.buffer[:] = self.state
        return self.buffer


@fault("info is in the memory of info of episode 1")
class TheSameInfoEachTime(Good):
    def __init__(self) -> None:
        super().__init__()
        self.told: dict[str, Any] = {"ticks": 0}

    def info(self) -> dict[str, Any]:
        return self.told


@fault("observation of episode 1, step 10 was changed after it had been handed out")
class AnObservationThatIsChangedLater(Good):
    """Long after it was handed out."""

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        result = super().step(action)
        if self.ticks == 10:
            self.kept = result[0]
        if self.ticks == 60:
            self.kept += 1.0
        return result


@fault("episode 1, step 1: the action was changed")
class TheActionIsChanged(Good):
    def move(self, action: Any) -> None:
        action *= 0.5
        super().move(action)


@fault(r"again, after other episodes: episode 1, step 2: observation")
class TheActionIsKept(Good):
    """What the caller writes into it afterwards acts as well."""

    before: Any = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self.before = np.zeros(3)
        return super().reset(seed=seed)

    def move(self, action: Any) -> None:
        super().move(self.before)
        self.before = action


@fault(r"episode 1, (reset|step 1): observation")
class TheClock(Good):
    def observe(self) -> Any:
        return self.state + time.time() % 1e5


@fault(r"again, after other episodes: episode 1, reset: observation")
class AClockOfWholeDays(Good):
    """Two runs of the same day agree."""

    def observe(self) -> Any:
        return self.state + math.floor(time.time() / 86400.0)


@fault("the global generator of random is used")
class PythonsGenerator(Good):
    """Seeded at each reset, so that it repeats until somebody else draws."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        if seed is not None:
            random.seed(seed)
        return super().reset(seed=seed)

    def reward(self) -> float:
        return random.random()


@fault("the global generator of numpy.random is used")
class NumpysGenerator(Good):
    def move(self, action: Any) -> None:
        self.state = self.state + np.random.normal(size=3)


@fault(r"episode 1, reset: observation")
class TheSystemsNoise(Good):
    def observe(self) -> Any:
        return self.state + os.urandom(1)[0] / 1e9 + os.urandom(1)[0]


@fault(r"in another process: episode 1, step 1: (reward|observation)")
class TheOrderOfASet(Good):
    """It is another in each process, and the same in all of one."""

    def move(self, action: Any) -> None:
        total = 0.0
        for part in {f"{i}" for i in range(20)}:  # no two orders have the same total
            total = total / 21.0 + float(part)
        self.state = 0.9 * self.state + 0.1 * action * total


@fault(r"in another process: episode 1, step 1: reward")
class TheNumberOfTheProcess(Good):
    def reward(self) -> float:
        return super().reward() + os.getpid()


@fault(r"again, after other episodes: episode 1, reset: observation\[0\]")
class ACounterOfResets(Good):
    def observe(self) -> Any:
        return self.state + np.array([self.resets, 0.0, 0.0])


@fault(r"again, after other episodes: episode 1, step 1: observation")
class AWarmStart(Good):
    """The last episode's velocity."""

    velocity = np.zeros(3)

    def move(self, action: Any) -> None:
        self.velocity = 0.5 * self.velocity + action
        self.state = self.state + 0.01 * self.velocity


@fault(r"again, after other episodes: episode 1, reset: observation")
class TheSeedIsIgnored(Good):
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        return super().reset()


@fault(r"again, after other episodes: episode 1, reset: observation")
class OnlyTheFirstSeedCounts(Good):
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        return super().reset(seed=None if self.resets else seed)


@fault("reset without a seed begins the random numbers of the seed anew")
class ResetsBeginAnew(Good):
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        self.seed = self.seed if seed is None else seed
        return super().reset(seed=self.seed)

    seed = 0


@fault(r"again, after other episodes: episode 2, reset: observation")
class ResetsWithoutASeedDrawAnother(Good):
    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        return super().reset(seed=random.SystemRandom().randrange(2**32) if seed is None else seed)


@fault(r"in another environment, while the first goes on: episode 1, step 2: observation")
class AStateOfAllInstances(Good):
    """Reset by whoever is reset."""

    shared: ClassVar[Any] = np.zeros(3)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        AStateOfAllInstances.shared = np.zeros(3)
        return super().reset(seed=seed)

    def move(self, action: Any) -> None:
        AStateOfAllInstances.shared = AStateOfAllInstances.shared + action
        self.state = 0.9 * self.state + 0.1 * AStateOfAllInstances.shared


@fault(r"in another environment, while the first goes on: episode 1, reset: observation")
class TheOrderOfMaking(Good):
    numbers: ClassVar[Any] = itertools.count()

    def __init__(self) -> None:
        super().__init__()
        self.number = next(self.numbers)

    def observe(self) -> Any:
        return self.state + self.number


@fault(r"again, after other episodes: episode 1, step 1: reward")
class TheNumberOfAllSteps(Good):
    all = 0

    def reward(self) -> float:
        self.all += 1
        return super().reward() / self.all


@fault(r"in another environment, while the first goes on: episode 1, step 1: reward")
class TheThread(Good):
    def reward(self) -> float:
        return super().reward() + (threading.current_thread() is threading.main_thread())


@fault(r"episode 1, (reset|step \d+): observation\[1\]")
class TheLastBit(Good):
    def observe(self) -> Any:
        state = self.state.copy()
        if _NOISE.random() < 0.1:
            state[1] = np.nextafter(state[1], 2e6)
        return state


@fault(r"episode \d+, step \d+: (.*terminated|info|the order)")
class ItEndsAtRandom(Good):
    def ends(self) -> bool:
        return bool(_NOISE.random() < 0.05)
