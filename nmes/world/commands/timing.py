"""The commands about time: modes, ticks, pauses and resets."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nmes import protocol
from nmes.errors import WorldError
from nmes.schemas.documents import JsonObject
from nmes.world.clients import Client
from nmes.world.rights import Right, everything
from nmes.world.state import Barrier

if TYPE_CHECKING:
    from nmes.world.world import World

__all__ = ["COMMANDS", "RIGHTS"]


def step(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Ticks, in lockstep or in a paused world."""
    if world.mode != "lockstep" and not world.paused:
        raise WorldError("wrong_mode", f"step works in lockstep or in a paused world, not in {world.mode}")
    if world.barrier is None:
        world.step(command.get("ticks", 1))
    elif world.in_batch:
        raise WorldError("wrong_mode", "a step that waits for others cannot be part of a batch")
    # Else the host has made this client wait until all were there, and has ticked.
    return {"type": "stepped", "frame": world.frame, "t": world.time}


def pause(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Stops the clock of a world that ticks by itself."""
    world.paused = True
    return {"type": "paused", "frame": world.frame}


def resume(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Lets the clock run again."""
    world.paused = False
    return {"type": "resumed", "frame": world.frame}


def set_mode(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Sets who decides when the world ticks, and how fast."""
    mode, barrier = command["mode"], None
    if command.get("barrier", False):
        if mode != "lockstep":
            raise WorldError("wrong_mode", f"barrier: only in lockstep, not in {mode}", "barrier")
        default = protocol.COMMANDS["set_mode"].defaults
        barrier = Barrier(command.get("agents", default["agents"]), float(command.get("timeout", default["timeout"])))
    world.mode, world.barrier = mode, barrier
    world.rate = float(command.get("rate", world.rate))
    reply: JsonObject = {"type": "mode_set", "mode": mode, "rate": world.rate}
    return {**reply, "barrier": True} if barrier is not None else reply


def reset(world: World, client: Client, command: JsonObject) -> JsonObject:
    """Empties the world and begins again at frame 0."""
    world.reset(command.get("seed", world.seed))
    return {"type": "world_reset", "frame": 0, "seed": world.seed}


COMMANDS = {"step": step, "pause": pause, "resume": resume, "set_mode": set_mode, "reset": reset}
RIGHTS = {
    "step": Right("time", everything),
    "pause": Right("time", everything),
    "resume": Right("time", everything),
    "set_mode": Right("time", everything),
    "reset": Right("reset", everything),
}
