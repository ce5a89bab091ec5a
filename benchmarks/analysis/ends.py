"""The end of each row: how far one thing can be pushed before a policy loses runs or its accuracy.

`python -m benchmarks.analysis.ends servo lqg@tuned l1-adaptive@tuned` prints a table in Markdown,
on the nominal arm of a class of robots. Each column pushes one thing from mild to severe, and the
entry is the first value at which the policy loses 1 % of its runs, or errs twice as much as at the
mildest value.
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
from fbl_gym.model.arm import inertia_matrix
from fbl_gym.records import ends as ends_of
from fbl_gym.scenarios.classes import CLASSES

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


_DELAYS = {"servo": (0, 5, 10, 20, 30, 40, 60), "direct": (0, 2, 4, 7, 10, 15, 20), "geared": (0, 1, 2, 4, 6, 9, 12)}
"""Further delays in each class of robots [ms]."""


def axes(robot: str) -> tuple[Axis, ...]:
    """Return what is pushed on the nominal arm of a class of robots."""
    nominal = scenarios.get(f"{robot}-nominal")
    friction, drive, error = nominal.friction, nominal.actuator, nominal.parameter_error
    assert friction is not None
    assert error is not None
    inertia = inertia_matrix(nominal.arm.lumped, (0.0, 0.0)).diagonal()

    def delayed(milliseconds: float) -> Scenario:
        late = ends_of(drive.delay)[1] + 1e-3 * milliseconds
        return nominal.replace(actuator=dataclasses.replace(drive, delay=late))

    def rubbed(times: float) -> Scenario:
        levels = {name: scaled_pair(getattr(friction, name), times) for name in ("viscous", "coulomb", "stiction")}
        return nominal.replace(friction=dataclasses.replace(friction, **levels))

    def loaded(share: float) -> Scenario:
        return nominal.replace(parameter_error=dataclasses.replace(error, payload={"mass": share * nominal.arm.m2}))

    def springy(encoder: Literal["link", "motor"]) -> Callable[[float], Scenario]:
        def at(frequency: float) -> Scenario:
            """Return springs; each stretched joint vibrates at a frequency [Hz] on a held motor."""
            stiffness = tuple(inertia * (2 * np.pi * frequency) ** 2)
            joint = {
                "stiffness": stiffness, "damping": tuple(0.04 * np.sqrt(stiffness * inertia)), "encoder": encoder,
                "rotor_inertia": tuple(0.3 * inertia) if min(nominal.rotor) == 0 else nominal.rotor,
            }  # fmt: skip
            return nominal.replace(joint=joint, physics_dt=1e-4)

        return at

    stiffnesses = (40, 20, 12, 8, 5, 4, 3, 2)
    return (
        Axis("further delay [ms]", _DELAYS[robot], delayed),
        Axis("springs, encoder on the link [Hz]", stiffnesses, springy("link")),
        Axis("springs, encoder on the motor [Hz]", stiffnesses, springy("motor")),
        Axis("friction [times]", (1, 2, 4, 8, 16, 32), rubbed),
        Axis("payload [times the second link]", (0, 0.25, 0.5, 1, 2, 4), loaded),
        Axis("rate [times]", (2, 1, 0.5, 0.25), lambda times: nominal.replace(control_dt=nominal.control_dt / times)),
    )


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
    parser.add_argument("robot", choices=tuple(CLASSES), metavar="CLASS", help=f"class of robots: {', '.join(CLASSES)}")
    parser.add_argument("policies", nargs="+", metavar="POLICY", help="as for fbl-gym leaderboard")
    parser.add_argument("--seeds", type=int, default=64, metavar="N", help="test seeds 0 to N-1 (64)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes")
    parser.add_argument("--store", type=Path, default=Path("results/board"), metavar="DIR", help="folder of results")
    arguments = parser.parse_args(argv)
    pushed = axes(arguments.robot)
    store, seeds = Store(arguments.store), tuple(SPLITS["test"][: arguments.seeds])
    specs = {policy: resolve_isolated(policy) for policy in arguments.policies}
    cells = {
        (policy, axis.title, value): Cell(
            specs[policy], axis.scenario(value).replace(name=f"{axis.title.partition(' [')[0]} {value:g}"), seeds
        )
        for policy in arguments.policies for axis in pushed for value in axis.values
    }  # fmt: skip
    results = {result.cell.id: result for _, result in run_cells([*cells.values()], store, workers=arguments.workers)}
    print("| policy | " + " | ".join(axis.title for axis in pushed) + " |\n" + "| --- " * (1 + len(pushed)) + "|")
    for policy in arguments.policies:
        ends = [end([results[cells[policy, a.title, v].id] for v in a.values], a.values) for a in pushed]
        print(f"| `{policy}` | " + " | ".join(ends) + " |")


if __name__ == "__main__":
    main()
