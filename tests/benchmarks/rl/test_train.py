"""Training runs of a few hundred steps."""

import csv
import importlib.util
import json
import sys
import types

import numpy as np
import pytest

from benchmarks.rl.adapter import AdapterSettings
from benchmarks.rl.agent import describe, read, saved_agent
from benchmarks.rl.progress import Progress
from benchmarks.rl.sb3 import ALGORITHMS
from benchmarks.rl.train import train
from benchmarks.rl.training_settings import LEAST_LANES, TrainingSettings, shipped_hyperparameters
from benchmarks.rl.validation import VALIDATION, tracking_error, validate
from benchmarks.seeds import SPLITS
from fbl_gym import TwoLinkArmVectorEnv, scenarios

SCENARIO = scenarios.get("everything-2").replace(duration=0.2)
PPO = {"lanes": 4, "steps": 640, "arguments": {"n_steps": 20, "batch_size": 40, "learning_rate": 1e-3}}
OFF_POLICY = {"lanes": 4, "steps": 200, "arguments": {"learning_starts": 20, "buffer_size": 300, "learning_rate": 1e-3}}


def settings(algorithm="ppo", **changes):
    hyperparameters = PPO if algorithm == "ppo" else OFF_POLICY
    options = {"algorithm": algorithm, "scenarios": (SCENARIO,), "hyperparameters": hyperparameters, **changes}
    return TrainingSettings(**options)


def curve(folder):
    with (folder / "curve.csv").open() as file:
        return [(int(row["steps"]), float(row["validation_mrad"])) for row in csv.DictReader(file)]


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_algorithm_writes_the_agent_that_it_validated(algorithm, tmp_path):
    if ALGORITHMS[algorithm].startswith("sb3_contrib"):
        pytest.importorskip("sb3_contrib")
    train(settings(algorithm), tmp_path, command="fbl-gym train", evaluations=2)
    description, points = describe(tmp_path), curve(tmp_path)
    assert description["command"] == "fbl-gym train"
    assert description["packages"]["stable-baselines3"]
    assert description["scenario"] == SCENARIO.to_dict()
    assert points[-1][0] == settings(algorithm).steps
    assert description["validation_mrad"] == min(error for _, error in points)
    env = TwoLinkArmVectorEnv(len(VALIDATION), SCENARIO)
    error = tracking_error(saved_agent(env.interface, str(tmp_path)), env, VALIDATION).mean()
    assert error == pytest.approx(description["validation_mrad"], abs=2e-4)


def test_an_agent_trains_on_several_scenarios_side_by_side(tmp_path):
    each = tuple(scenarios.get(name).replace(duration=0.2) for name in ("practice-nominal", "practice-delay-3"))
    adapter = AdapterSettings("residual", history=2, drive=True, sensors=("position", "velocity"))
    train(settings(scenarios=each, adapter=adapter), tmp_path, evaluations=2)
    assert describe(tmp_path)["scenarios"] == ["practice-nominal", "practice-delay-3"]
    error = validate(lambda env: saved_agent(env, str(tmp_path)), each)
    assert error == pytest.approx(describe(tmp_path)["validation_mrad"], abs=2e-4)


def test_a_scenario_of_the_board_is_refused():
    with pytest.raises(ValueError, match=r"scenario must be one that agents may train on.*hardware-lag-2"):
        settings(scenarios=(scenarios.get("hardware-lag-2"),))


def test_several_scenarios_have_enough_lanes_each():
    each = tuple(map(scenarios.get, scenarios.in_tier("practice", (3,))))
    assert TrainingSettings("ppo", scenarios=each).lanes == LEAST_LANES
    assert TrainingSettings("ppo").lanes == 64


def test_a_run_repeats_and_its_seed_matters(tmp_path):
    weights = []
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        train(settings(seed=seed), tmp_path / name, evaluations=3)
        weights.append(read(tmp_path / name)[1].layers[0][0])
    np.testing.assert_array_equal(weights[0], weights[1])
    assert curve(tmp_path / "a") == curve(tmp_path / "b")
    assert np.any(weights[0] != weights[2])


@pytest.mark.parametrize("algorithm", ["ppo", "td3"])
def test_a_killed_run_resumes(algorithm, tmp_path, monkeypatch):
    """The run is killed at its third validation and resumes from the checkpoint of the second."""
    validate = Progress._validate

    def fail_at_the_third(self, *arguments):
        if len(self.curve) == 2:
            raise KeyboardInterrupt
        validate(self, *arguments)

    monkeypatch.setattr(Progress, "_validate", fail_at_the_third)
    with pytest.raises(KeyboardInterrupt):
        train(settings(algorithm), tmp_path, evaluations=4)
    monkeypatch.setattr(Progress, "_validate", validate)
    before = curve(tmp_path)
    train(settings(algorithm), tmp_path, evaluations=4)
    after = curve(tmp_path)
    assert after[: len(before)] == before
    assert after[-1][0] == settings(algorithm).steps
    steps = [n for n, _ in after]
    assert steps == sorted(set(steps))
    train(settings(algorithm), tmp_path, evaluations=4)  # a finished run stays
    assert curve(tmp_path) == after


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_a_finished_run_is_extended(algorithm, tmp_path, capsys):
    short = settings(algorithm)
    train(short, tmp_path, evaluations=2)
    before = curve(tmp_path)
    train(short, tmp_path, evaluations=2)
    assert f"the run has {short.steps:,} steps already" in capsys.readouterr().err
    train(settings(algorithm, steps=2 * short.steps), tmp_path, evaluations=2)
    after = curve(tmp_path)
    assert after[: len(before)] == before
    assert after[-1][0] == 2 * short.steps


def test_a_folder_with_other_settings_is_refused(tmp_path):
    train(settings(), tmp_path, evaluations=1)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(ValueError, match="folder must be new or hold a run of the same settings"):
        train(settings(), tmp_path)
    (tmp_path / "run.json").unlink()
    train(settings(), tmp_path)
    with pytest.raises(ValueError, match="folder must be new or hold a run of the same settings"):
        train(settings(seed=1), tmp_path)


def test_a_folder_is_refused_while_another_run_works_in_it(tmp_path, monkeypatch):
    pytest.importorskip("fcntl")
    validate = Progress._validate

    def train_again(*_):
        monkeypatch.setattr(Progress, "_validate", validate)
        train(settings(), tmp_path, evaluations=1)

    monkeypatch.setattr(Progress, "_validate", train_again)
    with pytest.raises(ValueError, match="folder must be one that no other run works in"):
        train(settings(), tmp_path, evaluations=1)
    train(settings(), tmp_path, evaluations=1)  # the failed run has released it
    assert curve(tmp_path)[-1][0] == settings().steps


def test_a_run_with_a_wall_time_ends(tmp_path):
    train(settings(minutes=0.01), tmp_path, evaluations=2)
    assert describe(tmp_path)["wall_s"] < 60


def test_the_splits_of_seeds_do_not_overlap():
    assert set(VALIDATION) < set(SPLITS["validation"])
    splits = list(SPLITS.values())
    for i, one in enumerate(splits):
        for other in splits[i + 1 :]:
            assert one.stop <= other.start or other.stop <= one.start


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_shipped_hyperparameters_state_their_tuning(algorithm):
    hyperparameters = shipped_hyperparameters(algorithm)
    assert set(hyperparameters) == {"tuned", "lanes", "steps", "arguments"}
    assert len(hyperparameters["tuned"]) > 20


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"algorithm": "ppp"}, "unknown algorithm 'ppp'; did you mean 'ppo'"),
        ({"seed": -1}, "seed must be a whole number not below 0, got -1"),
        ({"steps": 0}, "steps must be a whole number not below 1, got 0"),
        ({"minutes": 0}, "minutes must be a finite number greater than 0, got 0"),
    ],
)
def test_wrong_settings_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        settings(**changes)


def test_settings_without_a_length_take_the_steps_of_the_hyperparameters():
    assert settings().steps == PPO["steps"]
    assert settings(minutes=1.0).steps is None
    assert TrainingSettings("ppo").steps == shipped_hyperparameters("ppo")["steps"]


@pytest.mark.skipif(importlib.util.find_spec("tensorboard") is None, reason="needs tensorboard")
def test_tensorboard_gets_logs(tmp_path):
    train(settings(), tmp_path, evaluations=1)
    assert list((tmp_path / "tensorboard").rglob("events.*"))


def test_a_training_without_tensorboard_leaves_no_logs_elsewhere(tmp_path, monkeypatch):
    monkeypatch.setenv("SB3_LOGDIR", str(tmp_path / "logs"))
    monkeypatch.setattr("benchmarks.rl.train.util", types.SimpleNamespace(find_spec=lambda name: None))
    train(settings(), tmp_path / "run", evaluations=1)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_weights_and_biases_gets_the_settings(tmp_path, monkeypatch):
    calls = []
    fake = types.SimpleNamespace(init=lambda **options: calls.append(options), __spec__=None)
    monkeypatch.setitem(sys.modules, "wandb", fake)
    train(settings(), tmp_path, evaluations=1, wandb="arms")
    assert calls[0]["project"] == "arms"
    assert calls[0]["config"] == json.loads((tmp_path / "run.json").read_text())
