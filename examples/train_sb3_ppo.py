"""Trains a creature with Stable-Baselines3's PPO, many rows at once, and writes a genome.

pip install 'nmes[gym,rl]'
python examples/train_sb3_ppo.py --genome walker --task walk --steps 1000000 -o trained.json
nmes eval trained.json --task walk
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from nmes.evaluation import Task, evaluate
from nmes.genome import Genome
from nmes.learning.stable_baselines import with_policy
from sb3_rows import Rows

ROWS = 32


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
    rows = Rows(f"nmes/{options.task}-v0", ROWS, options.seed, genome=options.genome, reward=options.reward)
    normalised = VecNormalize(VecMonitor(rows), clip_obs=10.0)
    model = PPO(
        "MlpPolicy",
        normalised,
        n_steps=256,
        batch_size=1024,
        gae_lambda=0.95,
        gamma=0.99,
        seed=options.seed,
        device="cpu",
        policy_kwargs={"log_std_init": -0.7},
        verbose=1,
    )
    model.learn(options.steps)

    with tempfile.TemporaryDirectory() as folder:
        model.save(f"{folder}/model.zip")
        normalised.save(f"{folder}/statistics.pkl")
        trained = with_policy(Genome.load(options.genome), f"{folder}/model.zip", f"{folder}/statistics.pkl")
    options.output.write_text(json.dumps(trained.document))
    print(f"wrote {options.output}, which scores {evaluate(trained, Task.load(options.task)).score}")


if __name__ == "__main__":
    main()
