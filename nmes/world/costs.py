"""What commands are expected to cost: guesses from what is cheap to see, for hosts that must not be kept waiting.

Hides the figures, measured on one core of a server of 2020 and rounded up. Nothing that a world does depends on them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from nmes import protocol
from nmes.world.linking import MOST_CUBES, MOST_LINKS

if TYPE_CHECKING:
    from nmes.world.entities import Entities

__all__ = ["BUILDING", "command_cost", "development_cost", "life_cost", "rebuild_cost", "telling_cost"]

BUILDING: Final = frozenset(
    {
        "adopt",
        "create_bone",
        "create_joint",
        "despawn_cube",
        "freeze_cube",
        "grow",
        "link_body_cubes",
        "link_cube_chains",
        "remove_joint",
        "reset",
        "set_cube_state",
        "shed",
        "spawn_creature",
        "spawn_cube",
    }
)
"""The commands for which the engine may have to build its model anew, at the next tick."""
_EDITING: Final = BUILDING | {"set_color"}  # after which creatures look anew at what is there

_COMMAND: Final = 2e-5  # s: a command of a batch, whatever it is
_STATE, _SENSED, _NAME = 5e-6, 3e-5, 1e-7  # s a cube: its state, with its sensors, and its name in a list
_CONTACT = 4e-5  # s: a contact of a cube that is told
_MOVED = 2e-5  # s a cube of a structure that is put elsewhere
_LINK, _COMPARED, _PAIR, _FACES = 5e-5, 2e-4, 1e-7, 3  # s a joint, a cube, and a pair of cubes; joints a cube
_GROWTH = 0.05  # s: a genome that is read, grown, judged and made
_EXPRESSION = 2e-3  # s: an expression of the greatest length that is read, over as many cubes as there may be
_SCENE = 0.02  # s: a scene that is made anew
_PICTURE, _PIXEL = 0.01, 1e-7  # s: a picture, and each of its pixels
_RAY, _MET = 3e-6, 2e-8  # s: a ray of a creature's sensors, and each cube or food that it may meet
_HEARD = 1.5e-6  # s a cube: its voice, listed once in a tick
_FOOD, _LIVES = 1.5e-6, 1e-6  # s: what is told of a place of food, and, a cube, of who lives
_SETTLED = 2e-5  # s a joined cube: to find anew what hangs together in creatures, after cubes or joints were edited
_CUT = 2e-6  # s: a joint that goes with its cube
_JUDGED = 1e-5  # s a cube: whether a part that grows would be in it
_RULE, _CHANGED = 5e-5, 1e-4  # s: a rule of development that is looked at; and, a cube, a part that it changes
_TOLD, _TOLD_OF = 5e-5, 5e-6  # s: a subscriber that is told of a tick, and each cube that is
_COMES, _GROWS = 0.05, 5e-5  # s: a creature that comes with the first tick, and food that grows
_SECOND = 0.05  # s: what of an ecosystem is done once in a second, such as births
_BUILT, _PART = 2e-3, 1e-3  # s: a model that an engine compiles, and each cube and joint in it


def _batch(entities: Entities, command: Mapping[str, Any]) -> float:
    cost, edited = 0.0, False
    for inner in command["commands"]:
        if edited and "creature" in inner:
            cost += _settled(entities)
        edited = inner["type"] in _EDITING or (edited and "creature" not in inner)
        cost += _COMMAND + command_cost(entities, inner)
    return cost


def _settled(entities: Entities) -> float:
    """Returns the cost of the first look for a creature after something was edited."""
    return min(len(entities.cubes), len(entities.joints) + 1) * _SETTLED


def _world_state(entities: Entities, command: Mapping[str, Any]) -> float:
    named = command.get("cubes")
    count = len(entities.cubes) if named is None else len(named)
    return count * _STATE + (len(entities.cubes) * _SENSED if command.get("sensors") else 0.0)


def _cube_info(entities: Entities, command: Mapping[str, Any]) -> float:
    cube, cubes = entities.cubes.get(command["cube_name"]), len(entities.cubes)
    if cube is None:
        return 0.0
    contacts = entities.simulation.guess_contacts(cube.body)
    cost = (cubes if contacts is None else contacts) * _CONTACT
    return cost + (cubes * _SENSED if command.get("sensors") or "rays" in command else 0.0)


def _chains(entities: Entities, command: Mapping[str, Any]) -> float:
    return sum(len(chain) for chain in command["chains"]) * _link(entities)


def _neighbours(entities: Entities, command: Mapping[str, Any]) -> float:
    cubes = min(len(entities.cubes), MOST_CUBES)
    return len(entities.cubes) * _NAME + cubes * (_COMPARED + cubes * _PAIR + _FACES * _link(entities))


def _link(entities: Entities) -> float:
    """Returns the cost of one more joint: where there are many, of the structure that it makes."""
    return _LINK + min(len(entities.joints), MOST_LINKS) * _NAME * 10.0


def _names(entities: Entities, command: Mapping[str, Any]) -> float:
    return len(entities.cubes) * _NAME if command.get("list", True) else 0.0


def _picture(entities: Entities, command: Mapping[str, Any]) -> float:
    default = protocol.COMMANDS["get_camera"].defaults
    pixels = command.get("width", default["width"]) * command.get("height", default["height"])
    return float(_PICTURE + pixels * _PIXEL + len(entities.cubes) * _STATE)


def _sense(entities: Entities, command: Mapping[str, Any]) -> float:
    return entities.rays * (_RAY + (len(entities.cubes) + len(entities.food)) * _MET)


def _growth(entities: Entities, command: Mapping[str, Any]) -> float:
    return 2.0 * _settled(entities) + len(entities.cubes) * _JUDGED


def _despawned(entities: Entities, command: Mapping[str, Any]) -> float:
    cube = entities.cubes.get(command.get("cube_name", ""))
    return 0.0 if cube is None else len(cube.joints) * _CUT


_COSTS: Final[Mapping[str, Callable[[Entities, Mapping[str, Any]], float]]] = {
    "adopt": lambda entities, command: 2.0 * _settled(entities),
    "batch": _batch,
    "despawn_cube": _despawned,
    "get_camera": _picture,
    "get_cube_info": _cube_info,
    "get_cube_list": _names,
    "get_joint_list": lambda entities, command: len(entities.joints) * _STATE,
    "get_joints_for_cube": lambda entities, command: len(entities.joints) * _NAME,
    "get_life": lambda entities, command: len(entities.food) * _FOOD + len(entities.cubes) * _LIVES,
    "get_planets": lambda entities, command: len(entities.food) * _FOOD,
    "get_world_info": lambda entities, command: len(entities.joints) * _NAME,
    "get_world_state": _world_state,
    "give": lambda entities, command: min(len(entities.cubes), len(entities.joints) + 1) * _NAME * 10.0,
    "grow": _growth,
    "hear": lambda entities, command: len(entities.cubes) * _HEARD,
    "link_body_cubes": _neighbours,
    "link_cube_chains": _chains,
    "reset": lambda entities, command: _SCENE,
    "sense": _sense,
    "set_cube_state": lambda entities, command: min(len(entities.cubes), len(entities.joints) + 1) * _MOVED,
    "set_objective": lambda entities, command: _EXPRESSION,
    "shed": lambda entities, command: 2.0 * _settled(entities),
    "spawn_creature": lambda entities, command: _GROWTH,
    "spawn_cube": _names,
}


def command_cost(entities: Entities, command: Mapping[str, Any]) -> float:
    """Returns about how long (s) a valid command takes, its ticks left out; 0.0 where that is next to nothing."""
    cost = _COSTS.get(command["type"])
    return 0.0 if cost is None else cost(entities, command)


def rebuild_cost(entities: Entities) -> float:
    """Returns about how long (s) an engine takes to take up that cubes or joints were edited."""
    return _BUILT + (len(entities.cubes) + len(entities.joints)) * _PART


def development_cost(entities: Entities, rules: int, changes: int) -> float:
    """Returns about how long (s) it takes to look at so many rules of development, which change so many parts."""
    return rules * _RULE + changes * len(entities.cubes) * _CHANGED


def telling_cost(entities: Entities, subscribers: int) -> float:
    """Returns about how long (s) it takes to tell so many subscribers of a tick."""
    return subscribers * (_TOLD + len(entities.cubes) * _TOLD_OF)


def life_cost(rules: Mapping[str, Any], tick_rate: int, frame: int, ticks: float) -> float:
    """Returns about how much longer (s) ticks take than most others of an ecosystem: of the next second at most.

    Args:
        rules: `life` of the world's complete config.
        tick_rate: Ticks per second.
        frame: The frame before them.
        ticks: How many; may be infinite.
    """
    last, food = frame + int(min(ticks, tick_rate)), rules["food"]
    grown = int(last * food["rate"] / tick_rate) - int(frame * food["rate"] / tick_rate)
    cost = grown * _GROWS + (_SECOND if last // tick_rate > frame // tick_rate else 0.0)
    if frame == 0 < last:
        cost += _SECOND + rules["population"]["start"] * _COMES + food["start"] * _GROWS
    return cost
