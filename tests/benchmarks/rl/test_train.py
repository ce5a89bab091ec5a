"""Training in a few hundred steps: what it writes, that it repeats, and that it goes on after a kill."""

import csv
import json

import numpy as np
import pytest

from benchmarks import cli
from benchmarks.rl import train as training
from benchmarks.rl.policy import ALGORITHMS, SavedAgent, describe, read
from benchmarks.rl.settings import Settings, shipped_hyperparameters
from benchmarks.rl.train import SPLITS, tracking_error, train
from fbl_gym import TwoLinkArmVectorEnv, scenarios

SHORT = scenarios.get("everything-2").replace(duration=0.2)
PPO = {"lanes": 4, "steps": 640, "arguments": {"n_steps": 20, "batch_size": 40, "learning_rate": 1e-3}}
OFF_POLICY = {"lanes": 4, "steps": 200, "arguments": {"learning_starts": 20, "buffer_size": 300, "learning_rate": 1e-3}}


def settings(algorithm="ppo", **changes):
    own = PPO if algorithm == "ppo" else OFF_POLICY
    return Settings(**{"algorithm": algorithm, "scenario": SHORT, "hyperparameters": own, **changes})


def curve(folder):
    with (folder / "curve.csv").open() as file:
        return [(int(row["steps"]), float(row["validation_mrad"])) for row in csv.DictReader(file)]


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_algorithm_leaves_an_agent(algorithm, tmp_path):
    if ALGORITHMS[algorithm].startswith("sb3_contrib"):
        pytest.importorskip("sb3_contrib")
    train(settings(algorithm), tmp_path, command="fbl-gym train", evaluations=2)
    description, points = describe(tmp_path), curve(tmp_path)
    assert description["command"] == "fbl-gym train"
    assert description["packages"]["stable-baselines3"]
    assert description["scenario"] == SHORT.to_dict()
    assert points[-1][0] == settings(algorithm).steps
    assert description["validation_mrad"] == min(error for _, error in points)
    # What was validated is what was saved.
    env = TwoLinkArmVectorEnv(len(training.VALIDATION), SHORT)
    error = tracking_error(SavedAgent(env.interface, str(tmp_path)), env, training.VALIDATION).mean()
    assert error == pytest.approx(description["validation_mrad"], abs=2e-4)


def test_a_run_repeats_and_its_seed_matters(tmp_path):
    weights = []
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        train(settings(seed=seed), tmp_path / name, evaluations=3)
        weights.append(read(tmp_path / name)[1].layers[0][0])
    np.testing.assert_array_equal(weights[0], weights[1])
    assert curve(tmp_path / "a") == curve(tmp_path / "b")
    assert np.any(weights[0] != weights[2])


@pytest.mark.parametrize("algorithm", ["ppo", "td3"])
def test_a_killed_run_goes_on(algorithm, tmp_path, monkeypatch):
    """Killed while it writes its third validation; the same command finishes it from the checkpoint of the second."""
    validate = training.Progress._validate

    def dies(self, done):
        if len(self.curve) == 2:
            raise KeyboardInterrupt
        validate(self, done)

    monkeypatch.setattr(training.Progress, "_validate", dies)
    with pytest.raises(KeyboardInterrupt):
        train(settings(algorithm), tmp_path, evaluations=4)
    monkeypatch.setattr(training.Progress, "_validate", validate)
    before = curve(tmp_path)
    train(settings(algorithm), tmp_path, evaluations=4)
    after = curve(tmp_path)
    assert after[: len(before)] == before
    assert after[-1][0] == settings(algorithm).steps
    steps = [n for n, _ in after]
    assert steps == sorted(set(steps))
    # Once more does nothing.
    train(settings(algorithm), tmp_path, evaluations=4)
    assert curve(tmp_path) == after


def test_other_settings_in_the_same_folder_are_refused(tmp_path):
    train(settings(), tmp_path, evaluations=1)
    with pytest.raises(ValueError, match="another run"):
        train(settings(seed=1), tmp_path)


def test_a_folder_that_another_run_works_in_is_refused(tmp_path, monkeypatch):
    """And is free again when that run has ended, even by an error."""
    pytest.importorskip("fcntl")
    validate = training.Progress._validate

    def second(*_):
        monkeypatch.setattr(training.Progress, "_validate", validate)
        train(settings(), tmp_path, evaluations=1)

    monkeypatch.setattr(training.Progress, "_validate", second)
    with pytest.raises(ValueError, match="folder must be one that no other run works in"):
        train(settings(), tmp_path, evaluations=1)
    train(settings(), tmp_path, evaluations=1)
    assert curve(tmp_path)[-1][0] == settings().steps


def test_a_run_by_the_clock_ends(tmp_path):
    train(settings(minutes=0.01), tmp_path, evaluations=2)
    assert describe(tmp_path)["wall_s"] < 60


def test_no_training_episode_is_validated_or_tested_on():
    assert set(training.VALIDATION) < set(SPLITS["validation"])
    splits = list(SPLITS.values())
    for i, a in enumerate(splits):
        for b in splits[i + 1 :]:
            assert a.stop <= b.start or b.stop <= a.start


def test_hyperparameters_say_what_they_were_tuned_with():
    for algorithm in ALGORITHMS:
        own = shipped_hyperparameters(algorithm)
        assert set(own) == {"tuned", "lanes", "steps", "arguments"}
        assert len(own["tuned"]) > 20


def test_the_command(tmp_path, monkeypatch, capsys):
    """As typed, but with hyper-parameters that make it short."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.json").write_text(json.dumps({"ppo": PPO}))
    command = [
        "train",
        "ppo",
        "--interface",
        "residual",
        "--history",
        "1",
        "--scenario",
        "mixed-error-1",
        "--radius",
        "0.1",
    ]
    assert cli.main([*command, "--steps", "80", "--hyperparameters", "own.json"]) == 0
    shown = capsys.readouterr()
    assert "agent: runs/ppo-residual-history-1-0" in shown.out
    assert "left" in shown.err
    description = describe(tmp_path / "runs" / "ppo-residual-history-1-0")
    assert description["interface"]["history"] == 1
    assert description["scenario"]["parameter_error"]["radius"] == 0.1
    assert cli.main(["train", "ppo", "--scenario", "mixed-eror-1"]) == 2
    assert "did you mean 'mixed-error" in capsys.readouterr().err
