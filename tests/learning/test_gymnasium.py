"""Environments of Gymnasium: upstream's checkers pass, and an episode has the bits of an evaluation."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from creatures import able, snake
from nmes.errors import DocumentError, MissingPackage, RecordingError, WorldError
from nmes.evaluation import Task, prove
from nmes.genome import Genome
from nmes.learning import TaskEnv, TaskVectorEnv
from nmes.playback import replay
from nmes.recording import Recording
from opengl import OPENGL, with_opengl

DRIVEN = [name for name in Task.names() if "injury" not in Task.load(name).document]  # there bodies keep their parts


def task(**changes: Any) -> Task:
    return Task({**Task.load("walk").document, "duration": 0.2, "seeds": [1, 2, 3], "limits": {}, **changes})


def made(task: Task, **settings: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make("nmes/creature-v0", genome=Genome(snake()), task=task, **settings)


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A screen that nobody looks at."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setenv("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    import pygame

    yield pygame
    pygame.display.quit()


# -- names ------------------------------------------------------------------------------------------------------------


def test_a_vector_that_was_closed_begins_again() -> None:
    envs = TaskVectorEnv(snake(), task(), 2)
    envs.reset(seed=5)
    envs.step(np.zeros((2, len(envs.motors))))
    envs.close()
    envs.reset()
    assert not envs.closed
    envs.step(np.zeros((2, len(envs.motors))))
    envs.close()
    assert envs.closed


def test_each_task_that_ships_has_its_name() -> None:
    names = {name for name in gymnasium.registry if name.startswith("nmes/")}
    assert names == {f"nmes/{task}-v0" for task in DRIVEN} | {"nmes/creature-v0"}


def run(program: str) -> str:
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.parametrize(
    "program",
    [
        "import gymnasium, nmes.learning",
        "import nmes.learning, gymnasium; nmes.learning.register()",
        "import gymnasium.envs.registration as g, gymnasium; g._find_spec('nmes.learning.registration:nmes/walk-v0')",
    ],
)
def test_names_are_registered_and_no_engine_is_loaded_for_it(program: str) -> None:
    loaded = "sorted({m.partition('.')[0] for m in sys.modules} & {'mujoco', 'pymunk', 'PIL'})"
    ours = "sorted(m for m in sys.modules if m.startswith('nmes'))"
    told = json.loads(
        run(f"{program}\nimport sys, json; print(json.dumps([{loaded}, {ours}, 'nmes/walk-v0' in gymnasium.registry]))")
    )
    assert told == [
        [],
        ["nmes", "nmes.errors", "nmes.learning", "nmes.learning.registration"],
        True,
    ]


def test_learning_alone_does_not_load_gymnasium() -> None:
    assert run("import nmes.learning, sys; print('gymnasium' in sys.modules)") == "False"


def test_a_package_that_is_not_there_is_named_with_its_extra() -> None:
    hidden = (
        "import sys; sys.modules['gymnasium'] = None\nimport nmes.learning\nfrom nmes.errors import MissingPackage\n"
    )
    for name in ("register", "TaskEnv", "TaskVectorEnv"):
        said = run(f"{hidden}try:\n nmes.learning.{name}\nexcept MissingPackage as e: print(e.message)")
        assert said == f"{name} needs gymnasium: pip install 'nmes[gym]'"


# -- one environment --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", DRIVEN)
def test_upstreams_checker_passes_each_task_without_a_warning(name: str, screen: Any) -> None:
    env = gymnasium.make(f"nmes/{name}-v0", genome=able(name), seeds=[1], disable_env_checker=True)
    check_env(env.unwrapped)
    env.close()


def test_spaces_have_names_units_and_bounds() -> None:
    kinds = ("position", "velocity", "effort"), ("up", "height", "spin", "touch", "target_direction", "target_distance")
    sensors = [{"type": kind, "joint": "*"} for kind in kinds[0]] + [
        {"type": kind, "cube": "torso"} for kind in kinds[1]
    ]
    genome = Genome({**Genome.load("walker").document, "sensors": sensors, "brain": {"kind": "constant"}})
    env = gymnasium.make("nmes/reach-v0", genome=genome).unwrapped
    assert isinstance(env, TaskEnv)
    body = genome.body
    assert env.sensors == tuple(sensor.id for sensor in body.sensors) == tuple(env.units)
    assert env.motors == tuple(motor.id for motor in body.motors)
    assert set(env.units.values()) == {"", "m", "rad", "10 rad/s"}
    assert env.units["torso.height"] == "m" and env.units[f"{env.motors[0]}.position"] == "rad"
    observed, acted = env.observation_space, env.action_space
    assert isinstance(observed, gymnasium.spaces.Box) and isinstance(acted, gymnasium.spaces.Box)
    assert observed.dtype == np.float64 and observed.is_bounded() and acted.dtype == np.float32
    assert (acted.low == -1).all() and (acted.high == 1).all()
    ups = [i for i, sensor in enumerate(body.sensors) if sensor.type in ("up", "target_direction")]
    assert ups and (observed.high[ups] < 1.001).all() and (observed.high[ups] >= 1).all()
    env.close()


def test_spaces_of_who_sees_others_and_talks_have_units_bounds_and_voices() -> None:
    sensors = [{"type": f"other_{what}", "cube": "torso"} for what in ("direction", "distance", "velocity")]
    sensors.append({"type": "hear", "cube": "torso", "channel": "lead"})
    voices = {"sensors": sensors, "voices": [{"channel": "lead"}], "brain": {"kind": "constant"}}
    env = gymnasium.make("nmes/walk-v0", genome=Genome({**Genome.load("walker").document, **voices})).unwrapped
    assert isinstance(env, TaskEnv)
    assert list(env.units.values()) == ["", "", "", "m", "m/s", "m/s", "m/s", ""]
    observed, acted = env.observation_space, env.action_space
    assert isinstance(observed, gymnasium.spaces.Box)
    assert observed.low.tolist() == pytest.approx([-1, -1, -1, 0, *[-1e12] * 3, -1])
    assert env.motors[-1] == "say.lead" and acted.shape == (len(env.motors),)
    env.reset(seed=1)
    observation, *_ = env.step(np.full(len(env.motors), 0.5))
    assert (observation == 0).all()  # it is alone
    env.close()


def test_what_is_seen_smelled_and_felt_has_units_and_bounds_and_is_observed() -> None:
    kinds = ("acceleration", "range", "target_smell")
    sensors: list[Any] = [{"type": kind, "cube": "torso"} for kind in kinds]
    sensors[1]["direction"] = [0, -1, 0]
    sensors.append({"type": "camera", "cube": "torso", "width": 2, "height": 1, "direction": [0, -1, 0]})
    sensors += [{"type": "height", "cube": "torso"}, {"type": "height", "cube": "torso", "id": "late"}]
    sensors[-1]["flaws"] = {"delay": 3, "noise": 0.001}
    genome = Genome({**Genome.load("walker").document, "sensors": sensors, "brain": {"kind": "constant"}})
    env = gymnasium.make("nmes/reach-v0", genome=genome).unwrapped
    assert isinstance(env, TaskEnv)
    assert list(env.units.values()) == ["10 m/s²", "10 m/s²", "10 m/s²", "m", "", "", "", "m", "m"]
    observed = env.observation_space
    assert isinstance(observed, gymnasium.spaces.Box)
    assert observed.low.tolist() == [*[-1e12] * 3, 0, 0, 0, 0, -1e12, -1e12]
    observation, _ = env.reset(seed=1)
    heights = [observation[7]]
    for _ in range(5):
        observation, *_ = env.step(np.full(len(env.motors), 0.9))
        assert observation in observed and observation[1] != 0 and 0 < observation[3] < 10
        heights.append(observation[7])
    assert observation[8] == pytest.approx(heights[-4], abs=0.006) and observation[8] != heights[-4]
    env.close()


def episode(env: Any, seed: int | None, ticks: int = 12) -> list[Any]:
    observation, info = env.reset(seed=seed)
    steps: list[Any] = [(observation.tobytes(), json.dumps(info))]
    for tick in range(ticks):
        observation, reward, terminated, truncated, info = env.step(np.full(3, np.sin(0.7 * tick)))
        steps.append((observation.tobytes(), reward, terminated, truncated, json.dumps(info)))
        if terminated or truncated:
            break
    return steps


def test_a_seed_gives_the_same_episodes_and_none_goes_on() -> None:
    asked = task(seeds=list(range(20, 24)))
    env, other = made(asked), made(asked)
    first = [episode(env, 3), episode(env, None), episode(env, None)]
    episode(other, 8), episode(other, None)
    assert [episode(other, 3), episode(other, None), episode(other, None)] == first
    assert len({json.dumps(steps[0][1]) for steps in first}) > 1
    unseeded = [made(asked) for _ in range(2)]
    drawn = [[env.reset()[1]["seed"] for _ in range(40)] for env in unseeded]
    assert drawn[0] != drawn[1]


def test_an_episode_is_over_once_and_tells_how_it_came_out() -> None:
    env = made(task())
    steps = episode(env, 1)
    assert len(steps) == 13 and not any(step[3] for step in steps[1:-1])
    _, _, terminated, truncated, info = steps[-1]
    told = json.loads(info)["result"]
    assert (terminated, truncated) == (False, True) and told["ticks"] == 12 and told["fault"] is None
    assert sum(step[1] for step in steps[1:]) == pytest.approx(told["score"], abs=1e-12)
    with pytest.raises(ValueError, match="reset it first"):
        env.step(np.zeros(3))
    early = made(task(ends=[{"name": "soon", "when": "time > 0.05"}]))
    _, _, terminated, truncated, info = episode(early, 1)[-1]
    assert (terminated, truncated, json.loads(info)["result"]["ended"]) == (True, False, "soon")


def test_observations_are_the_callers_own() -> None:
    env = made(task())
    kept = [env.reset(seed=1)[0], env.step(np.full(3, 0.5))[0]]
    bits = [observation.tobytes() for observation in kept]
    kept[0][:] = 7.0
    env.step(np.full(3, -0.5))
    assert kept[1].tobytes() == bits[1] and episode(env, 1)[0][0] == bits[0]


@with_opengl
def test_a_picture_follows_the_creature_and_changes_nothing() -> None:
    asked = task(duration=1)
    env, blind = made(asked, render_mode="rgb_array"), made(asked)
    assert episode(env, 1, 3) == episode(blind, 1, 3)
    first = env.render()
    for _ in range(20):
        assert env.step(np.full(3, 0.9))[0].tobytes() == blind.step(np.full(3, 0.9))[0].tobytes()
    second = env.render()
    assert isinstance(first, np.ndarray) and isinstance(second, np.ndarray)
    assert first.shape == second.shape == (480, 640, 3) and (first != second).any()
    env.reset(seed=1)
    again = env.render()
    assert isinstance(again, np.ndarray) and (again != second).any()
    for each in (env, blind):
        each.close()


@with_opengl
def test_a_window_shows_every_tick_and_changes_nothing(screen: Any) -> None:
    asked = task(duration=0.2)
    env, blind, drawn = made(asked, render_mode="human"), made(asked), made(asked, render_mode="rgb_array")
    shown = []
    for each in (env, blind, drawn):
        each.reset(seed=1)
    for _ in range(4):
        moments = [each.step(np.full(3, 0.9))[0].tobytes() for each in (env, blind, drawn)]
        assert len(set(moments)) == 1
        surface = screen.display.get_surface()
        shown.append(screen.surfarray.array3d(surface).transpose(1, 0, 2))
        assert (shown[-1] == drawn.render()).all() and env.render() is None
    assert (shown[0] != shown[-1]).any() and screen.display.get_caption()[
        0
    ] == f"{Genome(snake()).name} on {asked.name}"
    for each in (env, blind, drawn):
        each.close()
    assert not screen.display.get_init()


@with_opengl
def test_where_there_is_no_screen_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "no such driver")
    env = made(task(), render_mode="human")
    with pytest.raises(WorldError, match=r"no window can be opened here .*rgb_array") as refused:
        env.reset(seed=1)
    assert refused.value.code == "unsupported"
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(MissingPackage, match=r"needs pygame: pip install 'nmes\[gym\]'"):
        env.reset(seed=1)
    env.close()


def test_what_cannot_be_drawn_is_an_error() -> None:
    with pytest.raises(ValueError, match="render_mode is None or one of rgb_array, human, not 'sketch'"):
        TaskEnv(Genome(snake()), task(), render_mode="sketch")
    if OPENGL:
        with pytest.raises(ValueError, match="reset comes first"):
            TaskEnv(Genome(snake()), task(), render_mode="rgb_array").render()
    else:
        with pytest.raises(WorldError, match=r"install libegl1 .*leave render_mode out"):
            TaskEnv(Genome(snake()), task(), render_mode="rgb_array")
    with pytest.raises(WorldError, match="pymunk backend has no cameras") as refused:
        TaskEnv(Genome(snake()), task(world={"backend": "pymunk"}), render_mode="rgb_array")
    assert refused.value.code == "unsupported"


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"genome": "nobody"}, DocumentError, "nobody"),
        ({"genome": {"format": "nmes-genome/1"}}, DocumentError, "name"),
        ({"task": "fly"}, DocumentError, "fly"),
        ({"task": task(limits={"cubes": 2})}, WorldError, "4 cubes, at most 2"),
        ({"reward": "1 +"}, WorldError, "reward"),
        ({"seeds": []}, ValueError, "1 seed or more"),
        ({"genome": {**snake(), "sensors": []}}, WorldError, "no sensors"),
    ],
)
def test_what_does_not_fit_is_refused(settings: dict[str, Any], error: type[Exception], message: str) -> None:
    for kind in (TaskEnv, TaskVectorEnv):
        with pytest.raises(error, match=message):
            kind(**{"genome": snake(), "task": task(), **settings})


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(4), r"shape \(3,\), for each motor, not \(4,\)"),
        (np.zeros((1, 3)), r"not \(1, 3\)"),
        (np.array([0, np.nan, 0]), "'j1' is nan"),
        (np.array([0, 0, 1.5]), "'j2' is 1.5"),
    ],
)
def test_a_bad_action_moves_nothing(action: Any, message: str) -> None:
    env, other = made(task()), made(task())
    env.reset(seed=1), other.reset(seed=1)
    with pytest.raises(ValueError, match=message):
        env.unwrapped.step(action)
    assert env.step(np.zeros(3))[0].tobytes() == other.step(np.zeros(3))[0].tobytes()


def test_options_and_steps_that_make_no_sense_are_refused() -> None:
    env = TaskEnv(snake(), task())
    with pytest.raises(ValueError, match="reset comes first"):
        env.step(np.zeros(3))
    with pytest.raises(ValueError, match="not 'gravity'"):
        env.reset(options={"gravity": 1})


# -- recordings -------------------------------------------------------------------------------------------------------


def test_every_episode_is_recorded_and_proves_its_score(tmp_path: Path) -> None:
    env = made(task(), record=tmp_path / "all")
    for seed in (1, None):
        told = json.loads(episode(env, seed)[-1][4])
        assert prove(told["recording"]).result.to_json() == told["result"]
        assert replay(Recording(told["recording"])).verdict == "reproduced"
    episode(env, 1)
    assert len(list((tmp_path / "all").iterdir())) == 2  # the first episode once more is the same file
    env.reset(seed=1)
    env.step(np.full(3, 0.2))
    env.unwrapped.record(tmp_path / "part.mcap")  # type: ignore[attr-defined]
    assert replay(Recording(tmp_path / "part.mcap")).verdict == "reproduced"


def test_a_folder_that_cannot_be_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="cannot make the folder"):
        TaskEnv(snake(), task(), record=tmp_path / "file" / "more")


# -- many -------------------------------------------------------------------------------------------------------------

ENDS = [{"name": "gone", "when": "displacement.horizontal > 0.03"}]


def same(ours: Any, theirs: Any) -> bool:
    if isinstance(ours, dict):
        return isinstance(theirs, dict) and list(ours) == list(theirs) and all(same(ours[k], theirs[k]) for k in ours)
    if isinstance(ours, np.ndarray) and ours.dtype == object:
        return len(ours) == len(theirs) and all(same(a, b) for a, b in zip(ours, theirs, strict=True))
    if isinstance(ours, np.ndarray):
        return bool(ours.dtype == theirs.dtype and ours.tobytes() == theirs.tobytes())
    return type(ours) is type(theirs) and (ours == theirs) is True


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("ends", [[], ENDS])
def test_rows_are_what_gymnasiums_own_vector_makes_of_single_environments(mode: AutoresetMode, ends: list[Any]) -> None:
    asked = task(ends=ends, seeds=list(range(20, 24)))
    ours: VectorEnv[Any, Any] = gymnasium.make_vec(
        "nmes/creature-v0", num_envs=3, genome=snake(), task=asked, autoreset_mode=mode
    )
    theirs = SyncVectorEnv([lambda: TaskEnv(snake(), asked)] * 3, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] is mode and ours.single_observation_space == theirs.single_observation_space
    assert (ours.observation_space, ours.action_space) == (theirs.observation_space, theirs.action_space)
    draw, over = np.random.default_rng(0), 0
    starts: tuple[Any, ...] = 4, [7, 5, 6], None
    for start in starts:
        assert same(dict(enumerate(ours.reset(seed=start))), dict(enumerate(theirs.reset(seed=start))))
        for _ in range(30):
            actions = draw.uniform(-1, 1, (3, 3)).astype(np.float32)
            step, expected = ours.step(actions), theirs.step(actions)
            assert same(dict(enumerate(step)), dict(enumerate(expected)))
            done = step[2] | step[3]
            over += done.sum()
            if mode is AutoresetMode.DISABLED and done.any():
                with pytest.raises(ValueError, match="reset it first"):
                    ours.step(actions)
                again = [env.reset(options={"reset_mask": done.copy()}) for env in (ours, theirs)]
                assert same(*(dict(enumerate(each)) for each in again))
    assert over > 6
    ours.close()
    theirs.close()


def test_what_a_vector_returns_is_the_callers_unless_it_wants_the_arrays_themselves() -> None:
    envs = TaskVectorEnv(snake(), task(), 2)
    first, _ = envs.reset(seed=1)
    kept = envs.step(np.full((2, 3), 0.5))[:4]
    bits = [array.tobytes() for array in kept]
    for array in (first, *kept):
        assert array.flags.owndata and not any(
            np.shares_memory(array, other) for other in envs.step(np.zeros((2, 3)))[:4]
        )
    assert [array.tobytes() for array in kept] == bits
    shared = TaskVectorEnv(snake(), task(), 2, copy=False)
    assert shared.reset(seed=1)[0] is shared.step(np.zeros((2, 3)))[0]


def test_rows_can_be_recorded_all_or_on_demand(tmp_path: Path) -> None:
    for mode in AutoresetMode:
        envs = TaskVectorEnv(snake(), task(), 2, autoreset_mode=mode, record=tmp_path / mode.value)
        envs.reset(seed=1)
        for tick in range(12):
            info = envs.step(np.full((2, 3), np.sin(tick)))[4]
        told = info["final_info"] if mode is AutoresetMode.SAME_STEP else info
        envs.record(1, tmp_path / "one.mcap")
        scores = told["result"]["score"].tolist()
        assert [prove(path).result.score for path in told["recording"]] == scores
        assert prove(tmp_path / "one.mcap").result.score == scores[1]


@pytest.mark.parametrize(
    "mask", [np.zeros(2, bool), np.ones(3, bool), np.ones(2), [True, False]], ids=["none", "three", "floats", "list"]
)
def test_a_mask_that_is_none_is_refused(mask: Any) -> None:
    envs = TaskVectorEnv(snake(), task(), 2)
    with pytest.raises(ValueError, match="reset_mask is an array"):
        envs.reset(seed=1, options={"reset_mask": mask})
    with pytest.raises(ValueError, match="there are 2 rows"):
        envs.reset(seed=[1, 2, 3])
    first, _ = envs.reset(seed=1)
    with pytest.raises(ValueError, match="a seed is 0 or more, not -1"):
        envs.reset(seed=[7, -1])
    goes_on, _ = envs.reset()  # as if nobody had asked
    envs.reset(seed=np.array([1, 2]))  # type: ignore[arg-type]
    assert envs.reset()[0].tobytes() == goes_on.tobytes()
    assert envs.reset(seed=np.int64(1))[0].tobytes() == first.tobytes()
    with pytest.raises(ValueError, match="not 'x'"):
        envs.reset(options={"x": 1})
    with pytest.raises(ValueError):
        TaskVectorEnv(snake(), task(), 2, autoreset_mode="Sometimes")
