"""What may happen in a recorded world beside what an evaluation does: whatever makes it tell its journal something."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import orjson
from hypothesis import strategies as st

from nmes.protocol import COMMANDS as COMMAND_SCHEMAS
from nmes.protocol import parse
from nmes.world import World
from nmes.world.journal import Journal

STEP = {"type": "step"}
Deed = Callable[[World, int], int]  # takes the client who drives, and returns who does from then on


def stay(_world: World, client: int) -> int:
    """Changes nothing."""
    return client


def come_back(world: World, client: int) -> int:
    """Has the client leave, and come again at once."""
    world.leave(client)
    return world.join()


def sleep(world: World, client: int) -> int:
    """Has the world sleep meanwhile: what it is made of then is new."""
    world.leave(client)
    world.hibernate()
    world.wake()
    return world.join()


def let_in(world: World, client: int) -> int:
    """Lets somebody in who looks on."""
    world.join()
    return client


def tick(world: World, client: int) -> int:
    """Lets time go on."""
    world.tick()
    return client


def commands_about(creature: str) -> list[dict[str, Any]]:
    """Returns commands that no evaluation gives, about a creature that has a cube `c0` and a joint `j0`."""
    cube = f"{creature}.c0"
    return [
        {"type": "set_cube_state", "cube_name": cube, "linear_velocity": [9, 0, 0]},
        {"type": "apply_physics", "cube_name": cube, "impulse": [9, 0, 0]},
        {"type": "freeze_cube", "cube_name": cube, "freeze": True},
        {"type": "drive", "creature": creature, "controls": [1, 1, 1]},
        {"type": "set_joint_param", "joint_name": f"{creature}.j0", "param_name": "motor_max_force", "value": 1000},
        {"type": "spawn_cube"},
        STEP,
        {"type": "batch", "commands": [STEP]},
        {"type": "ping"},
        {"type": "nonsense"},
    ]


def deeds_about(creature: str) -> dict[str, st.SearchStrategy[Deed]]:
    """Returns what makes a world in which a creature stands tell its journal something, by the journal's method."""
    examples = [_about(creature, each) for command in COMMAND_SCHEMAS.values() for each in command.schema["examples"]]
    frames = st.sampled_from([orjson.dumps(each) for each in [*examples, *commands_about(creature)]])
    senders = st.sampled_from([stay, let_in, come_back, lambda world, _client: world.join()])
    say = st.tuples(senders, frames).map(lambda drawn: _saying(*drawn))
    return {
        "joined": st.just(let_in),
        "left": st.just(come_back),
        "received": say,
        "replied": say,
        "ticked": st.just(tick),
        "hibernated": st.just(sleep),
        "faulted": st.just(_breaking(creature)),
    }


def deeds_at(creature: str, places: int) -> st.SearchStrategy[dict[int, Deed]]:
    """Returns one to three deeds by the number of the step before which each is done, the last of which is given.

    Or it is one near the end, and the recording, though sound, ends with it or in the midst of it.
    """
    deeds = deeds_about(creature)
    each = st.sampled_from([*deeds]).flatmap(deeds.__getitem__)
    ticking = st.sampled_from(commands_about(creature)).map(lambda command: batch_of(command, STEP))
    hidden = st.tuples(each | ticking, st.integers(0, 3)).map(lambda drawn: hiding(*drawn))
    last = st.tuples(st.integers(places - 1, places), hidden).map(lambda drawn: dict([drawn]))
    return last | st.dictionaries(st.integers(0, places), each, min_size=1, max_size=3)


def batch_of(*commands: dict[str, Any]) -> Deed:
    """Returns what has the client do several commands at once."""
    frame = orjson.dumps({"type": "batch", "commands": [*commands]})
    return lambda world, client: _send(world, client, frame)


def hiding(deed: Deed, told: int) -> Deed:
    """Returns a deed whose recording ends, soundly, after so many of the things that the journal is told."""

    def hide(world: World, client: int) -> int:
        assert world.journal is not None
        world.journal = cast("Journal", _CutShort(world.journal, told))
        return deed(world, client)

    return hide


class _CutShort:
    """A journal that is told so many things yet, and nothing after."""

    def __init__(self, journal: Journal, told: int) -> None:
        self._journal, self._left = journal, told

    def __getattr__(self, name: str) -> Callable[..., None]:
        def tell(*about: Any) -> None:
            self._left -= 1
            if self._left >= 0:
                getattr(self._journal, name)(*about)

        return tell


def _about(creature: str, value: Any) -> Any:
    """Returns an example of the protocol as it is about a creature: what it is about is something of the creature's."""
    if isinstance(value, dict):
        return {key: _about(creature, each) for key, each in value.items()}
    if isinstance(value, list):
        return [_about(creature, each) for each in value]
    theirs = {"rocker": creature, "arm": "c1", "joint_1": f"{creature}.j0", "leg": f"{creature}.c1"}
    theirs |= dict.fromkeys(("walker", "body", "torso", "head"), f"{creature}.c0")
    return theirs.get(value, value) if isinstance(value, str) else value


def _send(world: World, client: int, frame: bytes) -> int:
    world.handle(client, parse(frame))
    return client


def _saying(sender: Deed, frame: bytes) -> Deed:
    """Returns what has the client that the first deed returns send a frame."""
    return lambda world, client: _send(world, sender(world, client), frame)


def _breaking(creature: str) -> Deed:
    """Returns what has the world stop with a fault at its next tick."""
    push = {"type": "apply_physics", "cube_name": f"{creature}.c0", "impulse": [1e15, 1e15, 1e15]}
    return lambda world, client: tick(world, _send(world, client, orjson.dumps(push)))
