"""The settings of a training run, as plain data; imports neither torch nor stable-baselines3."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.rl.adapter import AdapterSettings
from benchmarks.rl.sb3 import ALGORITHMS
from fbl_gym import scenarios
from fbl_gym.records import Record, choice, number, set_fields, whole
from fbl_gym.scenarios import Scenario
from fbl_gym.uncertainty import ParameterError


@dataclass(frozen=True)
class TrainingSettings(Record):
    """The settings of a training run. Two runs with equal settings learn the same.

    Args:
        algorithm: one of `benchmarks.rl.sb3.ALGORITHMS`.
        adapter: observations and actions of the agent.
        scenario: for training, and for validation with other seeds.
        seed: of the training.
        steps: of all lanes together; None: those of the hyperparameters, if `minutes` is None too.
        minutes: wall time; such a run does not repeat exactly. None: the run ends after `steps`.
        hyperparameters: `lanes`, `steps` and `arguments` of SB3's class; empty: the shipped ones.
    """

    algorithm: str = choice(dataclasses.MISSING, ALGORITHMS)
    adapter: AdapterSettings = field(default_factory=AdapterSettings)
    scenario: Scenario = field(default_factory=lambda: scenarios.get("everything-2"))
    seed: int = whole(0)
    steps: int | None = whole(None, low=1)
    minutes: float | None = number(None, unit="min", above=0)
    hyperparameters: dict[str, Any] = field(default_factory=dict)

    def validate(self) -> None:
        """Fill in the shipped hyperparameters and the number of steps."""
        if not self.hyperparameters:
            set_fields(self, hyperparameters=shipped_hyperparameters(self.algorithm))
        if self.minutes is None and self.steps is None:
            set_fields(self, steps=self.hyperparameters["steps"])


def shipped_hyperparameters(algorithm: str) -> dict[str, Any]:
    """Return the hyperparameters of an algorithm from `hyperparameters.json`."""
    return json.loads(Path(__file__).with_name("hyperparameters.json").read_text())[algorithm]


def at_radius(scenario: Scenario, radius: float) -> Scenario:
    """Return the scenario with another radius of the parameter error; unchanged if it is equal."""
    before = scenario.parameter_error or ParameterError()
    error = dataclasses.replace(before, radius=radius)
    if error == before:
        return scenario
    return scenario.replace(parameter_error=error, name=f"{scenario.name}, radius {radius:g}")
