"""What an editor must be able to follow in a clone: checked by a type checker in `make lint`, never run."""

from __future__ import annotations

from typing import assert_type

import nmes
import nmes.schemas
from nmes.backend import Backend
from nmes.backends.ballistic import BallisticBackend
from nmes.backends.mujoco3d import MujocoBackend
from nmes.cli import SUBCOMMANDS
from nmes.client.replies import CubeList
from nmes.evaluation import Evaluation, Task
from nmes.genome import Genome
from nmes.playback import ReplayReport
from nmes.recording import Recorder, Recording
from nmes.schemas import schema_hash


def follow(client: nmes.Client) -> None:
    """Uses what a clone maps into the package, and the package's front."""
    assert_type(client.spawn_cube(position=[0, 2, 0]), CubeList)
    assert_type(nmes.schemas.schema_hash(), str)
    assert_type(schema_hash(), str)
    assert_type(SUBCOMMANDS, dict[str, str])
    assert_type(BallisticBackend().name, str)
    assert_type(MujocoBackend().dims, int)
    assert_type(nmes.World({}).tick(), None)


async def follow_awaiting(awaiting: nmes.AsyncClient) -> None:
    """Uses the client whose commands are awaited."""
    assert_type(await awaiting.spawn_cube(position=[0, 2, 0]), CubeList)


def follow_front(recording: nmes.Recording, recorder: nmes.Recorder, genome: nmes.Genome, task: nmes.Task) -> None:
    """Uses what the package's front loads late, as what it is."""
    assert_type(recording, Recording)
    assert_type(recorder, Recorder)
    assert_type(genome, Genome)
    assert_type(task, Task)
    assert_type(nmes.load_backend("mujoco"), Backend)
    assert_type(nmes.replay(recording), ReplayReport)
    assert_type(nmes.evaluate(genome, task), Evaluation)
