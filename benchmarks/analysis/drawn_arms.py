"""The check of `recommend` on drawn arms: is its first choice good in another world?

`python -m benchmarks.analysis.drawn_arms 20 --policies lqg@tuned l1-adaptive@tuned` prints a line
for each arm, and the share of good choices.
"""

import argparse
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.analysis.recommend import Run, candidates, recommend
from benchmarks.analysis.statistics import proportion
from benchmarks.analysis.transfer import Runs
from benchmarks.run.runner import run as run_cells
from benchmarks.run.store import Result, Store
from benchmarks.run.suite import Cell, Suite
from fbl_gym.model.arm import ArmParameters
from fbl_gym.scenarios import Scenario, conditions, in_world
from fbl_gym.scenarios.classes import families

WITHIN = 1.5
"""A first choice is good if it errs at most WITHIN times as much as the best policy."""


@dataclass(frozen=True)
class CheckedChoice:
    """A recommendation on a drawn arm, checked in another world.

    Attributes:
        scenario: its name.
        choice: the first choice; empty: none is safe.
        best: the best policy in the other world.
        ratio: error of the first choice there, relative to that of the best policy there.
        diverged: number of diverged runs of the first choice there.
        ratios: error of each policy there, relative to that of the best, by name.
    """

    scenario: str
    choice: str
    best: str
    ratio: float
    diverged: int
    ratios: dict[str, float]


def check(
    number: int, policies: Sequence[str], runs: int, run: Run, world: str = "mujoco-lab"
) -> Iterator[CheckedChoice]:
    """Yield a check of the first choice, on some test seeds, for each of a number of drawn arms."""
    for i in range(number):
        base = draw(i)
        result = recommend(base, policies, runs, run)
        cells = Suite("check", tuple(policies), (in_world(base, world),), runs).cells
        results = [result for result in run(cells).values() if not result.error]
        names = [result.cell.policy.name for result in results]
        there = Runs.of([[result] for result in results])
        best = int(np.argmin(there.levels[:, 0]))
        logs = there.logs.mean(axis=(1, 2))
        ratios = dict(zip(names, np.exp(logs - logs[best]).tolist(), strict=True))
        if not result.safe:
            yield CheckedChoice(base.name, "", names[best], float("nan"), 0, ratios)
            continue
        first = names.index(result.choices[0].policy)
        diverged = int(there.diverged[first].sum())
        yield CheckedChoice(base.name, names[first], names[best], ratios[names[first]], diverged, ratios)


def draw(number: int) -> Scenario:
    """Return a scenario with a drawn arm and drawn conditions of the class `servo`."""
    rng = np.random.default_rng(number)
    arm = draw_arm(rng)
    family, severity = str(rng.choice([*families("servo")])), int(rng.integers(1, 4))
    return Scenario(name=f"drawn-{number}-{family}-{severity}", **conditions(arm, "servo", family, severity))


def draw_arm(rng: np.random.Generator) -> ArmParameters:
    """Return an arm of links of 1 to 30 kg and 0.2 to 1 m, between rods and point masses."""
    mass, length = np.exp(rng.uniform(np.log(1.0), np.log(30.0), 2)), rng.uniform(0.2, 1.0, 2)
    point = rng.uniform(0.0, 1.0, 2)
    shape = {"centre": tuple(0.5 + 0.5 * point), "inertia": tuple((1.0 - point) / 12.0)}
    return ArmParameters(mass[0], mass[1], length[0], length[1], **shape)  # type: ignore[arg-type]


def main(argv: Sequence[str] | None = None) -> None:
    """Print the check of each drawn arm, and the share of good first choices."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.analysis.drawn_arms", description=__doc__)
    parser.add_argument("arms", type=int, metavar="N", help="number of drawn arms")
    parser.add_argument("--policies", nargs="+", default=candidates(), metavar="POLICY", help="to choose from")
    parser.add_argument("--seeds", type=int, default=8, metavar="N", help="test seeds 0 to N-1 (8)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N", help="processes")
    parser.add_argument("--store", type=Path, default=Path("results/board"), metavar="DIR", help="folder of results")
    arguments = parser.parse_args(argv)
    store = Store(arguments.store)

    def run(cells: Sequence[Cell]) -> dict[str, Result]:
        return {result.cell.id: result for _, result in run_cells(cells, store, workers=arguments.workers)}

    rows = []
    for row in check(arguments.arms, arguments.policies, arguments.seeds, run):
        rows.append(row)
        choice = f"{row.choice}: {row.ratio:.2f} x, {row.diverged} diverged" if row.choice else "none is safe"
        print(f"{row.scenario}: {choice}; best in mujoco-lab: {row.best}", flush=True)
    if chosen := [row for row in rows if row.choice]:
        good = sum(row.ratio <= WITHIN for row in chosen)
        share = proportion(good, len(chosen))
        print(
            f"{good} of {len(chosen)} first choices within {WITHIN:g} times the best ({100 * share.low:.0f} to "
            f"{100 * share.high:.0f} %); none was safe on {len(rows) - len(chosen)} arms"
        )
        always = {
            policy: sum(row.ratios.get(policy, np.inf) <= WITHIN for row in chosen) for policy in arguments.policies
        }
        for policy in sorted(always, key=lambda policy: -always[policy])[:5]:
            print(f"on the same arms, always {policy}: {always[policy]} of {len(chosen)}")


if __name__ == "__main__":
    main()
