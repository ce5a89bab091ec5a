"""The shipped agents are what their descriptions say, and strangers' tools take environment and agents unchanged."""

import importlib.util
import json
import re
import subprocess
import sys
import types
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

from benchmarks import cli
from benchmarks.analysis.board import assemble
from benchmarks.policies.spec import resolve
from benchmarks.rl import policy
from benchmarks.rl.policy import SHIPPED, best_seed, curves, describe, shipped, shipped_agent
from benchmarks.rl.settings import Settings
from benchmarks.rl.train import VALIDATION, tracking_error, train
from benchmarks.run.cell import run_cell
from benchmarks.run.suite import Cell
from fbl_gym import Scenario, TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "rl.md").read_text()


def test_what_is_promised_is_shipped():
    factories = {
        name.replace("_", "-") for name, value in vars(policy).items() if getattr(value, "kind", "") == "learned"
    }
    assert set(shipped()) == factories
    for interface in ("torque", "acceleration", "residual"):
        assert shipped()[f"ppo-{interface}"] == (0, 1, 2, 3, 4)
    assert sum(path.stat().st_size for path in SHIPPED.rglob("*")) < 10e6


@pytest.mark.parametrize("name", shipped())
def test_a_shipped_agent_has_the_error_that_it_states(name):
    """On the validation seeds, by which it was chosen; so the physics has not changed under it either.

    Within 2 %: `ppo-memory` follows so closely that other last bits make joints stick elsewhere in 6 of the 16 runs. That
    moved its mean by 1.5 % when the kernel's sine came to be rounded otherwise than in training; other agents moved by 0.4 %.
    """
    found = describe(SHIPPED / name / str(best_seed(name)))
    scenario = Scenario.from_dict(found["scenario"])
    env = TwoLinkArmVectorEnv(len(VALIDATION), scenario)
    error = tracking_error(shipped_agent(name, env), env, VALIDATION).mean()
    assert error == pytest.approx(found["validation_mrad"], rel=0.02)
    assert found["command"].startswith("fbl-gym train")
    assert found["licence"] == "MIT"
    assert {"steps", "wall_s", "packages", "hyperparameters", "seed"} <= set(found)


def test_learning_curves_are_data():
    found = curves("ppo-torque")
    assert set(found) == {0, 1, 2, 3, 4}
    for rows in found.values():
        assert rows.shape[1] == 3
        assert np.all(np.diff(rows[:, 0]) > 0)
        assert rows[-1, 2] < 0.01 * rows[0, 2]
    with pytest.raises(ValueError, match="unknown agent 'ppo-torq'; did you mean 'ppo-torque'"):
        curves("ppo-torq")
    with pytest.raises(ValueError, match="unknown training seed 9"):
        policy.ppo_torque(TwoLinkArmEnv().interface, seed=9)


def test_an_agent_told_the_truth_stands_unranked_on_the_board(tmp_path, capsys):
    """By its name and by its folder, through every command that takes a policy."""
    folder = str(SHIPPED / "ppo-context" / "0")
    told = ("ppo-context", folder)
    cells = [Cell(policy, "everything-2", (0, 1)) for policy in ("cascade-flm", "oracle-flm", *told)]
    board = assemble([run_cell(cell) for cell in cells])
    assert [board.policies[i] for i in board.ranked] == ["cascade-flm"]
    assert board.order[0] == 0
    for name in told:
        assert resolve(name).access == "privileged"
        assert resolve(name).kind == "learned"
        assert cli.main(["check-policy", name]) == 0
        assert "not so: it is told the truth" in capsys.readouterr().out
        assert cli.main(["evaluate", name, "--seeds", "1"]) == 0
    arguments = ["--policies", "oracle-flm", *told, "--scenarios", "everything-2", "--seeds", "2", "--workers", "1"]
    assert cli.main(["leaderboard", *arguments, "--store", str(tmp_path)]) == 0
    capsys.readouterr()
    for name in told:
        assert cli.main(["verify", f"{name}/everything-2", "--store", str(tmp_path)]) == 0
        assert "holds, bit for bit" in capsys.readouterr().out


def test_context_is_asked_for_on_the_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["train", "ppo", "--context", "--steps", "8192"]) == 0
    found = describe(tmp_path / "runs" / "ppo-torque-context-0")
    assert found["interface"]["context"] is True
    told = [name for name in shipped() if describe(SHIPPED / name / "0")["interface"].get("context")]
    assert told == ["ppo-context"]


def test_sb3_evaluates_an_agent_as_it_is():
    env = Monitor(gym.make("fbl_gym/TwoLinkArm-v0", scenario="everything-2", duration=1.0))
    reward, _ = evaluate_policy(policy.ppo_torque(env.unwrapped.interface), env, n_eval_episodes=2)
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


@pytest.mark.skipif(importlib.util.find_spec("tensorboard") is None, reason="needs tensorboard")
def test_tensorboard_gets_the_validation_error(tmp_path):
    train(short(), tmp_path, evaluations=2)
    assert list((tmp_path / "tensorboard").rglob("events.*"))


def test_weights_and_biases_by_option(tmp_path, monkeypatch):
    calls = []
    fake = types.SimpleNamespace(init=lambda **options: calls.append(options), __spec__=None)
    monkeypatch.setitem(sys.modules, "wandb", fake)
    train(short(), tmp_path, evaluations=1, wandb="arms")
    assert calls[0]["project"] == "arms"
    assert calls[0]["config"]["algorithm"] == "ppo"


def short():
    own = {"lanes": 2, "steps": 80, "arguments": {"n_steps": 20, "batch_size": 40, "learning_rate": 1e-3}}
    scenario = scenarios.get("everything-2").replace(duration=0.2)
    return Settings("ppo", scenario=scenario, hyperparameters=own)


def test_the_page_on_learning_is_true(tmp_path, monkeypatch):
    """Its training command in short, then its Python as it stands."""
    (command,) = [line for line in PAGE.splitlines() if line == "fbl-gym train ppo"]
    monkeypatch.chdir(tmp_path)
    assert cli.main([*command.split()[1:], "--steps", "16384"]) == 0
    for block in re.findall(r"```python\n(.*?)```", PAGE, flags=re.S):
        done = subprocess.run([sys.executable, "-c", block], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "trace.png").exists()
    assert json.loads((tmp_path / "runs/ppo-torque-0/agent.json").read_text())["algorithm"] == "ppo"
