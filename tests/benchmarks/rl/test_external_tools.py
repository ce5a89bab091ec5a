"""Tools of stable-baselines3 take the environment and the agents."""

import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

from benchmarks.rl.policy import ppo_torque

ROOT = Path(__file__).parents[3]


def test_sb3_evaluates_an_agent():
    env = Monitor(gym.make("fbl_gym/TwoLinkArm-v0", scenario="everything-2", duration=1.0))
    reward, _ = evaluate_policy(ppo_torque(env.unwrapped.interface), env, n_eval_episodes=2)
    assert 80.0 < reward <= 100.0


def test_sb3_learns_on_the_registered_environment():
    model = PPO("MlpPolicy", gym.make("fbl_gym/TwoLinkArm-v0"), n_steps=64, batch_size=64, device="cpu")
    assert model.learn(64).num_timesteps == 64


def test_rl_zoo3_trains_with_the_shipped_hyperparameters(tmp_path):
    pytest.importorskip("rl_zoo3")
    command = "-m rl_zoo3.train --algo ppo --env fbl_gym/TwoLinkArm-v0 --gym-packages fbl_gym --conf-file"
    options = [str(ROOT / "benchmarks" / "rl" / "rl_zoo3.yml"), *["--eval-freq", "-1", "-n", "4096", "--device", "cpu"]]
    done = subprocess.run([sys.executable, *command.split(), *options], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.rglob("*.zip"))
