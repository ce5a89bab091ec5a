"""Boards against their definitions; coverage, the sealed test, orders in two worlds, learning curves."""

import dataclasses
import functools
import io
import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy.stats import kendalltau

from benchmarks.analysis import board as analysis_board
from benchmarks.analysis.board import Board, assemble, family_of, tier_of
from benchmarks.analysis.statistics import Estimate
from benchmarks.analysis.transfer import compare_halves, compare_orders
from benchmarks.cli import common
from benchmarks.cli.curves import read_groups
from benchmarks.policies.spec import resolve
from benchmarks.report import markdown, terminal
from benchmarks.report.columns import NONE, columns, leaders
from benchmarks.run.cell import Cell
from benchmarks.run.runner import run_cell
from benchmarks.run.suite import Suite, load
from benchmarks.studies import sealed
from fbl_gym import scenarios
from fbl_gym.scenarios.class_families import families


@functools.cache
def board(seeds=8, families=("nominal", "mass-error", "length-error")):
    policies = ("zero", "pid-flm", "cascade-flm", "oracle-flm")
    return assemble([run_cell(cell) for cell in load("ideal").build(policies, families, seeds).cells])


def test_the_board_against_its_definitions():
    found = board()
    assert found.errors.shape == (4, 7, 8)
    error = found.error()
    np.testing.assert_allclose(error.value, np.exp(np.log(found.errors).mean(axis=(1, 2))))
    assert np.all((error.low < error.value) & (error.value < error.high))
    np.testing.assert_allclose(found.worst, np.sort(found.errors.reshape(4, -1))[:, -3:].mean(axis=1))
    np.testing.assert_allclose(found.times_oracle(), error.value / error.value[3])
    assert found.effort[3] == 1.0
    assert [found.policies[i] for i in found.order] == ["cascade-flm", "pid-flm", "zero", "oracle-flm"]
    assert found.ranked == [0, 1, 2]
    np.testing.assert_array_equal(found.rank.value, [3, 2, 1, np.nan])
    assert found.families == {"nominal": [0], "mass-error": [1, 2, 3], "length-error": [4, 5, 6]}


def printed(found):
    """The board as it is on a wide terminal."""
    terminal.leaderboard(Console(file=(file := io.StringIO()), width=400), found)
    return file.getvalue()


def changed(found, **metrics):
    """A board with other metrics, each a number for each policy."""
    runs = {name: np.broadcast_to(np.reshape(x, (-1, 1, 1)), found.errors.shape) for name, x in metrics.items()}
    return dataclasses.replace(found, runs=found.runs | runs)


def test_each_percent_of_lost_runs_doubles_the_error_that_ranks():
    """One lost run of 400 is a quarter of a percent, so it costs a factor of 2^0.25 = 1.19."""
    found = board(families=("nominal",), seeds=4)
    runs = {name: np.tile(values, (1, 1, 100)) for name, values in found.runs.items()}
    many = changed(dataclasses.replace(found, runs=runs, seeds=tuple(range(400))), error_pct=[9.0, 1.0, 0.9, 0.5])
    assert many.order[:3] == [2, 1, 0]
    for lost, order in ((0.0, [2, 1, 0]), (1.0, [1, 2, 0])):
        flags = np.zeros((4, 1, 400))
        flags[2, 0, 0] = lost
        one = dataclasses.replace(many, runs=many.runs | {"diverged": flags})
        np.testing.assert_allclose(one.times_oracle(), np.array([9.0, 1.0, 0.9 * 2 ** (lost / 4), 0.5]) / 0.5)
        assert one.order[:3] == order
    share = one.lost
    np.testing.assert_allclose([share.value[2], share.low[2], share.high[2]], [1 / 400, 6.329e-05, 0.01385], rtol=1e-3)
    assert share.high[1] == pytest.approx(1 - 0.025 ** (1 / 400))  # none seen is not none
    assert (one.rank.low[2], one.rank.high[2]) == (1.0, 2.0)  # a third of the resamples has no lost run
    np.testing.assert_array_equal(one.error().value, many.error().value)


def test_policies_with_the_same_runs_share_their_rank_and_nan_is_refused():
    tied = changed(board(families=("nominal",)), error_pct=[2.0, 1.0, 1.0, 0.5])
    for end in (tied.rank.low, tied.rank.value, tied.rank.high):
        np.testing.assert_array_equal(end, [3.0, 1.5, 1.5, np.nan])
    with pytest.raises(ValueError, match="every run must have a number"):
        changed(tied, error_pct=[2.0, np.nan, 1.0, 0.5]).error()


def test_a_row_of_several_members_is_their_mean():
    """Each number against the rows of its members; the intervals against members drawn again."""
    single = board(families=("nominal", "mass-error-1"), seeds=4)
    zero, *pair, oracle = single.specs
    rows = {"zero": (zero,), "pair": tuple(pair), "oracle-flm": (oracle,)}
    found = dataclasses.replace(single, rows=rows, decision_us=single.decision_us[:3])
    error, alone = found.error(), single.error()
    for name in ("value", "low", "high"):
        np.testing.assert_allclose(getattr(error, name)[::2], getattr(alone, name)[::3])
    means = [np.sqrt(x[1:3].prod()) for x in (alone.value, single.mrad())]
    expected = [*means, single.effort[1:3].mean(), single.errors[1:3].max()]
    assert [x[1] for x in (error.value, found.mrad(), found.effort, found.worst)] == pytest.approx(expected)
    assert error.low[1] <= alone.value[2] < alone.value[1] <= error.high[1]
    assert [found.policies[i] for i in found.order] == ["pair", "zero", "oracle-flm"]
    # In each resample, the row has one of its members twice, or both.
    drawn, one, other = np.log(found.penalized()[:, 1]), *np.log(single.penalized()[:, 1:3]).T
    kinds = np.array([one, (one + other) / 2, other])
    kind = np.abs(kinds - drawn).argmin(axis=0)
    np.testing.assert_allclose(kinds[kind, range(len(kind))], drawn)
    np.testing.assert_allclose(np.bincount(kind[1:]) / 2000, [0.25, 0.5, 0.25], atol=0.04)
    assert "| `pair`, 2 training seeds |" in markdown.leaderboard(found)


def test_a_member_that_fails_or_lacks_a_result_counts_for_its_row():
    """A row that fails in a scenario keeps its place, counts there as the motionless baseline, and is marked."""
    names = ("oracle-flm", "pid-flm", "zero", "cascade-flm")
    members = [dataclasses.replace(resolve(name), rows=("pair",) if name in names[2:] else ()) for name in names]
    results = [run_cell(Cell(spec, task, (0, 1))) for spec in members for task in ("nominal", "noise-1")]
    assert assemble(results).policies == ("oracle-flm", "pid-flm", "pair")
    assert assemble(results[:-1], [results[-1].cell]).incomplete == {"pair": "cascade-flm: no result yet for noise-1"}
    for k in (3, 7):  # in noise-1
        results[k] = dataclasses.replace(results[k], rows=(), error="RuntimeError: no")
    found = assemble(results)
    assert found.failed == {row: {"noise-1": "RuntimeError: no"} for row in ("pid-flm", "pair")}
    np.testing.assert_array_equal(found.errors[1:, 1], found.runs["baseline_error_pct"][1:, 1])
    np.testing.assert_array_equal(found.lost.value, [0.0, 0.5, 0.5])  # of two members, each failed in one of two
    assert "pid-flm counts as the motionless baseline in noise-1: RuntimeError: no" in found.remarks
    assert "`pid-flm`, motionless in 1 of 2 |" in markdown.leaderboard(found)


def test_a_tier_ranks_and_the_others_stand_beside_it(monkeypatch):
    monkeypatch.setattr(analysis_board, "tier_of", lambda name: "servo-surprise" if name == "noise-1" else "servo")
    found = board(families=("noise-1", "nominal"), seeds=3)
    assert found.tiers == {"servo": [1], "servo-surprise": [0]}
    alone = board(families=("nominal",), seeds=3)
    for one, other in ((found.error(), alone.error()), (found.lost, alone.lost), (found.rank, alone.rank)):
        np.testing.assert_array_equal(one.value, other.value)
    assert "1 scenario, 1 of servo-surprise without a rank, 3 seeds each" in printed(found)
    titles = [column.title for column in columns(found) if column.tables != NONE]
    surprise = ["servo-surprise error %", "servo-surprise × oracle"]
    assert titles[:5] == ["rank", "policy", "error %", "lost runs %", "× oracle"]
    page = Path(__file__).parents[2].joinpath("docs/reference/columns.md").read_text()
    documented = {name for row in re.findall(r"^\| (.+?) \|", page, flags=re.M) for name in row.split(", ")}
    assert {*titles} - documented == {*surprise, "nominal"}


def test_a_board_shows_violations_where_scenarios_have_constraints():
    found = board(families=("nominal",), seeds=3)
    assert "violation" not in [column.key for column in columns(found)]
    found = changed(found, violation_pct=[12.5, np.nan, 12.5, 12.5])  # the second failed
    (column,) = [column for column in columns(found) if column.key == "violation"]
    assert [column.text(i) for i in range(3)] == ["12", "–", "12"]


def test_a_policy_without_results_is_left_out_and_named():
    some = [run_cell(cell) for cell in load("ideal").build(["zero", "pid-flm"], ["nominal", "noise-1"], 2).cells]
    found = assemble([*some[:3]])
    assert (found.policies, found.incomplete) == (("zero",), {"pid-flm": "no result yet for noise-1"})
    assert "oracle" not in markdown.leaderboard(found)  # there is none
    assert "Left out: pid-flm: no result yet for noise-1" in printed(found)
    with pytest.raises(ValueError, match="results must be of the same seeds"):
        assemble([some[0], run_cell(Cell("zero", "noise-1", (0,)))])
    no = [dataclasses.replace(result, rows=(), error="RuntimeError: no") for result in some]
    found = assemble([some[0], no[1], some[2], no[3]])
    assert found.incomplete == {"pid-flm": "RuntimeError: no"}
    with pytest.raises(ValueError, match="no policy with a result for every scenario"):
        assemble(no)


def oracles():
    """A board without a ranked policy."""
    return assemble([run_cell(cell) for cell in load("ideal").build(["oracle-flm"], ["nominal"], 2).cells])


def test_the_worst_family_is_beside_the_best_ranked_row():
    """Cascade-flm errs least but in mass-error, where it has twice the error of pid-flm; an oracle does not count."""
    found = board()
    errors = np.full(found.errors.shape, 4.0)
    errors[2, :1], errors[2, 1:4], errors[2, 4:], errors[3] = 1.0, 8.0, 2.0, 0.1
    found = dataclasses.replace(found, runs=found.runs | {"error_pct": errors})
    column = next(each for each in columns(found) if each.key == "worst-family")
    assert [column.cell(i) for i in range(4)] == ["4, nominal", "4, nominal", "2, mass-error", "0.1, nominal"]
    assert "worst-family" not in {each.key for each in columns(oracles())}
    cells = load("ideal").build(["oracle-flm", "zero"], ["nominal"], 2).cells
    assert leaders(assemble([run_cell(cell) for cell in cells])).rows[0][-2:] == ["–", "–"]


def test_first_rows_have_the_delay_margin_where_there_is_one():
    found = changed(board(), delay_samples=[np.nan, 0.25, 1.5, np.nan])
    rows = "".join(markdown.first_rows({"ideal": found}).splitlines()[2:])
    expected = "| 1 | `cascade-flm` E % · 1.5 || 2 | `pid-flm` E % · 0.25 || 3 | `zero` E % |"
    assert re.sub(r"[\d.]+ %", "E %", rows) == expected


def test_the_family_and_the_tier_of_a_scenario():
    own = {name: (name, "ideal") for name in ("paper-3a", "mine", "mass-error-2~3f9a20")}
    named = {"everything-2@mujoco-lab": ("everything", "worlds"), "noise-1": ("noise", "ideal")}
    for name, expected in (own | named).items():
        assert (family_of(name), tier_of(name)) == expected


# Checks of the board.


FAMILIES = tuple(families("servo"))


def short_board(seeds):
    """A board of short episodes."""
    names = ("servo-nominal", "servo-noise-2")
    tasks = tuple(scenarios.get(name).replace(duration=1.0, name=f"{name}@short") for name in names)
    suite = Suite("short", ("pd-gravity", "computed-torque", "oracle-flm"), tasks, seeds)
    return assemble([run_cell(cell) for cell in suite.cells], suite.cells)


def test_the_version_is_of_code_policies_scenarios_and_seeds():
    found = short_board(2)
    assert found.version == short_board(2).version
    assert found.version != short_board(3).version


def test_coverage_counts_the_intervals_that_hold():
    found = short_board(8)
    study = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "board_coverage.py"))
    shares = study["coverage"](found, 2)
    assert {name: share.shape for name, share in shares.items()} == dict.fromkeys(("error", "lost", "rank"), (2,))
    assert {*np.ravel([*shares.values()])} <= {0.0, 0.25, 0.5, 0.75, 1.0}
    holds = study["_holds"](Estimate(np.ones(2), np.ones(2), np.full(2, 2.0)), Estimate(np.array([2, 3]), 1, 1))
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


def test_a_draw_that_cannot_be_made_is_refused(tmp_path, capsys, monkeypatch):
    lacking = ("0x1", "no result yet.*computes the"), ("0x1", "--policies must have one that is ranked and has results")
    for given, message in (("-1", "0 or more, got .-1"), ("0x1g", "got .0x1g"), *lacking):
        with pytest.raises(SystemExit):
            sealed.main(["--number", given, "--policies", "zero", "--store", str(tmp_path)])
        assert re.search(message, capsys.readouterr().err)
        monkeypatch.setattr(sealed, "assemble", (lambda *_: oracles()) if given == "0x1" else assemble)


def test_tau_of_the_sealed_test():
    found = short_board(2)
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
    np.testing.assert_equal(dataclasses.astuple(compare_orders(one, other, ())), (np.nan, 0, np.nan, 0))


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
    assert ppo.estimate("steps", np.array([50, 100, 250, 300])).value == pytest.approx([8.0, 8.0, 4.0, 4.0])


def test_the_command_compares_after_equal_steps_and_equal_time(trained, tmp_path, fbl_gym):
    out = fbl_gym(["curves", *map(str, trained), "--plot", str(tmp_path / "curves.svg")]).out
    assert all(f"after {budget}" in out for budget in ("300 steps", "3 s"))
    assert "ppo" in (tmp_path / "curves.svg").read_text()


def test_runs_that_cannot_be_compared_are_refused(trained, tmp_path, fbl_gym):
    (tmp_path / "sac-0" / "run.json").write_text(json.dumps({"algorithm": "sac", "seed": 0, "scenarios": ["nominal"]}))
    assert "must have trained on the scenarios of the first RUN" in fbl_gym(["curves", *map(str, trained)], 2).err
    (tmp_path / "sac-0" / "curve.csv").write_text("steps,wall_s,cpu_s,validation_mrad\n")
    no_run = "RUN must be a folder of fbl-gym train"
    for wrong, text in ((tmp_path, no_run), (tmp_path / "sac-0", no_run), (trained[0], "RUN must differ")):
        assert text in fbl_gym(["curves", str(trained[0]), str(wrong)], 2).err
