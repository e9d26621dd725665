"""Hosts with workers, `nmes serve --workers`, run as processes, and how they are judged from outside."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from nmes import Client
from nmes.errors import CommandFailed, Disconnected
from nmes.recording import Recording
from nmes.world import World
from processes import process, ready
from servers import PASSWORD, PATIENCE

PLAIN = ("--backend", "ballistic", "--mode", "lockstep")


class Fleet:
    """A host with workers that is running."""

    def __init__(self, server: subprocess.Popen[str], folder: Path, info: Mapping[str, Any]) -> None:
        self.server, self.folder, self.info = server, folder, info
        self.port: int = info["port"]

    def client(self, world: str | None = None, **options: Any) -> Client:
        """Returns a client, of a world or, to ask the host, of none."""
        return Client(world=world, **{"port": self.port, "password": PASSWORD, "timeout": PATIENCE, **options})

    def worlds(self) -> dict[str, Any]:
        """Returns what the list tells of the worlds, by name."""
        return {world["world"]: world for world in self.client().worlds()}

    def workers(self) -> list[int]:
        """Returns the processes of the workers, in the order in which they were started."""
        found = []
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                fields = stat.read_text().rpartition(")")[2].split()
            except (FileNotFoundError, ProcessLookupError):
                continue
            if int(fields[1]) == self.server.pid and fields[0] != "Z":
                found.append((int(fields[19]), int(stat.parent.name)))
        return [pid for _, pid in sorted(found)]

    def homes(self) -> dict[int, list[str]]:
        """Returns which worlds each worker says that it has, by its own port; none that two of them have.

        They are asked one after the other, and a world may move meanwhile: until two rounds say the same.
        """

        def asked() -> dict[int, list[str]]:
            ports = {world["worker_port"] for world in self.worlds().values() if "worker_port" in world}
            return {port: [world["world"] for world in self.client(port=port).worlds()] for port in ports}

        before, homes = asked(), asked()
        while homes != before:
            before, homes = homes, asked()
        named = [name for names in homes.values() for name in names]
        assert len(named) == len(set(named)), homes
        return homes

    def stop(self) -> None:
        """Tells the host to end, and sees that it ends well."""
        self.server.send_signal(signal.SIGTERM)
        _, err = self.server.communicate(timeout=PATIENCE)
        assert self.server.returncode == 0 and "Traceback" not in err, err

    def digests(self, world: str) -> list[str]:
        """Returns the digests of all ticks of a world that all its recordings tell, of which none tells one again."""
        ticks: dict[int, str] = {}
        for path in sorted(self.folder.glob(f"{world}-*.mcap")):
            recording = Recording(path)
            tick = recording.start().frame
            for record in recording:
                for digest in record.digests:
                    tick += 1
                    assert tick not in ticks, f"{path.name} has tick {tick} again"
                    ticks[tick] = digest
        assert list(ticks) == list(range(1, len(ticks) + 1)), "ticks are missing"
        return list(ticks.values())


@contextmanager
def fleet(folder: Path, *options: str, workers: int = 2) -> Iterator[Fleet]:
    """Runs a host with workers that records to a folder."""
    arguments = ["--json", "--port", "0", "--workers", str(workers), "--record", str(folder), *options]
    with process("serve", *arguments, NMES_PASSWORD=PASSWORD) as server:
        yield Fleet(server, folder, ready(server))


def kill(pid: int) -> None:
    """Ends a process at once."""
    os.kill(pid, signal.SIGKILL)


class Driver:
    """A client that drives a world on whatever happens to it, and knows how it must come out.

    Each push is a `batch` that ticks once, so that the frame tells whether it was done where that was not answered.

    Attributes:
        digests: Those of a twin of the world, which lives here and gets the same commands.
        pauses: For how long (s) the world did not answer, each time that the connection was lost.
    """

    def __init__(self, host: Fleet, world: str, config: Mapping[str, Any]) -> None:
        self.digests: list[str] = []
        self.pauses: list[float] = []
        self.told: set[str] = set()  # the codes with which connections were lost
        self._client = host.client(world).connect()
        self._twin = World({**config, "name": world})
        self._own = self._twin.join()
        self._twin.execute(self._own, self._spawn())
        self._client.request(self._spawn())

    def _spawn(self) -> dict[str, Any]:
        return {"type": "spawn_cube", "cube_name": "a", "position": [0, 2, 0]}

    def close(self) -> None:
        self._client.close()
        self._twin.close()

    def push(self, number: int) -> None:
        """Pushes the cube and ticks, and goes on only when both were done, once."""
        force = [((number * 37) % 19) / 3 - 3, ((number * 11) % 7) / 2, 0.5]
        commands = [{"type": "apply_force", "cube_name": "a", "force": force}, {"type": "step"}]
        batch = {"type": "batch", "commands": commands}
        lost = None
        done = False
        while not done:
            try:
                if lost is not None:
                    self._client.reconnect()
                    if self._client.get_world_info()["frame"] == len(self.digests) + 1:
                        break
                results = self._client.request(batch)["results"]
                done = all(result["type"] != "error" for result in results)
                assert done, results
            except (Disconnected, CommandFailed) as error:
                assert error.code in ("world_moved", "disconnected"), error
                self.told.add(error.code)
                lost = lost or time.monotonic()
        if lost is not None:
            self.pauses.append(time.monotonic() - lost)
        self._twin.execute(self._own, batch)
        self.digests.append(self._twin.digest().hex())


def settle(condition: Callable[[], bool], patience: float = PATIENCE) -> None:
    """Waits until a condition holds that other processes bring about."""
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "the condition does not hold"
        time.sleep(0.05)
