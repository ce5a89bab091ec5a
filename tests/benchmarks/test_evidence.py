"""Checks of the board: coverage, the sealed test, orders in two worlds, learning curves."""

import json
import re

import numpy as np
import pytest
from scipy.stats import kendalltau

from benchmarks.analysis.board import Board, assemble
from benchmarks.analysis.statistics import Estimate
from benchmarks.analysis.transfer import compare_halves, compare_orders
from benchmarks.cli import common
from benchmarks.cli.curves import read_groups
from benchmarks.policies.spec import resolve
from benchmarks.run.runner import run_cell
from benchmarks.run.suite import Suite
from benchmarks.studies import sealed
from fbl_gym import scenarios
from fbl_gym.scenarios.class_families import families
from tests import board_coverage

FAMILIES = tuple(families("servo"))
POLICIES = ("pd-gravity", "computed-torque", "oracle-flm")


def board(seeds):
    """A board of short episodes."""
    names = ("servo-nominal", "servo-noise-2")
    tasks = tuple(scenarios.get(name).replace(duration=1.0, name=f"{name}@short") for name in names)
    suite = Suite("short", POLICIES, tasks, seeds)
    return assemble([run_cell(cell) for cell in suite.cells], suite.cells)


def test_the_version_is_of_code_policies_scenarios_and_seeds():
    found = board(2)
    assert found.version == board(2).version
    assert found.version != board(3).version


def test_coverage_counts_the_intervals_that_hold():
    found = board(8)
    shares = board_coverage.coverage(found, 2)
    assert {name: share.shape for name, share in shares.items()} == dict.fromkeys(("error", "lost", "rank"), (2,))
    assert {*np.ravel([*shares.values()])} <= {0.0, 0.25, 0.5, 0.75, 1.0}
    holds = board_coverage._holds(Estimate(np.ones(2), np.ones(2), np.full(2, 2.0)), Estimate(np.array([2, 3]), 1, 1))
    assert holds.tolist() == [1.0, 0.0]


def test_the_sealed_test_is_drawn_from_a_number():
    tasks = {family: sealed.draw(0x0F, "servo", family) for family in FAMILIES}
    assert tasks == {family: sealed.draw(0x0F, "servo", family) for family in FAMILIES}
    assert len({task.arm for task, _ in tasks.values()}) == len(FAMILIES)
    for family, (task, seeds) in tasks.items():
        other, others = sealed.draw(0x1F, "servo", family)
        assert other.arm != task.arm
        assert (task.reference.kind, other.reference == task.reference) == ("array", False)
        assert set(seeds) != set(others)
        assert len(set(seeds)) == 32
        assert all(30_000 <= seed < 40_000 for seed in seeds)


def test_a_draw_that_cannot_be_made_is_refused(tmp_path, capsys):
    for number, message in (
        ("-1", "0 or more, got .-1"),
        ("0x1g", "got .0x1g"),
        ("0x1", "no result yet.*computes the"),
    ):
        with pytest.raises(SystemExit):
            sealed.main(["--number", number, "--policies", "zero", "--store", str(tmp_path)])
        assert re.search(message, capsys.readouterr().err)


def test_tau_of_the_sealed_test():
    found = board(2)
    rows = [int(i) for i in np.argsort(-found.error().value)]
    taus = sealed.tau(found, rows, FAMILIES, np.repeat([[3.0], [2.0], [1.0]], len(FAMILIES), axis=1))
    assert taus["all"] == pytest.approx(1.0)
    assert set(taus) == {"all", "first ten", "noise"}


def rows_of(errors, diverged=0.0, sizes=None):
    """Return a board of errors [members x seeds]; `sizes` has the number of members of each row."""
    errors = np.asarray(errors)[:, None]
    runs = {"error_pct": errors, "resolution_pct": 0 * errors, "diverged": np.broadcast_to(diverged, errors.shape)}
    rows = {f"row {i}": (resolve("zero"),) * size for i, size in enumerate(sizes or (1,) * len(errors))}
    return Board(rows, ("nominal",), (*range(errors.shape[-1]),), runs, np.zeros(len(rows)), {})


def agreement(first, second):
    return compare_orders(first, second, first.policies)


def test_tau_is_kendalls_where_all_pairs_are_separated():
    rng = np.random.default_rng(0)
    for _ in range(20):
        first, second = rng.permutation(8.0 * np.arange(1, 9)), rng.permutation(8.0 * np.arange(1, 9))
        spread = rng.uniform(0.99, 1.01, 16)
        one, other = rows_of(np.outer(first, spread)), rows_of(np.outer(second, spread))
        found = agreement(one, other)
        assert found.pairs == found.clear_pairs == 28
        assert found.tau == found.clear_tau == pytest.approx(kendalltau(first, second).statistic)
    assert compare_halves(one, one.policies) == agreement(one, one)
    assert compare_orders(one, other, one.policies[:3]).pairs == 3


def test_an_agent_counts_once_with_all_its_training_seeds():
    """Its two seeds have the errors 1 and 9, so their mean is between the laws of 2 and 4."""
    spread = np.linspace(0.99, 1.01, 8)
    alone, agent = rows_of(np.outer([2, 3, 4], spread)), rows_of(np.outer([2, 1, 9, 4], spread), sizes=(1, 2, 1))
    assert agreement(agent, alone) == agreement(alone, alone)
    assert agreement(agent, alone).clear_pairs == 3


def test_pairs_that_one_world_does_not_separate_are_not_clear():
    rng = np.random.default_rng(1)
    alike = rows_of(rng.lognormal(size=(2, 400)))
    apart = np.array([[1.0], [5.0]]) * rng.lognormal(sigma=0.1, size=(2, 400))
    apart, turned = rows_of(apart), rows_of(apart[::-1])
    assert agreement(apart, turned) == agreement(turned, apart)
    assert agreement(apart, turned).tau == -1.0
    found = agreement(alike, apart)
    assert found.clear_pairs == compare_halves(alike, alike.policies).clear_pairs == 0
    assert np.isnan(found.clear_tau)
    assert abs(found.tau) == found.pairs == 1


def test_a_policy_that_diverges_on_both_sides_has_no_place():
    errors = np.outer([1.0, 2.0, 90.0], np.linspace(0.9, 1.1, 8))
    whole, lost = rows_of(errors), rows_of(errors, np.array([0.0, 0.0, 1.0])[:, None, None])
    assert [agreement(*sides).pairs for sides in ((whole, whole), (lost, lost), (lost, whole))] == [3, 1, 3]


def test_the_command_prints_both_boards_and_tau(tmp_path, fbl_gym):
    pytest.importorskip("mujoco")
    broken = tmp_path / "broken.py"
    broken.write_text("def make_policy(interface):\n    raise ValueError('no gains')\n")
    (tmp_path / "short.toml").write_text('base = "servo-nominal"\nduration = 2.0\n')
    base = f"leaderboard --world mujoco-lab --workers 1 --store {tmp_path} --scenarios {tmp_path}/short.toml"
    out = fbl_gym(f"{base} --policies computed-torque pd-gravity oracle-flm {broken} --seeds 4", 1).out
    lines = [words for text in out.splitlines() if (words := text.split())]
    assert next(words for words in lines if words[0] == "mujoco-lab")[1] == "1.00"
    places = [tuple(words[:2]) for words in lines if words[0] in ("computed-torque", "pd-gravity")]
    assert places == [("computed-torque", "1"), ("pd-gravity", "2")] * 2
    assert any(words[0] == "(oracle-flm)" for words in lines)
    assert f"Left out: {broken}: ValueError: no gains" in " ".join(out.split())
    assert "--seeds must be at least 4" in fbl_gym(f"{base} --policies pd-gravity --seeds 2", 2).err


def test_limits_reach_the_cells_of_both_worlds(tmp_path, fbl_gym, monkeypatch):
    def run(cells, *_, limits, **__):
        raise ValueError(f"{len(cells)} cells, {limits.seconds:g} s, {limits.gigabytes:g} GB")

    monkeypatch.setattr(common, "run", run)
    line = f"leaderboard --world mujoco --policies pd-gravity --scenarios servo-nominal --seeds 4 --store {tmp_path}"
    assert "2 cells, 7 s, 2 GB" in fbl_gym(f"{line} --cell-timeout 7 --cell-memory 2", 2).err


@pytest.fixture
def trained(tmp_path):
    """Two runs of PPO, with the errors 8, 2, 4 and 8, 8, 8 at 100, 200, 300 steps, and a slower one of SAC."""
    for name, seed, errors, cpu in (("ppo-0", 0, (8, 2, 4), 1), ("ppo-1", 1, (8, 8, 8), 1), ("sac-0", 0, (8, 1, 1), 5)):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "run.json").write_text(json.dumps({"algorithm": name[:3], "seed": seed}))
        rows = [f"{100 * i},{9 * i},{cpu * i},{error}" for i, error in enumerate(errors, 1)]
        (folder / "curve.csv").write_text("\n".join(["steps,wall_s,cpu_s,validation_mrad", *rows]) + "\n")
    return [tmp_path / name for name in ("ppo-0", "ppo-1", "sac-0")]


def test_runs_are_grouped_over_their_seeds_and_keep_their_best_agent(trained):
    ppo, sac = read_groups(trained)
    assert (ppo.name, len(ppo.runs), sac.name, len(sac.runs)) == ("ppo", 2, "sac", 1)
    np.testing.assert_array_equal(ppo.errors("steps", np.array([50, 100, 250, 300])), [[8, 8, 2, 2], [8, 8, 8, 8]])
    assert ppo.estimate("steps", np.array([300])).value == pytest.approx([4.0])


def test_the_command_compares_after_equal_steps_and_equal_time(trained, tmp_path, fbl_gym):
    out = fbl_gym(["curves", *map(str, trained), "--plot", str(tmp_path / "curves.svg")]).out
    assert all(f"after {budget}" in out for budget in ("300 steps", "3 s"))
    assert "ppo" in (tmp_path / "curves.svg").read_text()


def test_runs_that_cannot_be_compared_are_refused(trained, tmp_path, fbl_gym):
    (tmp_path / "sac-0" / "run.json").write_text(json.dumps({"algorithm": "sac", "seed": 0, "scenarios": ["nominal"]}))
    assert "must have trained on the scenarios of the first RUN" in fbl_gym(["curves", *map(str, trained)], 2).err
    for wrong, text in ((tmp_path, "RUN must be a folder of fbl-gym train"), (trained[0], "RUN must differ")):
        assert text in fbl_gym(["curves", str(trained[0]), str(wrong)], 2).err
