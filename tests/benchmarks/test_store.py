"""Suites; the store and the runner: killed, damaged, shared, full, and spread over workers."""

import itertools
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from benchmarks.agents.policy import SHIPPED, best_seed, shipped
from benchmarks.policies.isolation import Failed, run_parallel
from benchmarks.policies.key import data_digest
from benchmarks.run import runner as runner_module
from benchmarks.run import store as store_module
from benchmarks.run.cell import Cell
from benchmarks.run.expansion import members
from benchmarks.run.metrics import METRICS
from benchmarks.run.runner import run, run_cell
from benchmarks.run.store import Damaged, OtherFormat, Store
from benchmarks.run.suite import SHORT_SEEDS, SUITES, Suite, load
from benchmarks.seeds import SPLITS
from fbl_gym import scenarios
from fbl_gym.records.record import merged

SHORT = {"duration": 0.5}


def cells(policies=("zero", "pid-flm", "cascade-flm"), seeds=3, families=("nominal", "mass-error-1", "noise-1")):
    suite = load("ideal").build(policies, families, seeds)
    return [Cell(c.policy, c.scenario.replace(**SHORT), c.seeds) for c in suite.cells]


def finish(some, folder, **options):
    return list(run(some, Store(Path(folder)), **options))


def contents(folder):
    """The numbers of each file, without times and machines."""
    return {path.name: json.loads(path.read_text())["rows"] for path in Store(Path(folder)).files()}


def test_a_finished_cell_is_found_and_not_run_again(tmp_path, monkeypatch):
    assert {done for done, _ in finish(cells(), tmp_path)} == {"computed"}
    before = {p: p.stat().st_mtime_ns for p in Store(tmp_path).files()}
    monkeypatch.setattr(runner_module, "rollout_trials", lambda *_: pytest.fail("it was run again"))
    assert {done for done, _ in finish(cells(), tmp_path)} == {"found"}
    assert {p: p.stat().st_mtime_ns for p in Store(tmp_path).files()} == before


def test_the_result_of_a_relative_path_is_listed(folder):
    Path("law.py").write_text("from controllers import Zero as make_policy\n")
    assert not Store(folder).path(cells(["./law.py"], families=["noise-1"])[0]).name.startswith(".")


def test_a_stored_result_is_what_was_measured(tmp_path):
    (cell,) = cells(["cascade-flm"], families=["noise-1"])
    fresh = run_cell(cell)
    path = Store(tmp_path).save(fresh)
    again = Store(tmp_path).load(path)
    assert again.cell == cell
    for one, two in zip(fresh.rows, again.rows, strict=True):
        np.testing.assert_array_equal(list(one.values()), list(two.values()))
    assert again.provenance["packages"]["numpy"] == np.__version__


def test_results_do_not_depend_on_workers_or_order(tmp_path):
    finish(cells(), tmp_path / "one")
    finish(cells()[::-1], tmp_path / "other", workers=2)
    assert contents(tmp_path / "one") == contents(tmp_path / "other")


def test_a_damaged_file_is_named_and_computed_again(tmp_path):
    finish(cells(), tmp_path)
    store = Store(tmp_path)
    victim = store.files()[0]
    victim.write_text(victim.read_text().replace('"seeds":[0,1,2]', '"seeds":[0,1,3]'))
    with pytest.raises(Damaged, match=rf"{victim.name} is damaged \(its checksum is wrong\)"):
        store.load(victim)
    with pytest.warns(UserWarning, match=rf"{victim.name} is damaged .*; `fbl-gym leaderboard` computes its cell"):
        assert [done for done, _ in finish(cells(), tmp_path)].count("computed") == 1
    assert len(list(store.results())) == len(cells())
    for damage in ("", "{", "[]", "null", victim.read_text()[:-40]):
        victim.write_text(damage)
        with pytest.warns(UserWarning, match="is damaged"):
            assert len(list(store.results())) == len(cells()) - 1


@pytest.mark.skipif(sys.platform == "win32", reason="has no named pipes")
@pytest.mark.parametrize("make", [os.mkdir, os.mkfifo, lambda path: os.symlink(path, path)])
def test_no_kind_of_file_in_the_place_of_a_result_stops_the_others(make, tmp_path):
    some, store = cells(["zero"]), Store(tmp_path)
    finish(some, tmp_path)
    (victim := store.files()[0]).unlink()
    make(victim)
    with pytest.warns(UserWarning, match="is damaged"):
        assert [done for done, _ in finish(some, tmp_path)].count("computed") == 1
    assert len(list(store.results())) == len(some)


@pytest.mark.parametrize("change", [
    {"decision_us": "fast"}, {"error": "x", "provenance": 3}, {"rows": {"diverged": ["a", 0, 0]}},
    {"rows": {name: [1.0] for name in METRICS}}, {"policy": {"kind": "other"}}, {"policy": {"access": "<b>all</b>"}},
])  # fmt: skip
def test_a_result_with_other_types_is_damaged(change, tmp_path):
    """Even with the right checksum."""
    path = Store(tmp_path).save(run_cell(cells(["zero"])[0]))
    document = merged(json.loads(path.read_text()), change)
    del document["sha256"]
    path.write_text(json.dumps({**document, "sha256": data_digest(document)}))
    with pytest.raises(Damaged):
        Store(tmp_path).load(path)


def test_a_result_in_the_place_of_another_is_not_read(tmp_path):
    finish(cells(), tmp_path)
    store = Store(tmp_path)
    one, other = (store.path(cell) for cell in cells()[:2])
    one.write_text(other.read_text())
    with pytest.warns(UserWarning, match="it holds the result "):
        assert store.find(cells()[0]) is None
    copy = tmp_path / f"copy--{other.name}"
    copy.write_text(other.read_text())
    with pytest.warns(UserWarning, match="it holds the result "):
        assert len(list(store.results())) == len(cells()) - 1


def test_a_file_of_another_format_is_left_alone(tmp_path):
    finish(cells(["zero"]), tmp_path)
    old = tmp_path / "zero--nominal--0123456789abcdef0123.json"
    old.write_text(json.dumps({"id": "zero/nominal", "rows": {}}))
    assert (len(list(Store(tmp_path).results())), old.is_file()) == (len(cells(["zero"])), True)


@pytest.mark.parametrize("change", ["added", "removed"])
def test_another_set_of_metrics_is_another_format_and_damages_nothing(tmp_path, monkeypatch, change):
    some = cells(["zero"])
    finish(some, tmp_path)
    store = Store(tmp_path)
    files = {path.name: path.read_bytes() for path in store.files()}
    metrics = {**METRICS, "new_metric": "a metric"} if change == "added" else dict(list(METRICS.items())[:-1])
    monkeypatch.setattr(store_module, "METRICS", metrics)
    assert not list(store.results())
    assert store.find(some[0]) is None
    assert {path.name: path.read_bytes() for path in store.files()} == files
    name = "new_metric" if change == "added" else list(METRICS)[-1]
    with pytest.raises(OtherFormat, match=f"has other metrics than this version of fbl-gym .*{name}"):
        store.load(store.path(some[0]))
    monkeypatch.setattr(store_module, "versions", lambda _: {"numpy": "0.0"})
    with pytest.raises(OtherFormat, match=r"was computed with numpy .*, which is not installed"):
        store.load(store.path(some[0]))


def test_a_full_disk_is_an_error_and_leaves_the_rest(tmp_path, monkeypatch):
    some = cells(["zero"])
    finish(some[:1], tmp_path)
    monkeypatch.setattr(os, "fsync", Mock(side_effect=OSError(28, "No space left on device")))
    with pytest.raises(OSError, match=r"No space left.*/zero--"):
        finish(some, tmp_path)
    monkeypatch.undo()
    assert len(Store(tmp_path).files()) == 1
    assert not list(tmp_path.glob(".*"))
    assert sorted(done for done, _ in finish(some, tmp_path)) == ["computed", "computed", "found"]


COMMAND = [
    sys.executable, "-m", "fbl_gym", "leaderboard", "--policies", "zero", "pd-gravity", "--seeds", "2", "--workers", "1",
    "--scenarios", "nominal", "mass-error", "length-error", "noise-1",
]  # fmt: skip
TOTAL = 2 * 8


def test_kill_9_in_a_loop(tmp_path):
    """Killed again and again while it runs, the run goes on where it was: nothing lost, nothing doubled, nothing twice."""
    seen, command = {}, [*COMMAND, "--store", str(tmp_path)]

    def stored():
        return {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in Store(tmp_path).files()}

    for _ in range(2):
        process = subprocess.Popen(command)
        target, deadline = len(seen) + 4, time.monotonic() + 60
        while len(Store(tmp_path).files()) < target and time.monotonic() < deadline and process.poll() is None:
            time.sleep(0.005)
        process.kill()
        process.wait()
        assert stored().items() > seen.items()
        seen = stored()
    subprocess.run(command, check=True)
    assert stored().items() >= seen.items()
    assert len(stored()) == len(list(Store(tmp_path).results())) == TOTAL


def test_two_processes_share_a_store(tmp_path):
    command, pipes = [*COMMAND, "--store", str(tmp_path)], {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    for process in [subprocess.Popen(command, **pipes) for _ in range(2)]:
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
    assert len(list(Store(tmp_path).results())) == TOTAL
    assert not list(tmp_path.glob(".*"))


def killed_at_three(number):
    """Kill the worker of one item."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_a_killed_worker_leaves_every_call_an_answer():
    """With more calls than workers."""
    answers = dict(run_parallel(killed_at_three, range(8), 2))
    failed = [number for number, answer in answers.items() if isinstance(answer, Failed)]
    assert set(answers) == set(range(8))
    assert 3 in failed
    assert all(answers[number] == number for number in answers if number not in failed)


# Suites: scenarios, seeds, and the rows of agents.


def test_splits_do_not_overlap():
    for one, other in itertools.pairwise(sorted(SPLITS.values(), key=lambda split: split.start)):
        assert one.stop <= other.start


def test_suites(tmp_path):
    for name in SUITES:
        suite = load(name).build(("zero", "pid-flm"))
        assert len({c.id for c in suite.cells}) == len(suite.cells)
        assert all(seed in SPLITS["test"] for c in suite.cells[:1] for seed in c.seeds)
    board = {scenario.name for scenario in load("servo").scenarios}
    assert board == {*scenarios.in_tier("servo", [2]), *scenarios.in_tier("servo-surprise")}
    assert "td3" not in load("servo").policies
    assert {"ppo", "ppo-blend"} <= {*load("servo").policies}
    short = load("geared").build(("zero", "ppo"), short=True)
    assert (len(short.scenarios), short.seeds) == (3, SHORT_SEEDS)
    assert [spec.name for spec in short.policies] == ["zero", f"ppo@{best_seed('ppo')}"]
    assert len(load("geared").build(("zero", "ppo")).policies) == 6
    assert "computed-torque-tde@tuned" in load("servo").policies
    for names, chosen in ((("noise",), "noise-{}"), (("nominal", "servo-noise"), "servo-noise-{}")):
        built = [scenario.name for scenario in load("ideal").build(["zero"], names).scenarios]
        assert built == [*names[:-1], *map(chosen.format, (1, 2, 3))]
    assert len(Suite("twice", ("zero", "zero"), (scenarios.get("nominal"),) * 2, 1).cells) == 1
    text = 'policies = ["zero"]\nscenarios = ["noise", {name = "own", noise = {position = 0.1}}]\nseeds = 5\n'
    (file := tmp_path / "mine.toml").write_text(text)
    suite = load(str(file)).build()
    assert (suite.scenarios[-1].name, len(suite.cells), suite.cells[0].seeds) == ("own", 4, tuple(range(5)))
    file.write_text("policy = 3\n")
    with pytest.raises(ValueError, match=r"unknown entry of .*mine.toml 'policy'; did you mean 'policies'"):
        load(str(file))
    with pytest.raises(ValueError, match="seeds must be a whole number"):
        load("ideal").build(seeds=20_000)


def test_scenarios_that_share_a_name_keep_their_content(tmp_path):
    """Tables without names, and a table with a name that exists."""
    tables = '{parameter_error = 1.1}, {parameter_error = 2.0}, {name = "nominal", parameter_error = 3.0}, "nominal"'
    (tmp_path / "tables.toml").write_text(f'policies = ["pd-gravity"]\nscenarios = [{tables}]\nseeds = 2\n')
    suite = load(str(tmp_path / "tables.toml")).build()
    assert len({scenario.name for scenario in suite.scenarios}) == len({cell.key for cell in suite.cells}) == 4
    assert all(scenario.name.startswith("nominal") for scenario in suite.scenarios)
    assert scenarios.get("nominal") in suite.scenarios
    ratios = [scenario.parameter_error.ratio[0] for scenario in suite.scenarios if scenario.parameter_error]
    assert sorted(ratios) == [1.1, 2.0, 3.0]


def rows_of(*policies):
    return {spec.name: spec.rows for spec in members(policies)}


def test_an_agent_stands_for_its_training_seeds_on_a_board():
    """The first has the smallest validation error; a training seed that is asked for has a row too."""
    agent, first = "ppo-blend", best_seed("ppo-blend")
    rows = rows_of("zero", agent, f"{agent}@2")
    members = {f"{agent}@{seed}": (agent,) for seed in (first, *shipped()[agent])}
    assert [*rows.items()] == [*({"zero": ("zero",)} | members | {f"{agent}@2": (agent, f"{agent}@2")}).items()]
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
    assert [*rows_of(f"{runs[0]}/", f"{runs[1]}/").values()] == [(f"{tmp_path}/a",)] * 2
    (tmp_path / "b-1" / "run.json").write_text(json.dumps({"seed": 1, "steps": 9}))  # a second run of seed 1
    assert list(rows_of(*runs).values()) == [(runs[2],), (f"{tmp_path}/a",), (f"{tmp_path}/a",)]
    shutil.move(runs[2], tmp_path / "a")
    (tmp_path / "a" / "run.json").write_text(json.dumps({"seed": 2}))  # the row of the other two needs another name
    runs[2] = str(tmp_path / "a")
    assert list(rows_of(*runs).values()) == [(runs[0],), (runs[0],), (runs[2],)]
    (tmp_path / "a" / "run.json").write_text("{}")
    with pytest.raises(ValueError, match=r"run.json must be as fbl-gym train writes it \(KeyError"):
        rows_of(*runs)
