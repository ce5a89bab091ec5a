"""Tuning of a policy's gains on the tuning seeds, with Optuna; it counts the cost.

The objective is the mean over scenarios of log(error) + 0.1 log(1 + chatter). Error is the mean
error_pct of the seeds; a diverged run counts as half a turn from then on. Chatter is the torque's
total variation in full swings of both limits per second. Because of the logarithms, a scenario
counts by the relative change of its error.

Trials use few scenarios and seeds, so they miss a divergence in some hundred runs. The best trials
and the defaults are therefore judged on more scenarios, those of severity 3 among them, and on
tuning seeds that no trial used. There each percent of diverged runs adds to the objective, since
the logarithms hardly count a few of them. The gains that are judged best are shipped.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import sqlalchemy

from benchmarks.files import write_text
from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.run.metrics import measure, summarize
from benchmarks.run.rollout import rollout
from benchmarks.run.store import provenance
from benchmarks.run.suite import leaderboard_scenarios
from benchmarks.seeds import SPLITS
from controllers.registry import TUNED
from fbl_gym import Scenario, scenarios
from fbl_gym.checks import check_number, unknown
from fbl_gym.records import set_fields, tuning_ranges

CHATTER = 0.1
"""Weight of the torque's chatter in the objective."""

DIVERGENCE_COST = 1.0
"""Weight of each percent of diverged runs in judging: as much as an error e times as large."""

SCENARIOS = (
    "nominal", "mixed-error-2", "smaller-error-2", "payload-2", "noise-2", "stiction-2", "disturbance-2", "everything-2",
    "section-2-2/everything-2",
)  # fmt: skip
"""The scenarios of the trials."""

JUDGED = (
    *leaderboard_scenarios(["table-1"], [2, 3]), "section-2-2/everything-2", "section-2-2/everything-3",
)  # fmt: skip
"""The scenarios that the best trials and the defaults are judged on."""


@dataclass(frozen=True)
class Task:
    """A policy to tune, with the names of scenarios and the seeds of each."""

    policy: PolicySpec
    names: tuple[str, ...]
    seeds: range

    def __post_init__(self) -> None:
        set_fields(self, policy=resolve(self.policy))

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Least and largest value of each gain."""
        factory = self.policy.factory()
        ranges = tuning_ranges(factory) if isinstance(factory, type) else {}
        if not ranges:
            raise ValueError(
                f"{self.policy.name} has nothing to tune: none of its gains is declared with a range `tune`"
            )
        return ranges

    @property
    def tasks(self) -> list[Scenario]:
        """The scenarios."""
        return [scenarios.get(name) for name in self.names]

    @property
    def steps(self) -> int:
        """Environment steps of one set of gains."""
        return sum(task.steps for task in self.tasks) * len(self.seeds)

    @property
    def described(self) -> dict[str, Any]:
        """Scenarios and seeds as plain data."""
        return {"scenarios": list(self.names), "seeds": [self.seeds.start, self.seeds.stop]}

    def cost(self, gains: Mapping[str, float]) -> tuple[float, float]:
        """Return the objective of gains (lower is better) and the share of diverged runs [%]."""
        costs, diverged = [], []
        for task in self.tasks:
            mean = summarize(measure(rollout(self.policy, task, self.seeds, gains)))
            limit = task.actuator.torque_limit
            assert limit is not None
            costs.append(np.log(mean["error_pct"]) + CHATTER * np.log1p(mean["variation"] / np.sum(limit)))
            diverged.append(mean["diverged"])
        return float(np.mean(costs)), 100 * float(np.mean(diverged))


def seeds(trial: int, fresh: int) -> tuple[range, range]:
    """Return numbers of tuning seeds: for the trials, and fresh ones to judge on."""
    every = SPLITS["tuning"]
    if trial + fresh > len(every):
        raise ValueError(
            f"there are {len(every)} tuning seeds, for trials and judging together, got {trial} and {fresh}"
        )
    return every[:trial], every[-fresh:]


def tune(
    task: Task, trials: int, storage: Path, also: Mapping[str, float] | None = None, sampler_seed: int | None = None
) -> optuna.Study:
    """Go on with a study until it has enough finished trials, those of earlier runs counted.

    Several processes may share the file `storage`. The gains `also`, such as those of an earlier
    study, are one of the trials. Without a `sampler_seed`, each run and process has a new one, so
    that no trial is repeated.
    """
    ranges = task.ranges
    for name, value in (also or {}).items():
        if name not in ranges:
            raise unknown(f"gain of {task.policy.name}", name, ranges)
        low, high = ranges[name]
        check_number(name, value, low=low, high=high)
    storage.parent.mkdir(parents=True, exist_ok=True)
    optuna.logging.set_verbosity(optuna.logging.ERROR)  # a stopped trial is a warning with a traceback
    study = _study(task.policy.name, storage, optuna.samplers.TPESampler(seed=sampler_seed))
    _close_stale(study)

    def objective(trial: optuna.Trial) -> float:
        begin = time.process_time()
        trial.set_user_attr("process", _process())
        # The first trial is that of the default gains.
        gains = {} if trial.number == 0 else {n: trial.suggest_float(n, *ends, log=True) for n, ends in ranges.items()}
        try:
            return task.cost(gains)[0]
        finally:
            trial.set_user_attr("cpu_s", time.process_time() - begin)

    try:
        while len(finished(study)) < trials:
            if also and study.trials:
                study.enqueue_trial(dict(also), skip_if_exists=True)
            study.optimize(objective, n_trials=1)
    finally:
        _close_stale(study, including=_process())
    return study


def _study(name: str, path: Path, sampler: optuna.samplers.BaseSampler, attempts: int = 30) -> optuna.Study:
    """The study of a file. If another process creates the same file now, SQLite raises an error."""
    for _ in range(attempts):
        with contextlib.suppress(sqlalchemy.exc.SQLAlchemyError):
            storage = optuna.storages.RDBStorage(f"sqlite:///{path}", engine_kwargs={"connect_args": {"timeout": 60.0}})
            return optuna.create_study(study_name=name, storage=storage, load_if_exists=True, sampler=sampler)
        time.sleep(0.2)
    raise ValueError(
        f"{path} must be a study of Optuna that can be written, and is none; remove it, or name another folder"
    )


def _process() -> str:
    return f"{platform.node()} {os.getpid()}"


def _close_stale(study: optuna.Study, including: str = "") -> None:
    """Mark trials as failed whose process has ended, and those of one that ends now."""
    for trial in study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.RUNNING,)):
        process = trial.user_attrs.get("process", "")
        machine, _, pid = process.rpartition(" ")
        if process == including or (machine == platform.node() and not _lives(int(pid))):
            with contextlib.suppress(ValueError, RuntimeError):  # another process closed it
                study.tell(trial.number, state=optuna.trial.TrialState.FAIL)


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def finished(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    """Return the trials of a study that ended with a number."""
    return study.get_trials(states=(optuna.trial.TrialState.COMPLETE,))


def judge(task: Task, study: optuna.Study, candidates: int) -> list[dict[str, Any]]:
    """Judge the best trials and the defaults (trial 0) on a task that no trial used, best first.

    Each verdict is written into the study and read from there the next time.
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
    return sorted(verdicts, key=lambda verdict: verdict["objective"] + DIVERGENCE_COST * verdict["diverged_pct"])


def summary(
    task: Task, study: optuna.Study, judging: Task, verdicts: list[dict[str, Any]], command: str
) -> dict[str, Any]:
    """Return the gains that are judged best, with their verdict and cost, as plain data."""
    done = finished(study)
    columns = ("trial", "objective", "diverged_pct")
    return {
        "policy": task.policy.name,
        "gains": verdicts[0]["gains"],
        "trials": {
            "count": len(done),
            "environment_steps": task.steps * len(done),
            "cpu_s": round(sum(t.user_attrs.get("cpu_s", 0.0) for t in done), 1),
            **task.described,
        },
        "judged": {
            "best_first": [{name: verdict[name] for name in columns} for verdict in verdicts],
            "environment_steps": judging.steps * len(verdicts),
            "cpu_s": round(sum(verdict["cpu_s"] for verdict in verdicts), 1),
            **judging.described,
        },
        "ranges": {name: list(ends) for name, ends in task.ranges.items()},
        **provenance(command),
    }


def ship(summary: dict[str, Any], folder: Path = TUNED) -> Path:
    """Write the result of `summary` where `controllers` reads it as POLICY@tuned.

    Of the judged trials, the file has the number and the errors of the best and of the defaults.
    """
    verdicts = summary["judged"]["best_first"]
    (defaults,) = (verdict for verdict in verdicts if verdict["trial"] == 0)
    judged = {"count": len(verdicts), "best": verdicts[0], "defaults": defaults, **summary["judged"]}
    del judged["best_first"]
    entries = {**summary, "judged": judged}
    lines = ",\n".join(f" {json.dumps(key)}: {json.dumps(value)}" for key, value in entries.items())
    path = folder / f"{summary['policy']}.json"
    write_text(path, f"{{\n{lines}\n}}\n")
    return path
