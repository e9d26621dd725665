"""A task's scene as it goes over the wire: the commands that set it and ask about it, and what replies tell of it.

Hides which commands and fields of the protocol these are, and that what a world's config says of surfaces, which no
command changes, can be said with each cube instead. No I/O.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from nmes import protocol
from nmes.backend import Array
from nmes.backend.shapes import Shape
from nmes.errors import WorldError
from nmes.evaluation.task import CREATURE, Task
from nmes.genome import Genome
from nmes.objective.trajectory import Flags, ObservedBodies
from nmes.schemas.documents import JsonObject

__all__ = ["Moment", "WireScene", "require_world"]

_NEEDED: Final = (
    "batch",
    "compute_reward",
    "drive",
    "get_world_state",
    "reset",
    "sense",
    "set_cube_state",
    "set_mode",
    "set_objective",
    "spawn_creature",
    "step",
)  # of what a server may leave out
_GIVEN: Final = ("friction", "restitution")  # of the world's config: said with each cube instead
_OF_HOST: Final = ("name", "seed", "mode", "rate", "keyframes", "limits")  # that change no number
_OF_ENGINE: Final = ("backend", "substeps", "engine")  # that another engine has otherwise
_SHOWN: Final = 60  # characters of a value in an error


class Moment(NamedTuple):
    """What a world told of a tick.

    Attributes:
        senses: What the creature's sensors read, array (s,).
        states: Of its cubes and the props, array (n, 13).
        touches: As `Trajectory.touches`, array (n, 2); without rows where nobody asks.
        energy: What the creature's motors have worked since the start, J.
    """

    senses: Array
    states: Array
    touches: Flags
    energy: float


class WireScene:
    """The scenes of a creature on a task, for whichever seed, in commands and replies.

    Args:
        genome: The creature.
        task: What it is asked to do.
        touchy: Whether contacts are asked for.

    Attributes:
        body: The creature's.
        bodies: What episodes are about, with the target of one of them.
        look: The commands that ask for a moment.
        look_at_body: The command that asks for the states of the body's cubes.
    """

    def __init__(self, genome: Genome, task: Task, *, touchy: bool) -> None:
        self._genome, self._task, self._touchy = genome.expanded(), task, touchy
        cubes, props = genome.body.cubes, task.document["props"]
        sizes = np.array([*(cube.size for cube in cubes), *(prop["size"] for prop in props)], float)
        masses = np.array([*(cube.mass for cube in cubes), *(prop["mass"] for prop in props)], float)
        ids = (*(cube.id for cube in cubes), *task.prop_ids())
        self.body = genome.body
        boxes: list[Shape] = ["box"] * len(props)
        shapes = (*(cube.shape for cube in cubes), *boxes)
        target = task.target(task.seeds[0])
        self.bodies = ObservedBodies(ids, len(cubes), sizes, masses, task.tick_rate, target, shapes)
        body = [f"{CREATURE}.{cube.id}" for cube in cubes]
        self._own = set(body)
        self.look_at_body: JsonObject = {"type": "get_world_state", "cubes": body}
        self.look: list[JsonObject] = [
            {"type": "sense", "creature": CREATURE},
            {
                "type": "get_world_state",
                "cubes": [*body, *task.prop_ids()],
                **({"sensors": True} if touchy else {}),
            },
            {"type": "compute_reward", "objective": "energy"},
        ]

    def set_down(self, seed: int) -> list[JsonObject]:
        """Returns the commands that empty the world and set the creature down: first `reset`, then `spawn_creature`."""
        document, surface = self._genome.document, self._surface(seed)
        body = document["body"]
        cubes = [{**surface, **cube} for cube in body["cubes"]]
        document = {**document, "body": {**body, "cubes": cubes}}
        return [{"type": "reset", "seed": seed}, *self._task.entry(seed, document, self._genome.body)]

    def start(self, seed: int, root: Array) -> list[JsonObject]:
        """Returns the commands that begin the episode, when the creature is at rest.

        Args:
            seed: The scene's.
            root: State of the creature's root, array (13,).
        """
        surface = self._surface(seed)
        props = self._task.props(seed, self._genome.body, root)
        measure = {"type": "set_objective", "expression": "energy", "name": "energy", "creature": CREATURE}
        return [*({**p, **surface} if p["type"] == "spawn_cube" else p for p in props), measure]

    def _surface(self, seed: int) -> JsonObject:
        config = self._task.world_config(seed)
        return {name: config[name] for name in _GIVEN}

    def tick(self, controls: Sequence[float]) -> JsonObject:
        """Returns the command that drives the creature, goes one tick on, and looks; its reply has `results`."""
        drive = {"type": "drive", "creature": CREATURE, "controls": controls}
        return {"type": "batch", "commands": [drive, {"type": "step"}, *self.look]}

    def require_parts(self, spawned: Mapping[str, Any]) -> None:
        """Raises WorldError (`unsupported`) unless the creature's numbers come in the order that its genome says."""
        body = self._genome.body
        for name, parts in (("sensors", body.sensors), ("motors", body.motors), ("voices", body.voices)):
            if spawned.get(name, []) != [part.id for part in parts]:
                raise WorldError("unsupported", f"the server has other {name} of this creature, or in another order")

    def states(self, cubes: Sequence[Mapping[str, Any]]) -> Array:
        """Returns the states of cubes, array (n, 13) as `Simulation.states`, from what `world_state` has of them."""
        return np.array(
            [c["position"] + c["quaternion"] + c["linear_velocity"] + c["angular_velocity"] for c in cubes], np.float64
        )

    def moment(self, senses: Mapping[str, Any], states: Mapping[str, Any], reward: Mapping[str, Any]) -> Moment:
        """Returns the moment that the replies to `look` describe.

        Raises:
            KeyError, TypeError, ValueError: They are none.
        """
        cubes = states["cubes"]
        touches = [self._touch(cube["contacts"]) for cube in cubes] if self._touchy else []
        moment = Moment(
            np.array(senses["values"], np.float64),
            self.states(cubes),
            np.array(touches, np.bool_).reshape(-1, 2),
            float(reward["value"]),
        )
        if moment.senses.shape != (len(self.body.sensors),) or moment.states.shape != (len(self.bodies.cubes), 13):
            raise ValueError(f"senses of the shape {moment.senses.shape}, states of {moment.states.shape}")
        return moment

    def _touch(self, contacts: Sequence[Mapping[str, Any]]) -> tuple[bool, bool]:
        return bool(contacts), any(contact["cube_name"] not in self._own for contact in contacts)


def require_world(info: Mapping[str, Any], task: Task) -> None:
    """Raises WorldError (`unsupported`, `wrong_world`) unless a world, by its `world_info`, can be one of a task."""
    missing = [name for name in _NEEDED if name not in info["capabilities"]]
    if missing:
        raise WorldError("unsupported", f"the server lacks what an environment needs: {', '.join(missing)}")
    wanted, stated = task.world_config(0), info["config"]
    skipped = {*_GIVEN, *_OF_HOST}
    if stated.get("backend") != wanted["backend"]:
        skipped |= {*_OF_ENGINE}
    names = [name for name in (*wanted, "damping") if name in stated and name not in skipped]
    different = [line for name in names for line in _different(name, wanted.get(name), stated[name])]
    if different:
        reason = f"world {info['world']!r} is not one of task {task.name!r}: {'; '.join(different)}"
        raise WorldError("wrong_world", f"{reason}. Serve it with `nmes serve --config FILE`, with the task's `world`")


def _different(path: str, wanted: Any, stated: Any) -> Iterator[str]:
    """Yields what a world states otherwise than is wanted; what it does not state may be anything."""
    if isinstance(wanted, dict) and isinstance(stated, dict):
        for key, value in stated.items():
            yield from _different(f"{path}/{key}", wanted.get(key), value)
    elif stated != wanted:
        yield f"{path} is {_short(stated)}, not {_short(wanted)}"


def _short(value: Any) -> str:
    text = protocol.encode({"": value}).decode()[4:-1]
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."
