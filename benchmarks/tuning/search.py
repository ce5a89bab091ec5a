"""Tunes the gains of a policy on the tuning seeds, with Optuna, and counts what that cost.

The objective is the mean over scenarios of log(error) + 0.1 log(1 + chatter), where error is the mean error_pct of the seeds, a
diverged run counting as half a turn from then on, and chatter the torque's total variation in full swings of both limits per
second. Logarithms, so that a scenario counts by the share of its error that is saved, not by its size.

Trials look for gains on few scenarios and seeds, and do not see a failure in some hundred runs. So the best of them, and the
defaults, are judged once more: on more scenarios, those of severity 3 among them, and on tuning seeds that no trial saw. There
each percent of diverged runs adds to the objective, whose logarithms hardly count failures that share a scenario. What is best
then is shipped.
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

from benchmarks.policies import resolve
from benchmarks.run.metrics import measure, summarize
from benchmarks.run.rollout import rollout
from benchmarks.run.store import provenance, write_text
from benchmarks.run.suite import SPLITS, leaderboard_scenarios
from controllers.registry import TUNED
from fbl_gym import Scenario, scenarios
from fbl_gym.checks import check_number, unknown
from fbl_gym.records import tuning_ranges

CHATTER = 0.1
"""Weight of the torque's chatter in the objective."""

FAILURE = 1.0
"""Weight of each percent of diverged runs where trials are judged: as much as an error e times as large."""

SCENARIOS = (
    "nominal", "mixed-error-2", "smaller-error-2", "payload-2", "noise-2", "stiction-2", "disturbance-2", "everything-2",
    "section-2-2/everything-2",
)  # fmt: skip
"""What gains are looked for on."""

JUDGED = (
    *leaderboard_scenarios(["table-1"], [2, 3]), "section-2-2/everything-2", "section-2-2/everything-3",
)  # fmt: skip
"""What the best trials and the defaults are judged on."""


@dataclass(frozen=True)
class Task:
    """What is tuned, and on what.

    Args:
        policy: a name, or what else `resolve.make` understands.
        names: of the scenarios.
        seeds: of each scenario.
    """

    policy: str
    names: tuple[str, ...]
    seeds: range

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Between which values each gain is looked for."""
        factory = resolve.factory(self.policy)
        found = tuning_ranges(factory) if isinstance(factory, type) else {}
        if not found:
            raise ValueError(f"{self.policy} has nothing to tune: none of its gains is declared with a range `tune`")
        return found

    @property
    def tasks(self) -> list[Scenario]:
        return [scenarios.get(name) for name in self.names]

    @property
    def steps(self) -> int:
        """Environment steps of one set of gains."""
        return sum(task.steps for task in self.tasks) * len(self.seeds)

    @property
    def described(self) -> dict[str, Any]:
        """Scenarios and seeds as plain data, for the record."""
        return {"scenarios": list(self.names), "seeds": [self.seeds.start, self.seeds.stop]}

    def cost(self, gains: Mapping[str, float]) -> tuple[float, float]:
        """The objective, lower is better, and the diverged runs [%].  gains: by name; those left out take their defaults."""
        found, diverged = [], []
        for task in self.tasks:
            mean = summarize(measure(rollout(self.policy, task, self.seeds, gains)))
            limit = task.actuator.torque_limit
            assert limit is not None
            found.append(np.log(mean["error_pct"]) + CHATTER * np.log1p(mean["variation"] / np.sum(limit)))
            diverged.append(mean["diverged"])
        return float(np.mean(found)), 100 * float(np.mean(diverged))


def seeds(trial: int, fresh: int) -> tuple[range, range]:
    """Tuning seeds for the trials, from the split's start, and others to judge on, from its end.

    Args:
        trial: how many for the trials.
        fresh: how many to judge on.
    """
    every = SPLITS["tuning"]
    if trial + fresh > len(every):
        raise ValueError(
            f"there are {len(every)} tuning seeds, for trials and judging together, got {trial} and {fresh}"
        )
    return every[:trial], every[-fresh:]


def tune(
    task: Task, trials: int, storage: Path, also: Mapping[str, float] | None = None, sampler_seed: int = 0
) -> optuna.Study:
    """Go on with a study until it has so many finished trials. Several processes may share the storage.

    Args:
        task: what to tune.
        trials: in all, those of earlier runs counted.
        storage: file of the study.
        also: gains to try as one of them, such as those of an earlier study.
        sampler_seed: of the sampler.
    """
    ranges = task.ranges
    for name, value in (also or {}).items():
        if name not in ranges:
            raise unknown(f"gain of {task.policy}", name, ranges)
        low, high = ranges[name]
        check_number(name, value, low=low, high=high)
    storage.parent.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(
        study_name=task.policy, storage=f"sqlite:///{storage}", load_if_exists=True,
        sampler=optuna.samplers.TPESampler(seed=sampler_seed),
    )  # fmt: skip

    def objective(trial: optuna.Trial) -> float:
        begin = time.process_time()
        # The first trial is that of the gains as they are.
        gains = {} if trial.number == 0 else {n: trial.suggest_float(n, *ends, log=True) for n, ends in ranges.items()}
        try:
            return task.cost(gains)[0]
        finally:
            trial.set_user_attr("cpu_s", time.process_time() - begin)

    while (left := trials - len(finished(study))) > 0:
        if also and study.trials:
            study.enqueue_trial(dict(also), skip_if_exists=True)
        study.optimize(objective, n_trials=min(left, 1))
    return study


def finished(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    """The trials that ended with a number.  study: of `tune`."""
    return study.get_trials(states=(optuna.trial.TrialState.COMPLETE,))


def judge(task: Task, study: optuna.Study, candidates: int) -> list[dict[str, Any]]:
    """The best trials and the defaults (trial 0), judged on a task that no trial saw; best first.

    Each verdict is written into the study, and read from there the next time.

    Args:
        task: what to judge on.
        study: of `tune`.
        candidates: how many of the trials.
    """
    trials = sorted((t for t in finished(study) if t.params), key=lambda trial: trial.value or 0.0)[:candidates]
    # Gains are judged as they are shipped, with four digits.
    gains = {t.number: {name: float(f"{value:.4g}") for name, value in t.params.items()} for t in trials}
    verdicts = []
    for trial, values in {0: dict[str, float](), **gains}.items():
        verdict = study.user_attrs.get(f"judged {trial}")
        if verdict is None or verdict["on"] != task.described:
            begin = time.process_time()
            cost, diverged = task.cost(values)
            verdict = {
                "trial": trial,
                "gains": values,
                "objective": cost,
                "diverged_pct": diverged,
                "cpu_s": time.process_time() - begin,
                "on": task.described,
            }
            study.set_user_attr(f"judged {trial}", verdict)
        verdicts.append(verdict)
    return sorted(verdicts, key=lambda verdict: verdict["objective"] + FAILURE * verdict["diverged_pct"])


def summary(
    task: Task, study: optuna.Study, judging: Task, verdicts: list[dict[str, Any]], command: str
) -> dict[str, Any]:
    """What is shipped of a study: the gains judged best, what they are worth, and what they cost.

    Args:
        task: what was tuned.
        study: of `tune`.
        judging: what was judged on.
        verdicts: of `judge`.
        command: the line that was typed, for the record.
    """
    done = finished(study)
    shown = ("trial", "objective", "diverged_pct")
    return {
        "policy": task.policy,
        "gains": verdicts[0]["gains"],
        "trials": {
            "count": len(done),
            "environment_steps": task.steps * len(done),
            "cpu_s": round(sum(t.user_attrs.get("cpu_s", 0.0) for t in done), 1),
            **task.described,
        },
        "judged": {
            "best_first": [{name: verdict[name] for name in shown} for verdict in verdicts],
            "environment_steps": judging.steps * len(verdicts),
            "cpu_s": round(sum(verdict["cpu_s"] for verdict in verdicts), 1),
            **judging.described,
        },
        "ranges": {name: list(ends) for name, ends in task.ranges.items()},
        **provenance(command),
    }


def ship(found: dict[str, Any], folder: Path = TUNED) -> Path:
    """Write the gains of a summary, and how they were found, where `controllers` reads them as POLICY@tuned.

    Of the judged trials, the file has the number and the errors of the best and of the defaults.

    Args:
        found: the return value of `summary`.
        folder: of all tuned gains.
    """
    verdicts = found["judged"]["best_first"]
    (defaults,) = (verdict for verdict in verdicts if verdict["trial"] == 0)
    judged = {"count": len(verdicts), "best": verdicts[0], "defaults": defaults, **found["judged"]}
    del judged["best_first"]
    entries = {**found, "judged": judged}
    lines = ",\n".join(f" {json.dumps(key)}: {json.dumps(value)}" for key, value in entries.items())
    path = folder / f"{found['policy']}.json"
    write_text(path, f"{{\n{lines}\n}}\n")
    return path
