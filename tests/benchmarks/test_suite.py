"""Suites: scenarios, seeds, and the rows of agents."""

import itertools
import json
import shutil

import pytest

from benchmarks.agents.policy import SHIPPED, best_seed, shipped
from benchmarks.run.expansion import members
from benchmarks.run.suite import SHORT_SEEDS, SUITES, Suite, load
from benchmarks.seeds import SPLITS
from fbl_gym import scenarios


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
    (file := tmp_path / "mine.toml").write_text(
        'policies = ["zero"]\nscenarios = ["noise", {name = "own", noise = {position = 0.1}}]\nseeds = 5\n'
    )
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
    (tmp_path / "b-1" / "run.json").write_text(json.dumps({"seed": 1, "steps": 9}))  # a second run of seed 1
    assert list(rows_of(*runs).values()) == [(runs[2],), (f"{tmp_path}/a",), (f"{tmp_path}/a",)]
    shutil.move(runs[2], tmp_path / "a")
    (tmp_path / "a" / "run.json").write_text(json.dumps({"seed": 2}))  # the row of the other two needs another name
    runs[2] = str(tmp_path / "a")
    assert list(rows_of(*runs).values()) == [(runs[0],), (runs[0],), (runs[2],)]
    (tmp_path / "a" / "run.json").write_text("{}")
    with pytest.raises(ValueError, match=r"run.json must be as fbl-gym train writes it \(KeyError"):
        rows_of(*runs)
