"""The end of each row: how far one thing can be pushed before a policy loses runs or its accuracy.

`python -m benchmarks.studies.ends servo lqg@tuned l1-adaptive@tuned` prints a table in Markdown,
on the nominal arm of a class of robots. Each column pushes one thing from mild to severe, and the
entry is the first value at which the policy loses 1 % of its runs, or errs twice as much as at the
mildest value.
"""

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.policies.spec import resolve
from benchmarks.run.cell import Cell
from benchmarks.run.metrics import counted_errors
from benchmarks.run.runner import run as run_cells
from benchmarks.run.store import Result, Store
from benchmarks.seeds import SPLITS
from fbl_gym import Scenario, scenarios
from fbl_gym.model.arm import stretched_inertia
from fbl_gym.records.record import ends as ends_of
from fbl_gym.records.record import scaled
from fbl_gym.scenarios.classes import CLASSES

LOST, TIMES = 0.01, 2.0
"""A policy ends where it loses so large a share of its runs, or errs so many times its best."""


_DELAYS = {"servo": (0, 5, 10, 20, 30, 40, 60), "direct": (0, 2, 4, 7, 10, 15, 20), "geared": (0, 1, 2, 4, 6, 9, 12)}
"""Further delays in each class of robots [ms]."""


def axes(robot: str) -> dict[str, dict[float, Scenario]]:
    """Return what is pushed on the nominal arm of a class of robots, by title and by value.

    The values are from mild to severe.
    """
    nominal = scenarios.get(f"{robot}-nominal")
    friction, drive, error = nominal.friction, nominal.actuator, nominal.parameter_error
    assert friction is not None
    assert error is not None

    def springy(frequency: float, encoder: str) -> Scenario:
        """Return springs; each stretched joint vibrates at a frequency [Hz] on a held motor."""
        damping = tuple(0.04 * stretched_inertia(nominal.arm) * 2 * np.pi * frequency)
        joint = {"frequency": frequency, "damping": damping, "encoder": encoder, "rotor_inertia": nominal.rotor}
        return nominal.replace(joint=joint, physics_dt=1e-4)

    late, link, stiffnesses = ends_of(drive.delay)[1], nominal.arm.m2, (40, 20, 12, 8, 5, 4, 3, 2)
    levels = {name: getattr(friction, name) for name in ("viscous", "coulomb", "stiction")}
    return {
        "further delay [ms]": {x: nominal.replace(actuator=replace(drive, delay=late + 1e-3 * x)) for x in _DELAYS[robot]},
        "springs, encoder on the link [Hz]": {x: springy(x, "link") for x in stiffnesses},
        "springs, encoder on the motor [Hz]": {x: springy(x, "motor") for x in stiffnesses},
        "links that bend [Hz]": {x: nominal.replace(link={"frequency": x, "damping": 0.05}, physics_dt=1e-4)
            for x in (80, 40, 30, 20, 15, 10, 7, 5)},
        "friction [times]": {x: nominal.replace(friction=replace(friction, **{k: scaled(y, x) for k, y in levels.items()}))
            for x in (1, 2, 4, 8, 16, 32)},
        "payload [times the second link]": {x: nominal.replace(parameter_error=replace(error, payload={"mass": x * link}))
            for x in (0, 0.25, 0.5, 1, 2, 4)},
        "rate [times]": {x: nominal.replace(control_dt=nominal.control_dt / x) for x in (2, 1, 0.5, 0.25)},
    }  # fmt: skip


def end(results: Mapping[float, Result]) -> str:
    """Return the first value at which a policy ends, and why; "–": it does not end.

    Args:
        results: of the policy, by the value, from mild to severe.
    """
    first = None
    for value, result in results.items():
        if result.error:
            return f"{value:g}: fails"
        lost = float(np.mean([row["diverged"] for row in result.rows]))
        error = float(np.exp(np.mean(np.log(counted_errors(result.rows)))))
        first = first or error
        if lost >= LOST:
            return f"{value:g}: {100 * lost:.0f} % lost"
        if error > TIMES * first:
            return f"{value:g}: {error / first:.1f} ×"
    return "–"


def main(argv: Sequence[str] | None = None) -> None:
    """Print a row for each policy."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.studies.ends", description=__doc__)
    parser.add_argument("robot", choices=tuple(CLASSES), metavar="CLASS", help=f"class of robots: {', '.join(CLASSES)}")
    parser.add_argument("policies", nargs="+", metavar="POLICY", help="as for fbl-gym leaderboard")
    parser.add_argument("--seeds", type=int, default=64, metavar="N", help="test seeds 0 to N-1 (64)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes")
    parser.add_argument("--store", type=Path, default=Path("results/board"), metavar="DIR", help="folder of results")
    arguments = parser.parse_args(argv)
    pushed = {
        title: {x: task.replace(name=f"{title.partition(' [')[0]} {x:g}") for x, task in tasks.items()}
        for title, tasks in axes(arguments.robot).items()
    }
    seeds, specs = tuple(SPLITS["test"][: arguments.seeds]), [*map(resolve, arguments.policies)]
    cells = [Cell(spec, task, seeds) for spec in specs for tasks in pushed.values() for task in tasks.values()]
    runs = run_cells(cells, Store(arguments.store), workers=arguments.workers)
    results = {result.cell.id: result for _, result in runs}
    print("| policy | " + " | ".join(pushed) + " |\n" + "| --- " * (1 + len(pushed)) + "|")
    for policy in (spec.name for spec in specs):
        ends = (end({x: results[f"{policy}/{task.name}"] for x, task in tasks.items()}) for tasks in pushed.values())
        print(f"| `{policy}` | " + " | ".join(ends) + " |")


if __name__ == "__main__":
    main()
