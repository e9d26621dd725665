"""Environments over the wire: the numbers of the local ones, from worlds of a live host, and what goes wrong there."""

from __future__ import annotations

import gc
import ssl
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trustme
from gymnasium.utils import env_checker
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode

from creatures import snake
from nmes.backend import Array
from nmes.client import Client
from nmes.errors import CommandFailed, Disconnected, WorldError
from nmes.evaluation import Environments, Task
from nmes.genome import Genome
from nmes.learning import (
    Remote,
    RemoteEnvironments,
    RemoteVector,
    TaskEnv,
    TaskVectorEnv,
    check_determinism,
)
from nmes.learning.dm import DmEnvironment
from nmes.playback import replay
from nmes.world.commands import COMMANDS
from opengl import OPENGL
from servers import PASSWORD, Served, served, until

MUJOCO = {"backend": "mujoco"}


def asked(name: str = "walk", **changes: Any) -> Task:
    """Returns a task that ships, made short."""
    return Task({**Task.load(name).document, "duration": 0.5, "settle": 0.5, **changes})


def remote(
    server: Served, task: Task, genome: Genome | None = None, count: int = 1, **options: Any
) -> RemoteEnvironments:
    genome = Genome(snake()) if genome is None else genome
    return RemoteEnvironments(f"127.0.0.1:{server.port}", genome, task, count, password=PASSWORD, **options)


@pytest.fixture(scope="module")
def server() -> Iterator[Served]:
    """A host of three worlds as tasks have them, the first of which ticks by itself."""
    with served(
        {**MUJOCO, "name": "a", "mode": "realtime", "friction": 3.0}, *[{**MUJOCO, "name": n} for n in "bc"]
    ) as s:
        yield s


def draw(count: int, motors: int, ticks: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (ticks, count, motors))


def follow(core: RemoteEnvironments, local: Environments, actions: Array, first: Array) -> None:
    """Holds both to the same numbers, to the last bit, step by step."""
    assert np.array_equal(core.observations, first)
    for action in actions:
        for mine, its in zip(core.step(action), local.step(action), strict=True):
            assert np.array_equal(mine, its)
        assert np.array_equal(core.last_observations, local.last_observations)
    assert core.results == local.results


@pytest.mark.parametrize(
    ("task", "genome"),
    [("walk", "walker"), ("reach", "seeker"), ("carry", "roller"), ("pole", "juggler"), ("jump-far", "jumper")],
)
def test_the_numbers_are_those_of_the_local_environment(server: Served, task: str, genome: str) -> None:
    short, creature = asked(task), Genome.load(genome)
    core, local = remote(server, short, creature, seeds=[3, 4]), Environments(creature, short, 1, seeds=[3, 4])
    core.reset(1)
    # Several episodes, of scenes that are new and of such as are known by then.
    follow(core, local, draw(1, len(core.motors), 100), local.reset(1).copy())
    assert core.results[0] is not None and core.seeds == local.seeds
    core.close()


@pytest.mark.parametrize(
    ("task", "genome"), [("rough", "walker"), ("stairs", "roller"), ("gaps", "lurcher"), ("planar-walk", "inchworm")]
)
def test_worlds_of_tasks_with_scenes_are_served_by_their_config(task: str, genome: str) -> None:
    short, creature = asked(task), Genome.load(genome)
    with served({**short.world_config(1), "keyframes": 0.2}) as host:
        core, local = remote(host, short, creature, seeds=[5]), Environments(creature, short, 1, seeds=[5])
        core.reset(1)
        follow(core, local, draw(1, len(core.motors), 35), local.reset(1).copy())
        core.close()


def test_a_seed_below_0_is_refused_and_the_episode_goes_on(server: Served) -> None:
    core, actions = remote(server, asked("walk"), Genome.load("walker"), seeds=[3]), np.zeros((1, 8))
    core.reset(1)
    core.step(actions)
    with pytest.raises(ValueError, match="a seed is 0 or more, not -1"):
        core.reset(-1)
    core.step(actions)  # else it would ask for a reset
    core.close()


def test_a_limit_of_what_the_body_does_ends_an_episode_as_there(server: Served) -> None:
    creature = Genome.load("roller")
    for limits in ({"energy": 2.0}, {"speed": 0.2}, {"spin": 1.0}):
        short = asked(limits=limits)
        core, local = remote(server, short, creature, seeds=[3]), Environments(creature, short, 1, seeds=[3])
        core.reset(1)
        follow(core, local, np.ones((6, 1, len(core.motors))), local.reset(1).copy())
        result = core.results[0]
        assert result is not None and result.ended == next(iter(limits))
        core.close()


def test_rows_are_worlds_of_one_host(server: Served) -> None:
    creature, short = Genome(snake()), asked()
    core = remote(server, short, count=3, seeds=[3])
    assert core.reset(1).shape == (3, len(core.sensors))
    actions = draw(3, 3, 40)
    seen = [[part.copy() for part in core.step(action)] for action in actions]
    core.close()
    for row in range(3):
        local = Environments(creature, short, 1, seeds=[3])
        local.reset(1)
        for action, parts in zip(actions, seen, strict=True):
            for mine, its in zip(parts, local.step(action[row : row + 1]), strict=True):
                assert np.array_equal(mine[row], its[0])


def test_all_worlds_are_asked_before_the_first_answer_is_waited_for(
    server: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    core = remote(server, asked(), count=2, worlds=["b", "c"])
    core.reset(1)
    order: list[str] = []
    for name in ("post", "wait"):
        method = getattr(Client, name)

        def noted(*arguments: Any, method: Callable[..., Any] = method, name: str = name) -> Any:
            order.append(name)
            return method(*arguments)

        monkeypatch.setattr(Client, name, noted)
    core.step(np.zeros((2, 3)))
    assert order == ["post", "post", "wait", "wait"]
    core.close()


def test_what_happens_is_recorded_by_the_host(tmp_path: Path) -> None:
    with served(MUJOCO, record_to=tmp_path) as host:
        core = remote(host, asked())
        core.reset(1)
        for action in draw(1, 3, 40):
            core.step(action)
        core.close()
        with pytest.raises(WorldError, match="the host records"):
            core.record(0, tmp_path / "x.mcap")
    (path,) = tmp_path.glob("*.mcap")
    report = replay(path)
    assert report.verdict == "reproduced" and report.ticks > 90


def test_a_world_is_left_in_its_mode(server: Served) -> None:
    with server.client(world="a") as client:
        core = remote(server, asked())
        assert client.get_world_info()["mode"] == "lockstep"
        core.close()
        assert client.get_world_info()["mode"] == "realtime"


def test_worlds_may_be_named(server: Served) -> None:
    core = remote(server, asked(), count=2, worlds=["c", "b"])
    core.reset(0)
    core.close()
    with server.client(world="c") as c, server.client(world="a") as a:
        assert c.get_world_info()["counts"]["cubes"] == 4 and c.get_world_info()["seed"] in asked().seeds
        assert a.get_world_info()["mode"] == "realtime"
    with pytest.raises(CommandFailed) as refused:
        remote(server, asked(), worlds=["nowhere"])
    assert refused.value.code == "world_not_found"
    with pytest.raises(ValueError, match="worlds: expected 2, each once, one a row, got b, b"):
        remote(server, asked(), count=2, worlds=["b", "b"])
    with pytest.raises(WorldError, match="the host has 3 worlds, and 4 are needed") as few:
        remote(server, asked(), count=4)
    assert few.value.code == "too_few_worlds"


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"tick_rate": 30}, "tick_rate is 30, not 60"),
        ({"gravity": [0, -1.62, 0]}, r"gravity is \[0,-1.62,0\], not \[0,-9.81,0\]"),
        ({"substeps": 2}, "substeps is 2, not 4"),
        ({"scene": {"type": "planets"}}, 'scene/type is "planets", not "flat"'),
        ({"damping": {"linear": 0.5}}, r'damping is {"linear":0.5,"angular":0}, not null'),
    ],
)
def test_a_world_that_is_not_of_the_task_is_refused(config: dict[str, Any], words: str) -> None:
    with served({**MUJOCO, **config}) as host:
        with pytest.raises(WorldError, match=f"world 'main' is not one of task 'walk': .*{words}") as refused:
            remote(host, asked())
        assert refused.value.code == "wrong_world" and "nmes serve --config" in str(refused.value)
        until(lambda: host.call(lambda: host.hosted.clients) == 0)


def test_a_landscape_of_another_seed_is_refused() -> None:
    task = asked("rough")
    scene = task.world_config(1)["scene"]
    with served({**MUJOCO, "scene": {**scene, "heightfield": {**scene["heightfield"], "seed": 5}}}) as host:
        with pytest.raises(WorldError, match="scene/heightfield/seed is 5, not null"):
            remote(host, task)


def test_a_server_that_lacks_what_is_needed_is_refused(server: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    tell, spawn = COMMANDS["get_world_info"], COMMANDS["spawn_creature"]

    def poorer(*arguments: Any) -> dict[str, Any]:
        info = tell(*arguments)
        return {**info, "capabilities": [name for name in info["capabilities"] if name not in ("batch", "sense")]}

    def otherwise(*arguments: Any) -> dict[str, Any]:
        spawned = spawn(*arguments)
        return {**spawned, "sensors": spawned["sensors"][::-1]}

    with monkeypatch.context() as patched:
        patched.setitem(COMMANDS, "get_world_info", poorer)
        with pytest.raises(WorldError, match="the server lacks what an environment needs: batch, sense") as refused:
            remote(server, asked(), worlds=["b"])
        assert refused.value.code == "unsupported"
    core = remote(server, asked(), worlds=["b"])
    with monkeypatch.context() as patched:
        patched.setitem(COMMANDS, "spawn_creature", otherwise)
        with pytest.raises(WorldError, match="other sensors of this creature, or in another order"):
            core.reset(1)
    core.close()


def test_a_server_that_answers_something_else_is_no_traceback(server: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    core = remote(server, asked(), worlds=["b"])
    first = core.reset(1).copy()
    for answer in ({"values": [0.0]}, {"values": None}, {}):
        with monkeypatch.context() as patched:
            patched.setitem(COMMANDS, "sense", lambda *_, answer=answer: {"type": "senses", **answer})
            with pytest.raises(Disconnected, match="the server sent what is no answer") as lost:
                core.step(np.zeros((1, 3)))
            assert lost.value.code == "bad_reply"
        assert np.array_equal(core.reset(1), first)
    core.close()


def test_another_engine_gives_numbers_of_its_own() -> None:
    flat = Genome(snake())
    with served({"backend": "pymunk"}) as host:
        core = remote(host, asked(), flat)
        core.reset(1)
        for action in draw(1, 3, 31):
            core.step(action)
        assert core.results[0] is not None and core.results[0].ticks == 30
        core.close()


def test_a_host_that_refuses_the_creature_says_why() -> None:
    with served({**MUJOCO, "limits": {"cubes": 3}}) as host:
        core = remote(host, asked())
        with pytest.raises(CommandFailed) as refused:
            core.reset(1)
        assert refused.value.code == "limit_reached"
        core.close()
    with pytest.raises(WorldError, match="the body has 4 cubes, at most 2 are allowed"):
        RemoteEnvironments("127.0.0.1:1", Genome(snake()), asked(limits={"cubes": 2}), password="x")


def test_a_creature_that_does_not_come_to_rest_is_told(server: Served) -> None:
    core = remote(server, asked(settle=0.25, settle_limit=0.3, vary={"drop": [1.0, 1.0]}))
    with pytest.raises(WorldError, match=r"cannot begin with seed 1: restless: not yet at rest after 0\.3 s"):
        core.reset(1)
    core.close()


def test_a_fault_ends_the_episode_and_takes_back_what_was_given(
    server: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    core = remote(server, asked(objective="displacement.horizontal"), worlds=["b"], seeds=[3])
    core.reset(1)
    given = sum(float(core.step(action)[1][0]) for action in draw(1, 3, 5))
    assert given > 0.0

    def broken(_: int) -> None:
        raise RuntimeError("it broke")

    world = server.host.worlds["b"].world
    server.call(lambda: monkeypatch.setattr(world.entities.simulation, "step", broken))
    _, rewards, terminated, truncated = core.step(np.zeros((1, 3)))
    assert (terminated[0], truncated[0]) == (True, False)
    assert rewards[0] == pytest.approx(-given, abs=1e-15)
    result = core.results[0]
    assert result is not None and result.score is None and result.ticks == 5
    assert result.fault == "engine_failed: RuntimeError: it broke"
    assert not core.step(np.zeros((1, 3)))[2][0]  # the next episode goes on already
    core.close()


def test_somebody_who_steps_the_world_is_noticed(server: Served) -> None:
    core = remote(server, asked(), worlds=["b"])
    core.reset(1)
    with server.client(world="b") as other:
        other.step(2)
        with pytest.raises(
            WorldError, match=r"somebody else steps or resets world 'b': it is at frame \d+ and not"
        ) as e:
            core.step(np.zeros((1, 3)))
        assert e.value.code == "disturbed"
    with pytest.raises(ValueError, match="reset comes first"):
        core.step(np.zeros((1, 3)))
    core.reset()
    core.step(np.zeros((1, 3)))
    core.close()


def test_a_creature_that_somebody_takes_away_is_missed(server: Served) -> None:
    core = remote(server, asked(), worlds=["b"])
    core.reset(1)
    with server.client(world="b") as other:
        other.despawn_cube("creature.c0")
    with pytest.raises(CommandFailed) as missed:
        core.step(np.zeros((1, 3)))
    assert missed.value.code == "creature_not_found"
    core.close()


def test_a_reset_connects_anew_when_the_connection_is_lost(server: Served) -> None:
    core = remote(server, asked(), count=2, worlds=["b", "c"])
    first = core.reset(4).copy()
    for connection in server.call(lambda: [*server.host._connections]):
        server.call(connection.hang_up)
    with pytest.raises(Disconnected):
        core.step(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="reset comes first"):
        core.step(np.zeros((2, 3)))
    assert np.array_equal(core.reset(4), first)
    core.step(np.zeros((2, 3)))
    core.close()


def test_a_host_that_is_gone_is_told() -> None:
    with served(MUJOCO) as host:
        core = remote(host, asked())
        core.reset(1)
    with pytest.raises(Disconnected) as lost:
        core.step(np.zeros((1, 3)))
    assert lost.value.code == "world_closed" or lost.value.code == "disconnected"
    with pytest.raises(Disconnected) as lost:
        core.reset()
    assert lost.value.code == "unreachable"
    core.close()
    with pytest.raises(Disconnected, match="cannot connect to 127"):
        remote(host, asked())


def test_who_does_not_know_the_password_is_refused(server: Served) -> None:
    with pytest.raises(CommandFailed) as refused:
        RemoteEnvironments(f"127.0.0.1:{server.port}", Genome(snake()), asked(), password="wrong")
    assert refused.value.code == "auth_failed"


@pytest.mark.parametrize("address", ["127.0.0.1", ":14000", "host:", "host:0", "host:65536", "host:port", ""])
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(ValueError, match="an address is HOST:PORT, such as 127"):
        RemoteEnvironments(address, Genome(snake()), asked(), password="x")


@pytest.mark.parametrize(
    ("actions", "words"),
    [
        (np.full((1, 3), np.nan), "that of row 0 for 'j0' is nan"),
        (np.full((1, 3), 1.01), "actions are from -1 to 1; that of row 0 for 'j0' is 1.01"),
        (np.zeros((1, 2)), r"actions have the shape \(1, 3\), for each row and motor, not \(1, 2\)"),
        (np.zeros(3), r"not \(3,\)"),
    ],
)
def test_actions_that_are_none_move_nothing(server: Served, actions: Array, words: str) -> None:
    core = remote(server, asked(), worlds=["c"])
    core.reset(1)
    with server.client(world="c") as other:
        frame = other.get_world_info()["frame"]
        with pytest.raises(ValueError, match=words):
            core.step(actions)
        assert other.get_world_info()["frame"] == frame
    core.close()


def test_a_row_whose_episode_is_over_begins_the_next_as_it_was_asked(server: Served) -> None:
    actions = np.zeros((1, 3))
    local = Environments(Genome(snake()), asked(duration=0.1), 1, seeds=[3], autoreset="next_step")
    later = remote(server, asked(duration=0.1), worlds=["b"], seeds=[3], autoreset="next_step")
    later.reset(1)
    follow(later, local, draw(1, 3, 15), local.reset(1).copy())
    later.close()
    never = remote(server, asked(duration=0.1), worlds=["b"], autoreset="disabled")
    never.reset(1)
    for _ in range(6):
        never.step(actions)
    with pytest.raises(ValueError, match="the episode of row 0 is over: reset it first"):
        never.step(actions)
    never.reset(None, np.array([True]))
    never.step(actions)
    never.close()
    with pytest.raises(ValueError, match="autoreset is one of same_step, next_step, disabled, not 'soon'"):
        remote(server, asked(), autoreset="soon")


def test_rewards_of_ones_own_are_those_of_the_local_environment(server: Served) -> None:
    options: dict[str, Any] = {"seeds": [3], "reward": 'max.speed + contacts - cube("c1").height * energy'}
    core, local = remote(server, asked(), **options), Environments(Genome(snake()), asked(), 1, **options)
    core.reset(1)
    follow(core, local, draw(1, 3, 33), local.reset(1).copy())
    core.close()
    with pytest.raises(WorldError, match="expected"):
        remote(server, asked(), reward="speed +")


def test_resets_need_seeds_as_environments_do(server: Served) -> None:
    core = remote(server, asked(), count=2, worlds=["b", "c"])
    with pytest.raises(ValueError, match="reset comes first"):
        core.step(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="the first reset of a row needs a seed"):
        core.reset()
    seeds: Sequence[int | None] = [1]
    with pytest.raises(ValueError, match="there are 2 rows, not 1"):
        core.reset(seeds)
    core.close()
    with pytest.raises(ValueError, match="1 row and 1 seed or more, not 0 and 3"):
        remote(server, asked(), count=0)


# -- as Gymnasium has them --------------------------------------------------------------------------------------------


def settings(server: Served, **changes: Any) -> dict[str, Any]:
    common = {"address": f"127.0.0.1:{server.port}", "password": PASSWORD}
    return {**common, "task": asked(duration=0.3), "genome": snake(), **changes}


def test_gymnasium_finds_nothing_wrong_with_a_remote_environment(server: Served) -> None:
    env = Remote(**settings(server, world="b"))
    env_checker.check_env(env, skip_render_check=True)
    env.close()


def test_a_remote_environment_does_the_same_again(server: Served) -> None:
    env = Remote(**settings(server, world="b"))
    assert check_determinism(env, steps=60) == ("again",)
    env.close()


def test_tls_is_spoken_with_a_host_that_is_trusted() -> None:
    authority = trustme.CA()
    identity, trust = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH), ssl.create_default_context()
    authority.issue_cert("127.0.0.1").configure_cert(identity)
    authority.configure_trust(trust)
    with served(MUJOCO, {**MUJOCO, "name": "other"}, tls=identity) as host:
        envs = RemoteVector(count=2, **settings(host, tls=trust))
        assert envs.reset(seed=1)[0].shape == (2, len(envs.sensors))
        envs.close()
        with pytest.raises(Disconnected, match="certificate"):
            Remote(**settings(host, tls=True))


def test_an_environment_that_is_refused_leaves_no_connection(server: Served) -> None:
    with pytest.raises(ValueError, match="render_mode"):
        Remote(**settings(server, render_mode="sketch"))
    gc.collect()  # what is left open then is warned of, which fails the test


def remote_dm(**asked: Any) -> DmEnvironment:
    address, genome, task = (asked.pop(name) for name in ("address", "genome", "task"))
    return DmEnvironment(RemoteEnvironments(address, Genome.load(genome), task, autoreset="disabled", **asked))


@pytest.mark.parametrize("door", [Remote, partial(RemoteVector, count=1), remote_dm])
def test_an_environment_that_is_refused_leaves_the_world_in_its_mode(
    server: Served, door: Callable[..., object]
) -> None:
    senseless = snake(None, sensors=[])
    with server.client(world="a") as client:
        with pytest.raises(WorldError, match="no sensors"):
            door(**settings(server, genome=senseless))
        assert client.get_world_info()["mode"] == "realtime"


def test_a_remote_environment_is_the_local_one_in_another_place(server: Served) -> None:
    mode = "rgb_array" if OPENGL else None
    env, local = Remote(**settings(server, render_mode=mode)), TaskEnv(snake(), asked(duration=0.3))
    local.action_space.seed(1)
    for seed in (5, None):
        assert data_equivalence(env.reset(seed=seed), local.reset(seed=seed))
        over, infos = False, {}
        while not over:
            action = local.action_space.sample()
            step = env.step(action)
            assert data_equivalence(step, local.step(action))
            over, infos = step[2] or step[3], step[4]
        assert infos["result"]["seed"] in asked().seeds
    with pytest.raises(ValueError, match="the episode of row 0 is over"):
        env.step(local.action_space.sample())
    env.close()
    assert data_equivalence(env.reset(seed=5), local.reset(seed=5))
    env.close()


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_remote_vector_is_the_local_one_in_other_places(server: Served, mode: AutoresetMode) -> None:
    envs = RemoteVector(count=2, worlds=["b", "c"], autoreset_mode=mode, **settings(server))
    local = TaskVectorEnv(snake(), asked(duration=0.3), 2, autoreset_mode=mode)
    local.action_space.seed(1)
    assert data_equivalence(envs.reset(seed=3), local.reset(seed=3))
    for _ in range(40):
        actions = local.action_space.sample()
        one, other = envs.step(actions), local.step(actions)
        assert data_equivalence(one, other)
        if mode is AutoresetMode.DISABLED and (over := one[2] | one[3]).any():
            options = {"reset_mask": over}
            assert data_equivalence(envs.reset(options=options), local.reset(options=options))
    envs.close()
