"""The check of `recommend` on drawn arms: is its first choice as good as a longer search?

`python -m tests.drawn_arms 6` compares the first choice on each arm with the best of
nine laws, each tuned for this arm by 12 trials, and prints a line for each arm.
"""

import argparse
import dataclasses
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.analysis.board import assemble
from benchmarks.policies.isolation import Failed, run_parallel
from benchmarks.run.cell import Cell
from benchmarks.run.loop import LEAST_DELAY, LEAST_PHASE
from benchmarks.run.runner import run as run_cells
from benchmarks.run.store import Result, Store
from benchmarks.run.suite import Suite
from benchmarks.studies.recommend import Likeness, candidates, recommend
from benchmarks.studies.sealed import draw_arm
from benchmarks.tuning.brief import tasks_of, tune_briefly, write_best
from benchmarks.tuning.search import Task, open_study, tune
from fbl_gym.scenarios import Scenario
from fbl_gym.scenarios.class_families import conditions, families
from fbl_gym.scenarios.classes import CLASSES

#: A first choice is good if it errs at most WITHIN times as much as the best tuned law.
WITHIN = 1.5

LAWS = (
    "pid-gravity", "computed-torque", "computed-torque-dob", "sliding-mode", "h-infinity", "lqg", "l1-adaptive",
    "slotine-li", "lqg-elastic",
)  # fmt: skip
TRIALS, MARGINS = 12, (LEAST_PHASE, LEAST_DELAY)
#: Laws, trials, margins and database of the longer search.
STORAGE = "sqlite:///results/drawn.db?timeout=60"


def draw(number: int) -> Scenario:
    """Return a scenario with a drawn arm and drawn conditions; the classes take turns."""
    rng, robot = np.random.default_rng(number), [*CLASSES][number % len(CLASSES)]
    arm = draw_arm(rng, robot)
    family, severity = str(rng.choice([*families(robot)])), int(rng.integers(1, 4))
    return Scenario(name=f"drawn-{number}-{robot}-{family}-{severity}", **conditions(arm, robot, family, severity))


def search(task: Task) -> None:
    """Tune a law by `TRIALS` trials."""
    tune(task, STORAGE, trials=TRIALS)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the check of each drawn arm, and the number of good first choices."""
    parser = argparse.ArgumentParser(prog="python -m tests.drawn_arms", description=__doc__)
    parser.add_argument("arms", type=int, nargs="+", metavar="N", help="numbers of drawn arms")
    parser.add_argument("--policies", nargs="+", metavar="POLICY", help="to choose from (as fbl-gym recommend)")
    parser.add_argument("--laws", nargs="+", default=LAWS, metavar="LAW", help="laws of the comparison")
    parser.add_argument("--trials", type=int, default=20, metavar="N", help="as of fbl-gym recommend (20)")
    parser.add_argument("--seeds", type=int, default=8, metavar="N", help="test seeds 0 to N-1 (8)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes")
    parser.add_argument("--store", type=Path, default=Path("results/board"), metavar="DIR", help="folder of results")
    arguments = parser.parse_args(argv)
    store, workers, folder = Store(arguments.store), arguments.workers, Path("results/drawn")

    def run(cells: Sequence[Cell]) -> dict[str, Result]:
        return {result.cell.id: result for _, result in run_cells(cells, store, workers=workers)}

    good = []
    for base in map(draw, arguments.arms):
        options = {"trials": arguments.trials, "report": lambda *_: None, "workers": workers, "command": ""}
        begin = partial(tune_briefly, base, margins=MARGINS, **options)
        policies = arguments.policies or candidates(Likeness.of(base).classes)
        result = recommend(base, policies, arguments.seeds, run, begin if arguments.trials else None)
        tasks = tasks_of(base, arguments.laws, MARGINS)
        tasks = [dataclasses.replace(task, scenarios=task.scenarios[:1]) for task in tasks]
        for task in tasks:
            open_study(task, STORAGE)
        for _, answer in run_parallel(search, tasks, workers):
            if isinstance(answer, Failed):
                raise answer
        tuned = [write_best(task, STORAGE, folder / base.name, "") for task in tasks]
        choices = result.choices[:1] if result.safe else ()
        cells = Suite("check", (*tuned, *(choice.policy for choice in choices)), (base,), arguments.seeds).cells
        results = [each for each in run(cells).values() if not each.error]
        board = assemble(results)
        names, errors, levels = board.policies, board.error().value, board.penalized()[0]
        best = min((i for i, name in enumerate(names) if name in tuned), key=lambda i: levels[i])
        line = f"best of {len(tuned)} laws tuned: {names[best]} {errors[best]:.3g} %"
        if not choices:
            print(f"{base.name}: none is safe; {line}", flush=True)
            continue
        first = names.index(choices[0].policy)
        ratio, lost = errors[first] / errors[best], f"{choices[0].diverged} of {choices[0].runs} diverged"
        good.append(ratio <= WITHIN)
        print(f"{base.name}: {names[first]} {errors[first]:.3g} %, {ratio:.2f} x, {lost}; {line}", flush=True)
    print(f"{sum(good)} of {len(arguments.arms)} first choices are safe and within {WITHIN:g} times the best")


if __name__ == "__main__":
    main()
