"""Tools of stable-baselines3 take the environment and the agents."""

import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import controllers
from benchmarks.rl.sb3 import load_zip
from fbl_gym import TwoLinkArmEnv

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("name", ["ppo-torque", "cascade-flm"])
def test_sb3_evaluates_a_policy(name):
    env = Monitor(gym.make("fbl_gym/TwoLinkArm-v0", scenario="everything-2", duration=1.0))
    reward, _ = evaluate_policy(controllers.make(name, env), env, n_eval_episodes=2)
    assert 50.0 < reward <= 100.0


@pytest.mark.slow
def test_rl_zoo3_trains_with_the_shipped_file_and_its_archive_is_a_policy(tmp_path):
    pytest.importorskip("rl_zoo3")
    command = "-m rl_zoo3.train --algo ppo --env fbl_gym/TwoLinkArmTracking-v0 --gym-packages fbl_gym --conf-file"
    options = [str(ROOT / "benchmarks" / "rl" / "rl_zoo3.yml"), *["--eval-freq", "-1", "-n", "2048", "--device", "cpu"]]
    done = subprocess.run([sys.executable, *command.split(), *options], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (archive,) = tmp_path.rglob("*.zip")
    env = TwoLinkArmEnv("servo-nominal")
    action, _ = load_zip(archive, env.interface, trust=True).predict(env.reset(seed=0)[0])
    assert env.action_space.contains(action)
