"""Tunes the gains of a policy on the tuning seeds, with Optuna, and counts what that cost.

The objective is the mean over scenarios of log(error) + 0.1 log(1 + chatter), where error is the mean error_pct of the seeds, a
diverged run counting as half a turn from then on, and chatter the torque's total variation in full swings of both limits per
second. Logarithms, so that a scenario counts by the share of its error that is saved, not by its size.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna

import controllers
from benchmarks.metrics import measure, summarize
from benchmarks.rollout import rollout
from benchmarks.store import provenance, write_text
from benchmarks.suite import SPLITS
from controllers.policy import TUNED
from fbl_gym import Scenario, scenarios

CHATTER = 0.1
"""Weight of the torque's chatter in the objective."""

SCENARIOS = (
    "nominal", "mixed-error-2", "smaller-error-2", "payload-2", "noise-2", "stiction-2", "disturbance-2", "everything-2",
    "section-2-2/everything-2",
)  # fmt: skip
"""What gains are tuned on."""


@dataclass(frozen=True)
class Task:
    """What is tuned, and on what.

    Args:
        policy: its name.
        names: of the scenarios.
        seeds: how many of the tuning seeds.
    """

    policy: str
    names: tuple[str, ...] = SCENARIOS
    seeds: int = 16

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Between which values each gain is looked for."""
        found: Mapping[str, tuple[float, float]] = getattr(controllers.factory(self.policy), "ranges", {})
        if not found:
            raise ValueError(f"{self.policy} has nothing to tune: its `ranges` names no gain")
        return found

    @property
    def tasks(self) -> list[Scenario]:
        return [scenarios.get(name) for name in self.names]

    @property
    def steps(self) -> int:
        """Environment steps of one trial."""
        return sum(task.steps for task in self.tasks) * self.seeds

    def cost(self, gains: Mapping[str, float]) -> float:
        """The objective; lower is better.  gains: by name; those left out take their defaults."""
        seeds = SPLITS["tuning"][: self.seeds]
        found = []
        for task in self.tasks:
            mean = summarize(measure(rollout(self.policy, task, seeds, gains)))
            limit = task.actuator.torque_limit
            assert limit is not None
            found.append(np.log(mean["error_pct"]) + CHATTER * np.log1p(mean["variation"] / np.sum(limit)))
        return float(np.mean(found))


def tune(task: Task, trials: int, storage: Path, sampler_seed: int = 0) -> optuna.Study:
    """Go on with a study until it has so many finished trials. Several processes may share the storage.

    Args:
        task: what to tune.
        trials: in all, those of earlier runs counted.
        storage: file of the study.
        sampler_seed: of the sampler.
    """
    storage.parent.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    ranges = task.ranges
    study = optuna.create_study(
        study_name=task.policy, storage=f"sqlite:///{storage}", load_if_exists=True,
        sampler=optuna.samplers.TPESampler(seed=sampler_seed),
    )  # fmt: skip

    def objective(trial: optuna.Trial) -> float:
        begin = time.process_time()
        # The first trial is that of the gains as they are.
        gains = {} if trial.number == 0 else {n: trial.suggest_float(n, *ends, log=True) for n, ends in ranges.items()}
        try:
            return task.cost(gains)
        finally:
            trial.set_user_attr("cpu_s", time.process_time() - begin)

    while (left := trials - len(finished(study))) > 0:
        study.optimize(objective, n_trials=min(left, 1))
    return study


def finished(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    """The trials that ended with a number.  study: of `tune`."""
    return study.get_trials(states=(optuna.trial.TrialState.COMPLETE,))


def summary(task: Task, study: optuna.Study, command: str) -> dict[str, Any]:
    """What is shipped of a study: the gains, what they are worth, and what they cost.

    Args:
        task: what was tuned.
        study: of `tune`.
        command: the line that was typed, for the record.
    """
    done = finished(study)
    best = min(done, key=lambda trial: trial.value or 0.0)
    return {
        "policy": task.policy,
        "gains": {name: float(f"{value:.4g}") for name, value in best.params.items()},
        "objective": best.value,
        "objective_of_defaults": next(t.value for t in done if t.number == 0),
        "trials": len(done),
        "environment_steps": task.steps * len(done),
        "cpu_s": round(sum(t.user_attrs.get("cpu_s", 0.0) for t in done), 1),
        "scenarios": list(task.names),
        "seeds": [SPLITS["tuning"].start, SPLITS["tuning"].start + task.seeds],
        "ranges": {name: list(ends) for name, ends in task.ranges.items()},
        **provenance(command),
    }


def ship(found: dict[str, Any], folder: Path = TUNED) -> Path:
    """Write a summary where `controllers` finds it, as POLICY@tuned.  found: of `summary`; folder: of all tuned gains."""
    path = folder / f"{found['policy']}.json"
    write_text(path, json.dumps(found, indent=1) + "\n")
    return path
