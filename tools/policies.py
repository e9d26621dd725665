"""Makes the policies of Stable-Baselines3 that tests read, and what they do: `tests/learning/policies`.

Needs Stable-Baselines3 and torch, which the tests do not: python tools/policies.py tests/learning/policies
"""

from __future__ import annotations

import io
import json
import re
import sys
import zipfile
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import A2C, DDPG, PPO, SAC, TD3
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

SENSORS, MOTORS = 8, 3
SMALL = {"net_arch": [8, 6]}
MODELS: dict[str, tuple[Any, dict[str, Any]]] = {
    "ppo": (PPO, {"policy_kwargs": SMALL}),
    "ppo-relu": (PPO, {"policy_kwargs": {**SMALL, "activation_fn": torch.nn.ReLU}}),
    "ppo-squashed": (PPO, {"use_sde": True, "policy_kwargs": {**SMALL, "squash_output": True}}),
    "ppo-elu": (PPO, {"policy_kwargs": {**SMALL, "activation_fn": torch.nn.ELU}}),
    "a2c": (A2C, {"policy_kwargs": {"net_arch": []}}),
    "sac": (SAC, {"policy_kwargs": SMALL, "learning_starts": 20}),
    "sac-sde": (SAC, {"use_sde": True, "policy_kwargs": SMALL, "learning_starts": 20}),
    "td3": (TD3, {"policy_kwargs": {**SMALL, "activation_fn": torch.nn.Tanh}, "learning_starts": 20}),
    "ddpg": (DDPG, {"policy_kwargs": SMALL, "learning_starts": 20}),
}


class Drift(gymnasium.Env[Any, Any]):
    """Observations that wander, some far and some hardly, and a reward for small actions."""

    def __init__(self, choices: int | None = None) -> None:
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (SENSORS,), np.float64)
        numbers = gymnasium.spaces.Box(-1.0, 1.0, (MOTORS,), np.float32)
        self.action_space = numbers if choices is None else gymnasium.spaces.Discrete(choices)
        self._scale = np.array([0.01, 0.1, 1.0, 1.0, 3.0, 10.0, 0.5, 0.0])

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        """Begins an episode of twenty steps."""
        super().reset(seed=seed)
        self._left = 20
        return self._look(), {}

    def step(self, action: Any) -> Any:
        """Goes one step on."""
        self._left -= 1
        return self._look(), -float(np.square(action).sum()), False, self._left == 0, {}

    def _look(self) -> Any:
        return self._scale * self.np_random.normal(0.5, 1.0, SENSORS)


def lessened(model: bytes) -> bytes:
    """Returns a model's file without its optimizers and what it says of the machine; pickled settings are left out."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(model)) as old, zipfile.ZipFile(out, "w") as new:
        for entry in old.infolist():
            data = old.read(entry)
            if entry.filename == "data":
                settings = json.loads(data)
                kept = {key: settings[key] for key in ("policy_class", "policy_kwargs", "action_space", "use_sde")}
                for value in kept.values():
                    if isinstance(value, dict) and ":serialized:" in value:
                        value[":serialized:"] = ""
                plain = {key: re.sub(r" at 0x\w+|\w*/[\w/.]*", "", json.dumps(value)) for key, value in kept.items()}
                data = json.dumps({key: json.loads(value) for key, value in plain.items()}, indent=4).encode()
            if entry.filename in ("data", "policy.pth", "_stable_baselines3_version"):
                new.writestr(zipfile.ZipInfo(entry.filename), data)
    return out.getvalue()


def make(algorithm: Any, options: dict[str, Any], environment: Any) -> Any:
    """Returns a model that has learned a little, and does much."""
    short = {"n_steps": 32} if algorithm in (PPO, A2C) else {}
    model = algorithm("MlpPolicy", environment, seed=3, device="cpu", **short, **deepcopy(options))
    model.learn(64)
    with torch.no_grad():
        for name, weights in model.policy.named_parameters():
            if name.startswith(("action_net.", "actor.mu.")):
                weights += 0.3 * torch.randn(weights.shape, generator=torch.Generator().manual_seed(len(name)))
    return model


def main(folder: Path) -> None:
    """Writes the files, and `expected.json`: of each policy some observations, and its actions."""
    expected: dict[str, Any] = {}
    seen = np.random.default_rng(1).normal(0.0, 3.0, (24, SENSORS)) * np.repeat([0.3, 1.0, 4.0], 8)[:, np.newaxis]
    for name, (algorithm, options) in MODELS.items():
        model = make(algorithm, options, Drift())
        save(model, folder / f"{name}.zip")
        expected[name] = {"observations": seen.tolist(), "actions": model.predict(seen, deterministic=True)[0].tolist()}
    choosing = make(PPO, {"policy_kwargs": {**SMALL, "net_arch": [4]}}, Drift(choices=MOTORS))
    save(choosing, folder / "choices.zip")
    rows = VecNormalize(DummyVecEnv([Drift]), clip_obs=2.0)
    model = make(PPO, {"policy_kwargs": SMALL}, rows)
    save(model, folder / "ppo-normalised.zip")
    rows.save(str(folder / "ppo-normalised.pkl"))
    actions = model.predict(rows.normalize_obs(seen).astype(np.float32), deterministic=True)[0]
    expected["ppo-normalised"] = {"observations": seen.tolist(), "actions": actions.tolist()}
    (folder / "expected.json").write_text(json.dumps(expected))


def save(model: Any, path: Path) -> None:
    """Writes a model's file, lessened."""
    file = io.BytesIO()
    model.save(file)
    path.write_bytes(lessened(file.getvalue()))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
