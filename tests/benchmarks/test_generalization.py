"""The ranges of the uncertainty radius: their cells, their columns, and that they are kept in the store."""

import csv

import numpy as np
import pytest

from benchmarks import cli
from benchmarks.analysis.board import assemble
from benchmarks.analysis.generalization import RADII, measure_ranges, range_cells
from benchmarks.analysis.statistics import geometric_mean
from benchmarks.policies.configuration import configuration
from benchmarks.policies.spec import resolve
from benchmarks.report import markdown
from benchmarks.rl.agent import saved_agent
from benchmarks.rl.policy import SHIPPED, shipped
from benchmarks.run import runner
from benchmarks.run.cell import run_cell
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell
from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios

SEEDS = (0, 1, 2)
POLICIES = ("cascade-flm", "ppo-residual", "oracle-flm")


def test_a_split_is_the_scenario_of_training_at_its_radius():
    assert [*RADII] == ["interpolation", "in distribution", "extrapolation", "far extrapolation"]
    for name, radius in RADII.items():
        (cell,) = range_cells("cascade-flm", name, SEEDS)
        env = TwoLinkArmVectorEnv(400, cell.scenario)
        env.reset(seed=0)
        ratios = np.hstack([env.truth.masses / [20.0, 15.0], env.truth.lengths / [0.7, 0.5]])
        np.testing.assert_allclose([ratios.min(), ratios.max()], [1 / (1 + radius), 1 + radius], rtol=0.02)
        same = scenarios.get("everything-2").replace(parameter_error=cell.scenario.parameter_error)
        assert cell.scenario.replace(name="everything-2") == same
    # What was trained on is a cell of the board already.
    assert range_cells("cascade-flm", "in distribution", SEEDS) == [Cell("cascade-flm", "everything-2", SEEDS)]


def test_an_agent_is_named_with_its_training_seed():
    assert [cell.policy.name for cell in range_cells("ppo-residual", "extrapolation", SEEDS)] == [
        f"ppo-residual@{seed}" for seed in shipped()["ppo-residual"]
    ]
    interface = TwoLinkArmEnv().interface
    expected = configuration(saved_agent(interface, str(SHIPPED / "ppo-residual" / "2")))
    assert configuration(resolve("ppo-residual@2").make(interface)) == expected
    assert resolve("ppo-residual@2").kind == "learned"
    assert resolve("ppo-residual@2").access == resolve("ppo-residual").access == "nominal"
    with pytest.raises(ValueError, match="unknown training seed 9"):
        resolve("ppo-residual@9").make(interface)
    with pytest.raises(ValueError, match="unknown policy 'pid-flm@3'"):
        resolve("pid-flm@3")


def test_columns_against_their_definition_and_kept_in_the_store(tmp_path, monkeypatch):
    store = Store(tmp_path)
    board = assemble([run_cell(Cell(policy, "nominal", SEEDS)) for policy in POLICIES])
    found = measure_ranges(board, store, workers=1)
    assert [*found] == [*RADII]
    training = shipped()["ppo-residual"]
    assert len(store.files()) == len(RADII) * (2 + len(training))
    task = range_cells("cascade-flm", "extrapolation", SEEDS)[0].scenario
    runs = [[row["error_pct"] for row in measure(rollout("cascade-flm", task, SEEDS))]]
    once = np.ones((1, 1, 1))
    assert found["extrapolation"].error.value[0] == geometric_mean(runs, once)[0]
    runs = [
        [row["error_pct"] for row in measure(rollout("ppo-residual", task, SEEDS, {"seed": seed}))] for seed in training
    ]
    assert found["extrapolation"].error.value[1] == pytest.approx(
        geometric_mean([[run] for run in runs], once[None])[0], rel=1e-12
    )
    for measured in found.values():
        assert measured.error.value.shape == measured.diverged.shape == (len(POLICIES),)
        assert np.all((measured.error.low <= measured.error.value) & (measured.error.value <= measured.error.high))
    monkeypatch.setattr(runner, "compute", lambda *_: pytest.fail("it was run again"))
    again = measure_ranges(board, store, workers=1)
    for name in RADII:
        np.testing.assert_array_equal(again[name].error.value, found[name].error.value)
        np.testing.assert_array_equal(again[name].error.low, found[name].error.low)


def test_runs_that_diverge_are_counted_and_said(tmp_path):
    """An arm without torque falls now and then; of the arms of the last range, more often."""
    store, seeds = Store(tmp_path / "store"), tuple(range(24))
    board = assemble([run_cell(Cell("zero", "everything-2", seeds))])
    found = measure_ranges(board, store, workers=1)
    for name, measured in found.items():
        trace = rollout("zero", range_cells("zero", name, seeds)[0].scenario, seeds)
        assert measured.diverged[0] == (~trace.alive[-1]).mean()
    assert found["far extrapolation"].diverged[0] > 0
    assert f"{100 * found['far extrapolation'].diverged[0]:.2g} % diverged" in markdown.leaderboard(board, found)


def test_every_report_has_the_columns(tmp_path, capsys):
    store, out = str(tmp_path / "store"), tmp_path / "out"
    some = ["--policies", *POLICIES, "--scenarios", "nominal", "--seeds", "2", "--store", store, "--workers", "1"]
    assert cli.main(["leaderboard", *some]) == 0
    capsys.readouterr()
    assert cli.main(["report", *some, "--out", str(out), "--generalization"]) == 0
    shown = capsys.readouterr().out
    header = (out / "board.md").read_text().splitlines()[0]
    assert "| nominal | interpolation | in distribution | extrapolation | far extrapolation |" in header
    with (out / "generalization.csv").open() as file:
        rows = {row["policy"]: row for row in csv.DictReader(file)}
    assert set(rows) == set(POLICIES)
    page = (out / "board.html").read_text()
    for name, radius in RADII.items():
        assert name in shown
        assert f'data-sort="range-{name}"' in page
        assert f"off by factors of up to {1 + radius:g}" in page
        low, value, high = (float(rows["ppo-residual"][f"{name}{end}"]) for end in (": low", "", ": high"))
        assert rows["ppo-residual"][f"{name}: diverged"] == "0"
        assert 0.0 < low <= value <= high
    # A number can be checked as any row of the board.
    assert cli.main(["verify", "ppo-residual@2/everything-2, radius 1", "--store", store]) == 0
    assert "holds, bit for bit" in capsys.readouterr().out
    # Without the option, nothing of it.
    assert cli.main(["report", *some, "--out", str(tmp_path / "plain")]) == 0
    assert not (tmp_path / "plain" / "generalization.csv").exists()
    assert "extrapolation" not in (tmp_path / "plain" / "board.md").read_text()
