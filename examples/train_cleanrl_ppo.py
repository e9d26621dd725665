"""Trains a creature with PPO in one file, in the style of CleanRL's `ppo_continuous_action.py`, and writes a genome.

    pip install 'nmes[gym]' torch
    python examples/train_cleanrl_ppo.py --genome walker --task walk --steps 1000000 -o trained.json
    nmes eval trained.json --task walk

Sources: S. Huang et al., "CleanRL: high-quality single-file implementations of deep reinforcement learning
algorithms", Journal of Machine Learning Research 23 (2022); J. Schulman et al., "Proximal policy optimization
algorithms" (2017).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import nn
from torch.distributions import Normal

import nmes.learning  # noqa: F401 (with it Gymnasium knows its environments)
from nmes.evaluation import Task, evaluate
from nmes.genome import Genome

ROWS, TICKS, EPOCHS, PORTIONS = 32, 256, 10, 8
RATE, GAMMA, LAMBDA, CLIP, ENTROPY, VALUE, NORM = 3e-4, 0.99, 0.95, 0.2, 0.0, 0.5, 0.5


def layer(inputs: int, outputs: int, gain: float = 2.0**0.5) -> Any:
    """Returns a layer with orthogonal weights and without biases."""
    made = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.zeros_(made.bias)
    return made


class Agent(nn.Module):  # type: ignore[misc] # its package is not there where types are checked
    """A policy and what it expects to earn."""

    def __init__(self, sensors: int, motors: int) -> None:
        super().__init__()
        self.critic = nn.Sequential(layer(sensors, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, 1, 1.0))
        self.actor = nn.Sequential(layer(sensors, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, motors, 0.01))
        self.log_std = nn.Parameter(torch.full((motors,), -0.7))

    def act(self, observations: Any, actions: Any = None) -> tuple[Any, Any, Any, Any]:
        """Returns actions, drawn if none are given, their log-probability, the entropy, and the value."""
        normal = Normal(self.actor(observations), self.log_std.exp())
        actions = normal.sample() if actions is None else actions
        return actions, normal.log_prob(actions).sum(1), normal.entropy().sum(1), self.critic(observations)[:, 0]

    def genome(self, creature: Genome) -> Genome:
        """Returns the creature with the policy for its brain."""
        linear = [part for part in self.actor if isinstance(part, nn.Linear)]
        layers = [{"weights": each.weight.tolist(), "biases": each.bias.tolist()} for each in linear]
        brain = {"kind": "mlp", "layers": [*layers[:-1], {**layers[-1], "activation": "identity"}]}
        return Genome({**creature.document, "brain": brain, "parents": [creature.hash]})


def collect(envs: Any, agent: Agent, seen: Any) -> tuple[Any, dict[str, Any], list[float]]:
    """Steps all rows; returns what is seen next, what was gathered (ticks, rows, ...), and the scores of episodes."""
    kept: dict[str, list[Any]] = {
        name: [] for name in ("seen", "actions", "logs", "values", "rewards", "over", "beyond")
    }
    scores = []
    for _ in range(TICKS):
        with torch.no_grad():
            actions, logs, _, values = agent.act(seen)
        following, rewards, terminated, truncated, told = envs.step(np.clip(actions.numpy(), -1.0, 1.0))
        beyond = torch.zeros(ROWS)  # what an episode that only lasted its time would still have earned
        for row in np.flatnonzero(terminated | truncated).tolist():
            score = told["final_info"]["result"]["score"][row]
            if score is not None:  # of a world that faulted there is none
                scores.append(score)
            if truncated[row]:
                with torch.no_grad():
                    beyond[row] = agent.critic(as_tensor(told["final_obs"][row]))[0]
        tick = (seen, actions, logs, values, as_tensor(rewards), as_tensor(terminated | truncated), beyond)
        for name, value in zip(kept, tick, strict=True):
            kept[name].append(value)
        seen = as_tensor(following)
    return seen, {name: torch.stack(values) for name, values in kept.items()}, scores


def advantages(gathered: dict[str, Any], last: Any) -> Any:
    """Returns generalised advantages (ticks, rows); `last` is what is expected after the last tick."""
    found, running = torch.zeros_like(gathered["rewards"]), torch.zeros(ROWS)
    for tick in reversed(range(TICKS)):
        goes_on = 1.0 - gathered["over"][tick]
        after = last * goes_on + gathered["beyond"][tick]
        error = gathered["rewards"][tick] + GAMMA * after - gathered["values"][tick]
        running = error + GAMMA * LAMBDA * goes_on * running
        found[tick], last = running, gathered["values"][tick]
    return found


def improve(agent: Agent, optimizer: Any, gathered: dict[str, Any], gains: Any) -> None:
    """Makes what went well more likely, in portions of what was gathered."""
    flat = {name: values.flatten(0, 1) for name, values in gathered.items()}
    gains, aims = gains.flatten(), (gains + gathered["values"]).flatten()
    for _ in range(EPOCHS):
        for places in torch.randperm(TICKS * ROWS).chunk(PORTIONS):
            _, logs, entropy, values = agent.act(flat["seen"][places], flat["actions"][places])
            ratio = (logs - flat["logs"][places]).exp()
            gain = (gains[places] - gains[places].mean()) / (gains[places].std() + 1e-8)
            policy = -torch.min(gain * ratio, gain * ratio.clamp(1.0 - CLIP, 1.0 + CLIP)).mean()
            loss = policy - ENTROPY * entropy.mean() + VALUE * 0.5 * (values - aims[places]).square().mean()
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), NORM)
            optimizer.step()


def as_tensor(array: Any) -> Any:
    """Returns numbers as torch's, in 32 bits."""
    return torch.as_tensor(np.asarray(array), dtype=torch.float32)


def main() -> None:
    """Trains, writes the genome, and scores it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--genome", default="walker", help="a file, or the name of one that ships")
    parser.add_argument("--task", default="walk", help="the name of a task that ships")
    # The task of walking pays only beyond twice the body's reach; how fast it goes is something from the first tick on.
    parser.add_argument("--reward", default="velocity.x", help="an expression of docs/objectives.md")
    parser.add_argument("--steps", type=int, default=1_000_000, help="of all rows together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", type=Path, default=Path("trained.json"))
    options = parser.parse_args()
    if not options.output.absolute().parent.is_dir():  # it would be found out after the training
        parser.error(f"there is no folder {options.output.parent}")

    torch.set_num_threads(1)  # for layers as small as these, others only get in the way
    torch.manual_seed(options.seed)
    envs = gymnasium.make_vec(
        f"nmes/{options.task}-v0",
        num_envs=ROWS,
        genome=options.genome,
        reward=options.reward,
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    creature = Genome.load(options.genome)
    agent = Agent(len(creature.body.sensors), len(creature.body.motors))
    optimizer = torch.optim.Adam(agent.parameters(), RATE, eps=1e-5)
    seen = as_tensor(envs.reset(seed=options.seed)[0])
    rounds = max(1, options.steps // (TICKS * ROWS))
    for number in range(rounds):
        optimizer.param_groups[0]["lr"] = RATE * (1.0 - number / rounds)
        seen, gathered, scores = collect(envs, agent, seen)
        with torch.no_grad():
            last = agent.critic(seen)[:, 0]
        improve(agent, optimizer, gathered, advantages(gathered, last))
        if scores:
            print(f"{(number + 1) * TICKS * ROWS:>10,} steps: {len(scores)} episodes, mean score {np.mean(scores):.3f}")
    envs.close()

    trained = agent.genome(creature)
    options.output.write_text(json.dumps(trained.document))
    print(f"wrote {options.output}, which scores {evaluate(trained, Task.load(options.task)).score}")


if __name__ == "__main__":
    main()
