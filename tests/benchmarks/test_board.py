"""Suites, boards, reports and the command line, run as a user runs them."""

import csv
import dataclasses
import functools
import io
import itertools
import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from benchmarks.agents.policy import SHIPPED, best_seed, shipped
from benchmarks.analysis import board as analysis_board
from benchmarks.analysis.board import assemble, family_of, tier_of
from benchmarks.policies.spec import resolve
from benchmarks.report import markdown, terminal
from benchmarks.report.columns import NONE, columns
from benchmarks.run.cell import Cell
from benchmarks.run.contract import check
from benchmarks.run.expansion import members
from benchmarks.run.metrics import METRICS, measure
from benchmarks.run.rollout import rollout
from benchmarks.run.runner import run_cell
from benchmarks.run.store import Store
from benchmarks.run.suite import SHORT_SEEDS, SUITES, Suite, load
from benchmarks.seeds import SPLITS
from fbl_gym import TwoLinkArmEnv, scenarios


def test_a_diverged_lane_stays_dead_and_leaves_the_others_alone():
    scenario = scenarios.get("everything-3").replace(duration=0.4, limits={"velocity": 4.0})
    found = rollout("zero", scenario, range(16))
    dead = ~found.alive[-1]
    assert dead.any()
    assert np.all(np.diff(found.alive.astype(int), axis=0) <= 0)
    alive = int(np.flatnonzero(~dead)[0])
    np.testing.assert_array_equal(rollout("zero", scenario, [alive]).position[:, 0], found.position[:, alive])
    assert [row["diverged"] for row in measure(found)] == list(dead.astype(float))
    # What was asked of it goes on, and is what was asked of the others.
    np.testing.assert_array_equal(found.reference, rollout("pd-gravity", scenario, range(16)).reference)


SOME = ["--policies", "zero", "pid-flm", "cascade-flm", "oracle-flm"]


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
    np.testing.assert_array_equal(found.rank.value, [3, 2, 1])
    assert found.families == {"nominal": [0], "mass-error": [1, 2, 3], "length-error": [4, 5, 6]}


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
        np.testing.assert_array_equal(end, [3.0, 1.5, 1.5])
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
    assert error.value[1] == pytest.approx(np.sqrt(alone.value[1:3].prod()))
    assert found.mrad()[1] == pytest.approx(np.sqrt(single.mrad()[1:3].prod()))
    assert found.effort[1] == pytest.approx(single.effort[1:3].mean())
    assert found.worst[1] == pytest.approx(single.errors[1:3].max())
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
    assert "pid-flm counts as the motionless baseline in noise-1: RuntimeError: no" in found.remarks
    assert "`pid-flm`, motionless in 1 of 2 |" in markdown.leaderboard(found)


def test_a_tier_ranks_and_the_others_stand_beside_it(monkeypatch):
    monkeypatch.setattr(analysis_board, "tier_of", lambda name: "servo-surprise" if name == "noise-1" else "servo")
    found = board(families=("noise-1", "nominal"), seeds=3)
    assert found.tiers == {"servo": [1], "servo-surprise": [0]}
    alone = board(families=("nominal",), seeds=3)
    for one, other in ((found.error(), alone.error()), (found.lost, alone.lost), (found.rank, alone.rank)):
        np.testing.assert_array_equal(one.value, other.value)
    titles = [column.title for column in columns(found) if column.tables != NONE]
    surprise = ["servo-surprise error %", "servo-surprise × oracle"]
    assert titles[:5] == ["rank", "policy", "error %", "lost runs %", "× oracle"]
    assert [title for title in titles if title in surprise] == surprise
    page = Path(__file__).parents[2].joinpath("docs/reference/columns.md").read_text()
    documented = {name for row in re.findall(r"^\| (.+?) \|", page, flags=re.M) for name in row.split(", ")}
    assert {*titles} - documented == {*surprise, "nominal"}


def test_a_board_shows_violations_where_scenarios_have_constraints():
    found = board(families=("nominal",), seeds=3)
    assert "violation" not in [column.key for column in columns(found)]
    runs = {**found.runs, "violation_pct": np.full_like(found.runs["error_pct"], 12.5)}
    runs["violation_pct"][0, 0, 1:] = np.nan
    runs["violation_pct"][1] = np.nan  # it failed
    (column,) = [column for column in columns(dataclasses.replace(found, runs=runs)) if column.key == "violation"]
    assert [column.text(i) for i in range(3)] == ["12", "–", "12"]


def test_a_policy_without_results_is_left_out_and_named():
    some = [run_cell(cell) for cell in load("ideal").build(["zero", "pid-flm"], ["nominal", "noise-1"], 2).cells]
    found = assemble([*some[:3]])
    assert found.policies == ("zero",)
    assert found.incomplete == {"pid-flm": "no result yet for noise-1"}
    assert "oracle" not in markdown.leaderboard(found)  # there is none
    file = io.StringIO()
    terminal.leaderboard(Console(file=file, width=400), found)
    assert "Left out: pid-flm: no result yet for noise-1" in file.getvalue()
    with pytest.raises(ValueError, match="results must be of the same seeds"):
        assemble([some[0], run_cell(Cell("zero", "noise-1", (0,)))])
    no = [dataclasses.replace(result, rows=(), error="RuntimeError: no") for result in some]
    found = assemble([some[0], no[1], some[2], no[3]])
    assert found.incomplete == {"pid-flm": "RuntimeError: no"}
    with pytest.raises(ValueError, match="no policy with a result for every scenario"):
        assemble(no)


def test_the_worst_family_is_beside_the_best_ranked_row():
    """Cascade-flm errs least but in mass-error, where it has twice the error of pid-flm; an oracle does not count."""
    found = board()
    errors = np.full(found.errors.shape, 4.0)
    errors[2, :1], errors[2, 1:4], errors[2, 4:], errors[3] = 1.0, 8.0, 2.0, 0.1
    found = dataclasses.replace(found, runs=found.runs | {"error_pct": errors})
    column = next(each for each in columns(found) if each.key == "worst-family")
    assert [column.cell(i) for i in range(4)] == ["4, nominal", "4, nominal", "2, mass-error", "0.1, nominal"]
    oracles = assemble([run_cell(cell) for cell in load("ideal").build(["oracle-flm"], ["nominal"], 2).cells])
    assert "worst-family" not in {each.key for each in columns(oracles)}


def test_first_rows_have_the_delay_margin_where_there_is_one():
    found = changed(board(), delay_samples=[np.nan, 0.25, 1.5, np.nan])
    rows = markdown.first_rows({"ideal": found}).splitlines()[2:]
    assert [re.sub(r"[\d.]+ %", "E %", row) for row in rows] == [
        "| 1 | `cascade-flm` E % · 1.5 |", "| 2 | `pid-flm` E % · 0.25 |", "| 3 | `zero` E % |",
    ]  # fmt: skip


def test_the_family_and_the_tier_of_a_scenario():
    for name in ("paper-3a", "mine", "mass-error-2~3f9a20"):  # each is its own family
        assert (family_of(name), tier_of(name)) == (name, "ideal")
    assert (family_of("everything-2@mujoco-lab"), tier_of("everything-2@mujoco-lab")) == ("everything", "worlds")
    assert (family_of("noise-1"), tier_of("noise-1")) == ("noise", "ideal")


def test_the_report_has_every_run_and_the_accesses(tmp_path, fbl_gym):
    store, out = tmp_path / "store", tmp_path / "out"
    same = [*SOME, "--seeds", "3", "--scenarios", "nominal", "--store", str(store)]
    shown = fbl_gym(["leaderboard", *same, "--workers", "1"]).out.replace("\n", "")
    assert all(text in shown for text in ("1 scenario, 3 seeds each", "cascade-flm", "(oracle-flm)", "a page of them"))
    assert not list(store.glob(".*"))
    readme = tmp_path / "README.md"
    readme.write_text("before\n<!-- leaderboard -->\nold\n<!-- /leaderboard -->\nafter\n")
    fbl_gym(["report", *same, "--out", str(out), "--readme", str(readme)])
    table = (out / "board.md").read_text()
    assert table.startswith("| policy | rank | error % | lost runs % | × oracle |")
    before, _, rest = readme.read_text().partition("<!-- leaderboard -->\n")
    short, _, after = rest.partition("<!-- /leaderboard -->\n")
    assert (before, after) == ("before\n", "after\n")
    header, _, first, *_ = short.splitlines()
    assert header == "| rank | servo |"
    assert re.fullmatch(r"\| 1 \| `[\w-]+` [\d.]+ % \|", first)
    page = (tmp_path / "docs" / "results" / "board.md").read_text()
    assert [line for line in page.splitlines() if "cascade-flm" in line]
    picture = (tmp_path / "docs" / "pictures" / "errors.svg").read_text()
    assert "cascade-flm<" in picture  # a dot for each ranked policy
    assert "oracle-flm<" not in picture
    page = (out / "board.html").read_text()
    assert "cascade-flm" in page
    assert "src=" not in page.partition("<body")[0].replace("data:", "")
    runs = list(csv.DictReader((out / "board.csv").read_text().splitlines()))
    assert len(runs) == 12
    assert len({run["policy"] for run in runs}) == 4
    assert set(runs[0]) == {"policy", "scenario", "control_dt", "seed", *METRICS}


def test_verify_command(tmp_path, fbl_gym):
    same = ["--workers", "1", "--seeds", "2", "--scenarios", "noise-1", "--store", str(tmp_path)]
    fbl_gym(["leaderboard", *SOME, *same])
    shown = fbl_gym(f"verify pid-flm/noise-1 --store {tmp_path}").out
    assert "pid-flm/noise-1, 2 seeds: holds, bit for bit" in shown
    store = Store(tmp_path)
    (path,) = [p for p in store.files() if p.name.startswith("pid-flm")]
    published = store.load(path)
    forged = ({**published.rows[0], "error_pct": 0.001}, *published.rows[1:])
    store.save(dataclasses.replace(published, rows=forged))
    shown = fbl_gym(["verify", str(path)], 1).out
    assert "DIFFERS: error_pct by up to" in shown
    assert "the policy keeps every promise that check-policy checks" in shown
    assert "did you mean 'pid-flm/noise-1'" in fbl_gym(["verify", "pid-flm/noise-2", "--store", str(tmp_path)], 2).err


CHEAT = """
import numpy as np
class make_policy:
    def __init__(self, interface):
        self.calls = 0
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.calls += 1
        observation[..., 0] += 1.0
        return np.full((*observation.shape[:-1], 2), 1.0 + self.calls), None
"""


def test_broken_promises_are_found(tmp_path, fbl_gym):
    """It keeps its state in itself, acts outside the box, and changes what it is given."""
    file = tmp_path / "cheat.py"
    file.write_text(CHEAT)
    shown = fbl_gym(["check-policy", str(file)], 1).out
    assert "BROKEN  actions have the observations' shape, are finite and lie in the box" in shown
    assert "BROKEN  predict is a function" in shown


FORGETFUL = """
from controllers.laws.simple import PdGravity
class make_policy(PdGravity):
    def torque(self, observation, state):
        return gain * observation, state
"""


def test_a_mistake_is_said_with_its_line(folder, fbl_gym):
    file = folder / "forgetful.py"
    file.write_text(FORGETFUL)
    shown = fbl_gym(["check-policy", "forgetful.py"], 1).out
    assert shown.count("NameError: name 'gain' is not defined (forgetful.py:5)") == shown.count("BROKEN") == 6
    assert "breaks 6 promises" in shown


ROUNDED = """
import numpy as np
from controllers.laws.simple import PdGravity
class make_policy(PdGravity):
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        position = np.asarray(observation)[..., self.interface.layout["position"]]
        action = np.tanh(-100 * position + 1e-6 * (np.ndim(observation) == 2))
        return LANE_ACTION, None
"""
"""A gain that amplifies a last bit, and a sum that rounds by the size of its batch."""


@pytest.mark.parametrize(("action", "kept"), [("action", True), ("action - action.mean(axis=0)", False)])
def test_lanes_are_compared_on_the_same_readings(action, kept, tmp_path):
    """Rounding that a closed loop amplifies is no broken promise; a lane that knows of the others is one."""
    file = tmp_path / "rounded.py"
    file.write_text(ROUNDED.replace("LANE_ACTION", f"np.clip({action}, -1, 1)"))
    (lanes,) = [found for found in check(str(file)) if found.promise == "a lane of a batch acts as a single policy"]
    assert lanes.kept is kept, lanes.detail


HELPED = """
from helper import GAIN
from controllers.laws.simple import PdGravity
make_policy = lambda interface: PdGravity(interface, GAIN)
"""


def test_a_law_imports_what_lies_beside_it(tmp_path, monkeypatch):
    """Two laws with a `helper` each import their own; their folders stay at the end of the path."""
    before = list(sys.path)
    for gain in (11.0, 12.0):
        folder = tmp_path / f"of_{gain:g}"
        folder.mkdir()
        (folder / "helper.py").write_text(f"GAIN = {gain}\n")
        (folder / "law.py").write_text(HELPED)
        made = resolve(str(folder / "law.py")).make(TwoLinkArmEnv())
        assert made.frequency == (gain, gain)
    monkeypatch.chdir(tmp_path / "of_11")
    (tmp_path / "of_11/law_of_11.py").write_text(HELPED)
    for text in ("law_of_11:make_policy", "law_of_11.py"):
        assert resolve(text).make(TwoLinkArmEnv()).frequency == (11.0, 11.0)
    assert sys.path[: len(before)] == before
    for name in ("helper", "law_of_11"):
        sys.modules.pop(name, None)


FEW = "--policies zero --seeds 1 --scenarios nominal"


@pytest.fixture
def report(folder, fbl_gym):
    """The folder of a complete report."""
    fbl_gym(f"leaderboard {FEW} --workers 1")
    fbl_gym(f"report {FEW}")
    return folder / "results" / "report"


def test_an_incomplete_report_says_what_it_lacks(report, fbl_gym):
    assert "ncomplete" not in (report / "board.md").read_text()
    shown = fbl_gym(f"report {FEW} noise-1 noise-2", 1)
    sentence = "Incomplete: 2 of 3 scenarios have no results: noise-1, noise-2"
    assert sentence in shown.out
    assert "the report is incomplete" in shown.err
    for name in ("board.md", "board.html"):
        assert sentence in (report / name).read_text(encoding="utf-8")


def test_a_page_is_complete_or_as_it_was(report, fbl_gym, monkeypatch):
    """Killed while it writes, the report leaves the last page."""
    before = {path.name: path.read_bytes() for path in report.iterdir()}
    monkeypatch.setattr("os.fsync", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
    fbl_gym(f"report {FEW}", 130)
    assert {path.name: path.read_bytes() for path in report.iterdir()} == before


def test_splits_do_not_overlap():
    for one, other in itertools.combinations(SPLITS.values(), 2):
        assert one.stop <= other.start or other.stop <= one.start


def test_suites(tmp_path):
    for name in SUITES:
        suite = load(name).build(("zero", "pid-flm"))
        assert len({c.id for c in suite.cells}) == len(suite.cells)
        assert all(seed in SPLITS["test"] for c in suite.cells[:1] for seed in c.seeds)
    board = {scenario.name for scenario in load("servo").scenarios}
    assert board == {*scenarios.in_tier("servo", [2]), *scenarios.in_tier("servo-surprise")}
    assert "td3" not in load("servo").policy_names
    assert {"ppo", "ppo-blend"} <= {*load("servo").policy_names}
    short = load("geared").build(("zero", "ppo"), short=True)
    assert (len(short.scenarios), short.seeds) == (3, SHORT_SEEDS)
    assert [spec.name for spec in short.policies] == ["zero", f"ppo@{best_seed('ppo')}"]
    assert len(load("geared").build(("zero", "ppo")).policies) == 6
    assert "computed-torque-tde@tuned" in load("servo").policy_names
    for names, chosen in ((("noise",), "noise-{}"), (("nominal", "servo-noise"), "servo-noise-{}")):
        built = [scenario.name for scenario in load("ideal").build(["zero"], names).scenarios]
        assert built == [*names[:-1], *map(chosen.format, (1, 2, 3))]
    assert len(Suite("twice", ("zero", "zero"), (scenarios.get("nominal"),) * 2, 1).cells) == 1
    file = tmp_path / "mine.toml"
    file.write_text('policies = ["zero"]\nscenarios = ["noise", {name = "own", noise = {position = 0.1}}]\nseeds = 5\n')
    suite = load(str(file)).build()
    assert [s.name for s in suite.scenarios][-1] == "own"
    assert len(suite.cells) == 4
    assert suite.cells[0].seeds == tuple(range(5))
    file.write_text("policy = 3\n")
    with pytest.raises(ValueError, match=r"unknown entry of .*mine.toml 'policy'; did you mean 'policies'"):
        load(str(file))
    with pytest.raises(ValueError, match="seeds must be a whole number"):
        load("ideal").build(seeds=20_000)


def test_scenarios_that_share_a_name_keep_their_content(tmp_path):
    """Tables without names, and a table with a name that exists."""
    file = tmp_path / "tables.toml"
    file.write_text(
        'policies = ["pd-gravity"]\nseeds = 2\n'
        "scenarios = [{parameter_error = 1.1}, {parameter_error = 2.0}, "
        '{name = "nominal", parameter_error = 3.0}, "nominal"]\n'
    )
    suite = load(str(file)).build()
    assert len({scenario.name for scenario in suite.scenarios}) == len({cell.key for cell in suite.cells}) == 4
    assert all(scenario.name.startswith("nominal") for scenario in suite.scenarios)
    assert scenarios.get("nominal") in suite.scenarios
    ratios = [scenario.parameter_error.ratio[0] for scenario in suite.scenarios if scenario.parameter_error]
    assert sorted(ratios) == [1.1, 2.0, 3.0]


def rows_of(*policies):
    return {spec.name: spec.rows for spec in members(policies)}


def test_an_agent_stands_for_its_training_seeds_on_a_board():
    """The first has the smallest validation error; a training seed that is asked for has a row too."""
    agent = "ppo-blend"
    rows = rows_of("zero", agent, f"{agent}@2")
    first = best_seed(agent)
    seeds = (first, *(k for k in shipped()[agent] if k != first))
    assert list(rows) == ["zero", *(f"{agent}@{seed}" for seed in seeds)]
    assert rows["zero"] == ("zero",)
    assert (rows[f"{agent}@0"], rows[f"{agent}@2"]) == ((agent,), (agent, f"{agent}@2"))
    assert rows_of(*load("ideal").build([agent], ["nominal"]).policies) == rows_of(agent)


def test_a_folder_needs_the_sensors_of_its_agent():
    (spec,) = members([str(SHIPPED / "ppo-blend" / "0")])
    assert spec.needs == ("position", "velocity")


def test_folders_of_training_runs_are_grouped_by_their_settings(tmp_path):
    runs = []
    for name, settings in (("a-0", {"seed": 0, "steps": 9}), ("a-1", {"seed": 1, "steps": 9}), ("b-1", {"seed": 1})):
        shutil.copytree(SHIPPED / "sac" / "0", tmp_path / name)
        (tmp_path / name / "run.json").write_text(json.dumps(settings))
        runs.append(str(tmp_path / name))
    assert list(rows_of(*runs).values()) == [(f"{tmp_path}/a",), (f"{tmp_path}/a",), (runs[2],)]
    (tmp_path / "b-1" / "run.json").write_text(json.dumps({"seed": 1, "steps": 9}))  # a second run of seed 1
    assert list(rows_of(*runs).values()) == [(runs[2],), (f"{tmp_path}/a",), (f"{tmp_path}/a",)]
    shutil.move(runs[2], tmp_path / "a")
    (tmp_path / "a" / "run.json").write_text(json.dumps({"seed": 2}))  # the row of the other two needs another name
    runs[2] = str(tmp_path / "a")
    assert list(rows_of(*runs).values()) == [(runs[0],), (runs[0],), (runs[2],)]
    (tmp_path / "a" / "run.json").write_text("{}")
    with pytest.raises(ValueError, match=r"run.json must be as fbl-gym train writes it \(KeyError"):
        rows_of(*runs)
