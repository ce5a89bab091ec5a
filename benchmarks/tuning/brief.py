"""Brief tuning of several laws for one arm; of `fbl-gym recommend`.

Each law of a round has as many trials as the others, and only the better half goes on to the next
round. The trials begin with the default gains and those for the classes of robots, and are kept in
a database: the next call goes on with them.
"""

import math
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from benchmarks.policies.isolation import Failed, run_parallel
from benchmarks.policies.spec import resolve
from benchmarks.run.store import provenance
from benchmarks.seeds import SPLITS
from benchmarks.studies.recommend import around, likeness
from benchmarks.tuning.search import STORAGE, Task, finished, open_study, rounded, tune, write_gains
from fbl_gym.options import FourierReference
from fbl_gym.scenarios import Scenario, held_out_reason
from fbl_gym.scenarios.classes import CLASSES

ROUNDS = (8, 4, 2)  # number of laws in each round
SEEDS = SPLITS["tuning"][:8]  # of a trial, in each of its scenarios


def practice(base: Scenario) -> Scenario:
    """Return the scenario; if it is for judging alone, with another motion, events and engine."""
    if not held_out_reason(base):
        return base
    move_time = CLASSES[likeness(base)[0][0]].move_time
    motion = FourierReference(amplitude=(1.5, 2.0), frequency=0.24 / move_time, harmonics=4)
    steps = min(base.steps, round(4.8 / base.control_dt))
    return base.replace(reference=motion, duration=steps * base.control_dt, events=(), plant=None)


def tasks_of(base: Scenario, policies: Sequence[str], margins: tuple[float, float]) -> list[Task]:
    """Return a task for each built-in law with gains to tune, of the policies in their order.

    Its scenarios are the arm as described, and with everything larger at once.
    """
    conditions = around(practice(base))
    scenarios = conditions["as described"], conditions["everything"]
    tasks: dict[str, Task] = {}
    for spec in map(resolve, policies):
        if not spec.parsed.gains and not spec.external:
            try:
                tasks.setdefault(spec.parsed.law, Task(resolve(spec.parsed.law), scenarios, SEEDS, margins))
            except ValueError:  # nothing to tune
                continue
    return list(tasks.values())


def tune_briefly(
    base: Scenario, policies: Sequence[str], trials: int, margins: tuple[float, float],
    report: Callable[[float, str], None], workers: int, command: str,
) -> list[str]:  # fmt: skip
    """Tune the first laws with gains for a scenario, and name those with other gains.

    New gains of a law are written as results/gains/SCENARIO/LAW.json; the trials are in `STORAGE`.

    Args:
        base: the scenario.
        policies: those whose laws are tuned, the best first.
        trials: of each law in each round, beside those of earlier calls.
        margins: that are asked for, as of `Task`.
        report: called with the share that is done, and a law with its objective.
        workers: number of processes.
        command: the command that was typed, for the record.
    """
    every = tasks_of(base, policies, margins)[: ROUNDS[0]]
    tasks, done, units = every, 0, sum(min(number, len(every)) for number in ROUNDS)
    for task in tasks:
        open_study(task, STORAGE)  # here, since no two processes may create a database at once
    for number in ROUNDS if tasks else ():
        tasks, values = tasks[:number], {}
        for task, value in run_parallel(partial(_trials, trials), tasks, min(workers, len(tasks))):
            name = task.policy.name
            values[name], done = math.inf if isinstance(value, Failed) else value, done + 1
            report(done / units, f"{name}: {values[name]:.2f}")
        tasks = sorted(tasks, key=lambda task: values[task.policy.name])
    folder = Path("results/gains", re.sub(r"[^\w.+-]+", "_", base.name or "arm"))
    return [name for task in every if (name := write_best(task, STORAGE, folder, command)) not in policies]


def write_best(task: Task, storage: str, folder: Path, command: str) -> str:
    """Write the gains of a law's best trial into a folder, and return the policy's name.

    If the default gains or those for a class are best, nothing is written, and the name is theirs.
    """
    trials, law = finished(open_study(task, storage)), task.policy.name
    best = min(trials, key=lambda trial: trial.value or 0.0, default=None)
    if best is None or not best.params:
        return law
    if shipped := next((name for name, gains in task.shipped(*CLASSES).items() if gains == best.params), None):
        return shipped
    effort = task.effort(len(trials), sum(trial.user_attrs.get("cpu_s", 0.0) for trial in trials))
    data = {"policy": law, "gains": rounded(best), "objective": best.value, "trials": effort, "arms": task.arms}
    return f"{law}@{write_gains(data | provenance(command), folder).parent}"


def _trials(trials: int, task: Task) -> float:
    """Go on with a law's trials; return the best objective."""
    begun = len(open_study(task, STORAGE).trials)
    study = tune(task, STORAGE, task.shipped(*CLASSES).values(), begun + trials, seed=begun)
    return min((trial.value or 0.0 for trial in finished(study)), default=math.inf)
