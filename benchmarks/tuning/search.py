"""Tuning of a policy's gains on the tuning seeds, with Optuna; it counts the cost.

The objective is the mean over scenarios of log(error) + 0.1 log(1 + chatter), and a price for small
margins. The error is the penalized one, by which boards rank: the geometric mean of error_pct over
the runs, each at least the sensor's resolution, doubled for each percent of lost runs. The chatter
of a run is the total variation of its torque per second, divided by the root mean square of its
torque. Because of the logarithms, a scenario counts by the relative change of its error.

The price is 1 for each of two margins that is zero, and falls to 0 at the phase and delay margin
that are asked for. Of eight arms of the first scenario, the one with the highest price counts. A
loop that is unstable without dry friction has no margins; a law that cannot be linearised pays
nothing.

Trials use few scenarios and seeds. The best trials and the defaults are therefore judged with the
same objective on more scenarios, and on tuning seeds that no trial used. The gains that are judged
best are written to a file.
"""

from __future__ import annotations

import json
import logging
import math
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.files import write_text
from benchmarks.policies.key import data_digest
from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.run.cell import Cell
from benchmarks.run.linearize import ARMS, margin_metrics
from benchmarks.run.metrics import MARGINS, counted_errors, measure, penalize
from benchmarks.run.rollout import rollout
from benchmarks.run.store import provenance
from benchmarks.seeds import SPLITS
from controllers import registry
from controllers.name import PolicyName, expect_law, gains_file
from fbl_gym import Scenario, scenarios
from fbl_gym.reading import read_bytes
from fbl_gym.records.record import set_fields, tuning_ranges

if TYPE_CHECKING:  # of the extra `analysis`: imported where a study is used
    import optuna

CHATTER = 0.1  # weight of the torque's chatter in the objective

# Price of a margin of zero: 1 % of error for each percent that lacks of what is asked for.
# Three times the price made the leading laws of `servo` err 2 to 3 times as much, also where the
# data sheet is wrong.
PRICE = 1.0

COUNTED = ("variation", "torque_rms", "diverged")  # the metrics of the objective, beside the error
STORAGE = "sqlite:///results/tuning.db?timeout=60"


def scenarios_of(robot: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the scenarios of trials, and of those that the best ones are judged on.

    Args:
        robot: a class of robots.
    """
    known = scenarios.in_tier(f"{robot}-practice")
    third = "noise-3" if robot == "direct" else "delay-3"
    pushed = ("nominal", third, "friction-3", "elastic-3", "saturation-1", "datasheet-3", "everything-3")
    return tuple(name for name in known if name.endswith(pushed)), known


@dataclass(frozen=True)
class Task:
    """A policy to tune, with scenarios and the seeds of each.

    Attributes:
        policy: the policy.
        scenarios: of the runs; the first one is that of the margins.
        seeds: of the runs in each scenario; the arms of the margins begin with the first, or are
            the last ones of the split.
        margins: phase [degrees] and delay [samples] below which the gains pay; 0: they do not.
    """

    policy: PolicySpec
    scenarios: tuple[Scenario, ...]
    seeds: range
    margins: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        set_fields(self, policy=resolve(self.policy))
        if not self.ranges:
            raise ValueError(f"{self.policy.name} has nothing to tune: no gain is declared with a range `tune`")

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Least and largest value of each gain."""
        factory = self.policy.factory()
        return tuning_ranges(factory) if isinstance(factory, type) else {}

    def shipped(self, *robots: str) -> dict[str, dict[str, Any]]:
        """Return the gains for classes of robots that are within the search, by policy."""
        names = [name for robot in robots for name in registry.tuned(robot) if name == f"{self.policy.name}@{robot}"]
        gains = {name: registry.tuned_gains(name) for name in names}
        return {name: x for name, x in gains.items() if {*x} == {*self.ranges} and all(map(np.isscalar, x.values()))}

    @property
    def arms(self) -> list[dict[str, Any]]:
        """The arms of the scenarios as plain data, for a file of gains."""
        return [asdict(arm) for arm in dict.fromkeys(scenario.arm for scenario in self.scenarios)]

    def effort(self, count: int, cpu_s: float) -> dict[str, Any]:
        """Return the effort of some sets of gains as plain data, with scenarios and seeds."""
        steps = count * len(self.seeds) * sum(scenario.steps for scenario in self.scenarios)
        names, seeds = [scenario.name for scenario in self.scenarios], [self.seeds.start, self.seeds.stop]
        effort = {"count": count, "environment_steps": steps, "cpu_s": round(cpu_s, 1)}
        return effort | {"scenarios": names, "seeds": seeds}

    @property
    def digest(self) -> str:
        """Hash of the policy, the scenarios and the seeds, 12 hexadecimal digits."""
        keys = [Cell(self.policy, scenario, tuple(self.seeds)).key for scenario in self.scenarios]
        return data_digest([*keys, self.margins, PRICE])[:12]

    def cost(self, gains: Mapping[str, float], best: float = math.inf) -> tuple[float, float]:
        """Return the objective of gains (lower is better) and the share of diverged runs [%].

        Where it is above the `best` without the price of the margins, that is left out.
        """
        costs, diverged = [], []
        for scenario in self.scenarios:
            runs = measure(rollout(self.policy, scenario, self.seeds, gains))
            variation, torque, lost = np.array([[run[name] for run in runs] for name in COUNTED])
            chatter = variation / np.maximum(torque, 1e-9)
            costs.append(np.mean(np.log(penalize(counted_errors(runs), lost)) + CHATTER * np.log1p(chatter)))
            diverged.append(100 * lost.mean())
        cost = float(np.mean(costs))
        return cost + (self.price(gains) if cost < best else 0.0), float(np.mean(diverged))

    def price(self, gains: Mapping[str, float]) -> float:
        """Return the price of small margins."""
        if not any(self.margins):
            return 0.0
        first = min(self.seeds.start, SPLITS["tuning"][-1] + 1 - ARMS)  # fresh seeds are the last ones
        rows = margin_metrics(self.policy, self.scenarios[0], range(first, first + ARMS), gains)
        found = np.array([[row[name] for name in MARGINS[:2]] for row in rows])
        lacking = np.maximum(0.0, 1.0 - np.nan_to_num(found, nan=np.inf) / np.maximum(self.margins, 1e-9))
        return float(PRICE * lacking.sum(axis=1).max())


def seeds(trial: int, fresh: int) -> tuple[range, range]:
    """Return numbers of tuning seeds: for the trials, and fresh ones to judge on."""
    tuning = SPLITS["tuning"]
    if trial + fresh > len(tuning):
        raise ValueError(f"there are {len(tuning)} tuning seeds, for trials and judging, got {trial} and {fresh}")
    return tuning[:trial], tuning[-fresh:]


def tune(
    task: Task, storage: str, starts: Iterable[Mapping[str, float]] = (), trials: int = sys.maxsize,
    seed: int | None = None,
) -> optuna.Study:  # fmt: skip
    """Go on with a study until it has enough trials, those of earlier runs counted.

    The first trial is that of the default gains. A trial fails if the law refuses its gains by a
    ValueError or an ArithmeticError. Other code, scenarios or seeds begin another study. Processes,
    also those of several machines, share the studies of a database, named by its URL as for Optuna.
    Each run and process has another sampler seed, so that no trial is repeated.

    Args:
        task: to be tuned.
        storage: database of the trials.
        starts: gains of the trials after the first.
        trials: enough of them.
        seed: of the sampler; None: another one for each run and process.
    """
    from optuna.study import MaxTrialsCallback
    from optuna.trial import TrialState

    study = open_study(task, storage, seed=seed)
    # By a trial's number, not by Optuna's queue, from which two processes may take the same trial.
    spaces = [{}, *({name: (gain, gain) for name, gain in gains.items()} for gains in starts)]

    def objective(trial: optuna.Trial) -> float:
        begin = time.process_time()
        space = spaces[trial.number] if trial.number < len(spaces) else task.ranges
        gains = {name: trial.suggest_float(name, *ends, log=True) for name, ends in space.items()}
        cost, _ = task.cost(gains, min((done.value or 0.0 for done in finished(study)), default=math.inf))
        trial.set_user_attr("cpu_s", time.process_time() - begin)
        return cost

    try:
        states = TrialState.COMPLETE, TrialState.FAIL
        if len(study.get_trials(deepcopy=False, states=states)) < trials:
            enough = MaxTrialsCallback(trials, states=states)
            study.optimize(objective, catch=(ValueError, ArithmeticError), callbacks=[enough])
    except Exception as problem:
        if isinstance(problem.__context__, KeyboardInterrupt):  # it came while Optuna stored the trial
            raise problem.__context__ from None
        raise
    return study


def open_study(task: Task, storage: str, retries: int = 4, seed: int | None = None) -> optuna.Study:
    """Return the study of a task in a database; a new one, if it has none.

    Raises:
        ValueError: there is no such database, and none can be created.
    """
    import optuna
    import sqlalchemy

    optuna.logging.set_verbosity(optuna.logging.ERROR)  # a stopped trial is a warning with a traceback
    logging.getLogger("sqlalchemy").setLevel(logging.CRITICAL)  # and a stopped query an error with one
    try:
        if storage.startswith("sqlite:///"):
            Path(storage.removeprefix("sqlite:///").partition("?")[0]).parent.mkdir(parents=True, exist_ok=True)
        name, sampler = f"{task.policy.name} {task.digest}", optuna.samplers.TPESampler(seed=seed)
        return optuna.create_study(study_name=name, storage=storage, load_if_exists=True, sampler=sampler)
    except (sqlalchemy.exc.SQLAlchemyError, ImportError, OSError) as problem:
        if retries and isinstance(problem, sqlalchemy.exc.DBAPIError):  # another process may be making the tables
            time.sleep(0.5)
            return open_study(task, storage, retries - 1, seed)
        raise ValueError(f"storage must be a URL such as {STORAGE}, got {storage!r}: {problem}") from None


def finished(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    """Return the trials of a study that ended with a number."""
    return [trial for trial in study.trials if trial.state.name == "COMPLETE"]


def rounded(trial: optuna.trial.FrozenTrial) -> dict[str, float]:
    """Return the gains of a trial as they are judged and shipped, with four digits."""
    return {name: float(f"{value:.4g}") for name, value in trial.params.items()}


def judge(task: Task, study: optuna.Study, candidates: int) -> list[dict[str, Any]]:
    """Judge the best trials and the defaults (trial 0) on a task that no trial used, best first.

    Each verdict is kept in the study. Those of earlier runs on the task are among the answer.
    """
    trials = sorted((t for t in finished(study) if t.params), key=lambda trial: trial.value or 0.0)[:candidates]
    prefix = f"judged on {task.digest}: "
    verdicts = {name: verdict for name, verdict in study.user_attrs.items() if name.startswith(prefix)}
    for trial, values in {0: dict[str, float](), **{t.number: rounded(t) for t in trials}}.items():
        if (name := f"{prefix}{trial}") not in verdicts:
            begin = time.process_time()
            cost, diverged = task.cost(values)
            verdict = {"trial": trial, "gains": values, "objective": cost, "diverged_pct": diverged}
            verdicts[name] = verdict | {"cpu_s": time.process_time() - begin}
            study.set_user_attr(name, verdicts[name])
    return sorted(verdicts.values(), key=lambda verdict: verdict["objective"])


def summary(
    task: Task, study: optuna.Study, judging: Task, verdicts: list[dict[str, Any]], command: str
) -> dict[str, Any]:
    """Return the gains that are judged best, with their verdict, that of the defaults, and cost."""
    done, columns = finished(study), ("trial", "objective", "diverged_pct")
    judged = [{name: verdict[name] for name in columns} for verdict in verdicts]
    best = {"best": judged[0], "defaults": next(verdict for verdict in judged if verdict["trial"] == 0)}
    law: Any = task.policy.factory()
    # The file stays the same when the defaults change.
    defaults = {field.name: field.default for field in fields(law) if field.name in task.ranges}
    return {
        "policy": str(task.policy.parsed.code), "gains": verdicts[0]["gains"] or defaults,
        "trials": task.effort(len(done), sum(t.user_attrs.get("cpu_s", 0.0) for t in done)),
        "judged": best | judging.effort(len(verdicts), sum(verdict["cpu_s"] for verdict in verdicts)),
        "ranges": {name: list(ends) for name, ends in task.ranges.items()}, "arms": task.arms, **provenance(command),
    }  # fmt: skip


def at_edge(summary: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Return the range of each gain that a search left at its edge; better gains may lie beyond.

    An edge is 5 % of the range's logarithm.
    """
    found = {}
    for gain, (low, high) in summary["ranges"].items():
        value, margin = np.array(summary["gains"][gain]), (high / low) ** 0.05
        searched = (value >= low) & (value <= high)  # a default may lie outside
        if np.any(searched & ((value < low * margin) | (value > high / margin))):
            found[gain] = (low, high)
    return found


def write_gains(summary: dict[str, Any], folder: Path) -> Path:
    """Write a summary to a file in a folder, for use as POLICY@FOLDER; return the file.

    In a class's folder of `TUNED`, the gains are those of POLICY@tuned for that class.

    Raises:
        ValueError: the file has the gains of another law.
    """
    path = gains_file(str(PolicyName.parse(summary["policy"]).code), folder)
    if path.exists():
        expect_law(summary["policy"], path, json.loads(read_bytes(path)))
    lines = ",\n".join(f" {json.dumps(key)}: {json.dumps(value)}" for key, value in summary.items())
    write_text(path, f"{{\n{lines}\n}}\n")
    return path
