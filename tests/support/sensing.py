"""A world in which single cubes are set down and asked what they sense."""

from __future__ import annotations

from typing import Any

from nmes import World

__all__ = ["Place", "Reply"]

Reply = dict[str, Any]


class Place:
    """A lockstep world and one client in it."""

    def __init__(self, **config: Any) -> None:
        self.world = World({"mode": "lockstep", "backend": "mujoco", **config})
        self.client = self.world.join()

    def __call__(self, type: str, **fields: Any) -> Reply:
        reply = self.world.execute(self.client, {"type": type, **fields})
        assert reply["type"] != "error", reply
        return reply

    def refused(self, type: str, **fields: Any) -> tuple[str, str | None]:
        reply = self.world.execute(self.client, {"type": type, **fields})
        assert reply["type"] == "error", reply
        return reply["code"], reply.get("field")

    def spawn(self, name: str, position: Any, **fields: Any) -> str:
        return str(self("spawn_cube", cube_name=name, position=position, **fields)["spawned"])

    def info(self, name: str, **fields: Any) -> Reply:
        return self("get_cube_info", cube_name=name, **fields)

    def settle(self, name: str) -> None:
        """Ticks until the cube sleeps."""
        for _ in range(300):
            self("step")
            if self.info(name)["sleeping"]:
                return
        raise AssertionError(f"{name} does not come to rest")
