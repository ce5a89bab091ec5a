"""The commands that check the board: coverage, where rows end, and the sealed test."""

import dataclasses

import numpy as np
import pytest

from benchmarks.analysis import ends, sealed
from benchmarks.analysis.board import assemble
from benchmarks.analysis.statistics import Estimate
from benchmarks.analysis.transfer import Runs
from benchmarks.run.cell import run_cell
from benchmarks.run.suite import Cell, Suite
from fbl_gym import scenarios
from fbl_gym.scenarios.classes import CLASSES, families
from tests import board_coverage

FAMILIES = tuple(families("servo"))
POLICIES = ("pd-gravity", "computed-torque", "oracle-flm")


def board(seeds, *more, ceilings=()):
    """A board of short episodes; one scenario has more seeds."""
    tasks = [
        scenarios.get(name).replace(duration=1.0, name=f"{name}@short") for name in ("servo-nominal", "servo-noise-2")
    ]
    suite = Suite("short", POLICIES, tuple(tasks), seeds, more_seeds=dict(more), ceilings=dict(ceilings))
    return assemble([run_cell(cell) for cell in suite.cells], suite.cells)


def test_a_scenario_with_more_seeds_tells_how_often_runs_diverge():
    found = board(3, ("servo-noise-2@short", 6))
    assert found.seeds == (0, 1, 2)
    assert found.runs["error_pct"].shape == (3, 2, 3)
    assert {k: flags.shape for k, flags in found.flags.items()} == {1: (3, 6)}
    beside = board(3, ("servo-noise-2@short", 6), ceilings=[("oracle-elastic", ("servo-noise-2@short",))])
    assert {k: flags.shape for k, flags in beside.flags.items()} == {1: (3, 6)}  # a ceiling has three seeds there
    lost = dataclasses.replace(found, flags={1: np.array([[0.0] * 6, [0.0] * 5 + [1.0], [0.0] * 6])})
    assert lost.diverged.value.tolist() == [0.0, 1 / 12, 0.0]
    assert lost.score.value[1] < found.score.value[1]
    assert lost.error.value[1] == found.error.value[1]


def test_the_version_is_of_code_policies_scenarios_and_seeds():
    found = board(2)
    assert found.version == board(2).version
    assert found.version != board(3).version


def test_coverage_counts_the_intervals_that_hold():
    found = board(8)
    shares = board_coverage.coverage(found, 2)
    assert set(shares) == set(board_coverage.QUANTITIES)
    for share in shares.values():
        assert share.shape == (2,)
        assert set(share) <= {0.0, 0.25, 0.5, 0.75, 1.0}
    one = np.ones(1)
    assert board_coverage._holds(Estimate(one, one, 2 * one), Estimate(2 * one, one, one)) == [1.0]
    assert board_coverage._holds(Estimate(one, one, 2 * one), Estimate(3 * one, one, one)) == [0.0]


def test_where_a_row_ends():
    (result,) = (run_cell(Cell("pd-gravity", scenarios.get("nominal").replace(duration=0.5), (0, 1))),)

    def of(factor, lost=0.0):
        rows = tuple({**row, "error_pct": factor * row["error_pct"], "diverged": lost} for row in result.rows)
        return dataclasses.replace(result, rows=rows)

    assert ends.end({1: of(1.0), 2: of(1.9)}) == "–"
    assert ends.end({1: of(1.0), 2: of(2.1), 4: of(9.0)}) == "2: 2.1 ×"
    assert ends.end({1: of(1.0), 2: of(1.5, lost=0.5)}) == "2: 50 % lost"
    assert ends.end({1: dataclasses.replace(result, rows=(), error="no")}) == "1: fails"


@pytest.mark.parametrize("robot", CLASSES)
def test_each_push_is_another_scenario(robot):
    for tasks in ends.axes(robot).values():
        assert len({str(task.to_dict()) for task in tasks.values()}) == len(tasks)


def test_the_sealed_test_is_drawn_from_the_version():
    tasks = {family: sealed.draw("0f" * 6, "servo", family) for family in FAMILIES}
    assert tasks == {family: sealed.draw("0f" * 6, "servo", family) for family in FAMILIES}
    assert len({task.arm for task, _ in tasks.values()}) == len(FAMILIES)
    for family, (task, seeds) in tasks.items():
        other, others = sealed.draw("1f" * 6, "servo", family)
        assert other.arm != task.arm
        assert set(seeds) != set(others)
        assert len(set(seeds)) == 32
        assert all(30_000 <= seed < 40_000 for seed in seeds)


def test_tau_of_the_sealed_test():
    found = board(2)
    errors = np.broadcast_to(np.array([3.0, 2.0, 1.0])[:, None, None], (3, len(FAMILIES), 4))
    rows = [int(i) for i in np.argsort(-found.error.value)]
    taus = sealed.tau(found, rows, FAMILIES, Runs(errors, np.zeros_like(errors)))
    assert taus["all"] == pytest.approx(1.0)
    assert set(taus) == {"all", "noise"}
