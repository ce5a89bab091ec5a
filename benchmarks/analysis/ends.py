"""Where each row ends: how far one thing can be pushed before a policy loses runs or its accuracy.

`python -m benchmarks.analysis.ends lqg@tuned l1-adaptive@tuned` prints a table in Markdown. Each
column pushes one thing from mild to severe, and the entry is the first value at which the policy
loses 1 % of its runs, or errs twice as much as at the mildest value.
"""

import argparse
import dataclasses
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.analysis.recommend import scaled_pair
from benchmarks.policies.spec import resolve_isolated
from benchmarks.run.metrics import counted_errors
from benchmarks.run.runner import run as run_cells
from benchmarks.run.store import Result, Store
from benchmarks.run.suite import Cell
from benchmarks.seeds import SPLITS
from fbl_gym import Scenario, scenarios

LOST, TIMES = 0.01, 2.0
"""A policy ends where it loses so large a share of its runs, or errs so many times its best."""


@dataclass(frozen=True)
class Axis:
    """A thing that is pushed.

    Attributes:
        title: with the unit.
        values: from mild to severe.
        scenario: function that returns the scenario of a value.
    """

    title: str
    values: tuple[float, ...]
    scenario: Callable[[float], Scenario]


def _delayed(milliseconds: float) -> Scenario:
    return _nominal(actuator=dataclasses.replace(_NOMINAL.actuator, delay=1e-3 * milliseconds))


def _rubbed(times: float) -> Scenario:
    friction = _NOMINAL.friction
    assert friction is not None
    levels = {name: scaled_pair(getattr(friction, name), times) for name in ("viscous", "coulomb", "stiction")}
    return _nominal(friction=dataclasses.replace(friction, **levels))


def _loaded(share: float) -> Scenario:
    return _nominal(parameter_error={"radius": 0.1, "payload": {"mass": share * _NOMINAL.arm.m2}})


def _springy(encoder: Literal["link", "motor"]) -> Callable[[float], Scenario]:
    springs = scenarios.get("servo-elastic-2")
    assert springs.joint is not None
    joint = springs.joint

    def at(frequency: float) -> Scenario:
        """Return springs on which the links vibrate at a frequency [Hz] while motors are held."""
        stiffness = scaled_pair(joint.stiffness, (frequency / 7.0) ** 2)  # of severity 2: 7 Hz
        return springs.replace(
            joint=dataclasses.replace(joint, stiffness=stiffness, encoder=encoder), physics_dt=2.5e-4
        )

    return at


def _nominal(**changes: object) -> Scenario:
    return _NOMINAL.replace(**changes)


_NOMINAL = scenarios.get("servo-nominal")
AXES = (
    Axis("further delay [ms]", (0, 5, 10, 20, 30, 40, 50, 60, 80), _delayed),
    Axis("springs, encoder on the link [Hz]", (40, 20, 12, 8, 5, 4, 3, 2.5, 2), _springy("link")),
    Axis("springs, encoder on the motor [Hz]", (40, 20, 12, 8, 5, 4, 3, 2.5, 2), _springy("motor")),
    Axis("friction [times]", (1, 2, 4, 8, 16, 32), _rubbed),
    Axis("payload [times the second link]", (0, 0.25, 0.5, 1, 2, 4), _loaded),
    Axis("rate [Hz]", (200, 100, 50, 40, 25, 20), lambda hertz: _nominal(control_dt=1 / hertz)),
)  # fmt: skip


def end(results: Sequence[Result], values: Sequence[float]) -> str:
    """Return the first value at which a policy ends, and why; "–": it does not end.

    Args:
        results: of the policy, one for each value.
        values: from mild to severe.
    """
    first = None
    for result, value in zip(results, values, strict=True):
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
    parser = argparse.ArgumentParser(prog="python -m benchmarks.analysis.ends", description=__doc__)
    parser.add_argument("policies", nargs="+", metavar="POLICY", help="as for fbl-gym leaderboard")
    parser.add_argument("--seeds", type=int, default=64, metavar="N", help="test seeds 0 to N-1 (64)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes")
    parser.add_argument("--store", type=Path, default=Path("results/board"), metavar="DIR", help="folder of results")
    arguments = parser.parse_args(argv)
    store, seeds = Store(arguments.store), tuple(SPLITS["test"][: arguments.seeds])
    specs = {policy: resolve_isolated(policy) for policy in arguments.policies}
    cells = {
        (policy, axis.title, value): Cell(
            specs[policy], axis.scenario(value).replace(name=f"{axis.title.partition(' [')[0]} {value:g}"), seeds
        )
        for policy in arguments.policies for axis in AXES for value in axis.values
    }  # fmt: skip
    results = {result.cell.id: result for _, result in run_cells([*cells.values()], store, workers=arguments.workers)}
    print("| policy | " + " | ".join(axis.title for axis in AXES) + " |\n" + "| --- " * (1 + len(AXES)) + "|")
    for policy in arguments.policies:
        ends = [end([results[cells[policy, a.title, v].id] for v in a.values], a.values) for a in AXES]
        print(f"| `{policy}` | " + " | ".join(ends) + " |")


if __name__ == "__main__":
    main()
