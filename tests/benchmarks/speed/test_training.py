"""PPO's time to an error, on each kind of environment."""

import math

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from benchmarks.rl.training_settings import shipped_hyperparameters
from benchmarks.speed import training


def test_each_environment_is_trained_until_an_error_or_for_a_number_of_updates(monkeypatch):
    shipped = shipped_hyperparameters("ppo")
    arguments = {**shipped["arguments"], "n_steps": 8, "batch_size": 16}
    short = lambda _: {"lanes": 2, "arguments": dict(arguments)}
    monkeypatch.setattr(training, "shipped_hyperparameters", short)
    monkeypatch.setattr(training, "tracking_error", lambda *_: np.array([99.0, 33.0]))
    for make in training.ways(2).values():
        measured = training.measure_training(make(), 0, updates=4)
        assert {name for name in measured if " to " in name} == {
            f"{name} to 100 mrad" for name in ("steps", "CPU s", "wall s")
        }
        assert measured["steps to 100 mrad"] == 32
        assert math.isclose(sum(measured[f"{part} %"] for part in ("step", "decisions", "update")), 100)
