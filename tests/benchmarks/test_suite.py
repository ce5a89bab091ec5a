"""Suites: their names, files, seeds and scenarios."""

import json
import shutil

import pytest

from benchmarks import cli
from benchmarks.rl.policy import SHIPPED, best_seed, shipped
from benchmarks.run.suite import SHORT_SEEDS, SUITES, Suite, load, members
from benchmarks.seeds import SPLITS
from fbl_gym import scenarios


def test_splits_do_not_overlap():
    ranges = list(SPLITS.values())
    for i, one in enumerate(ranges):
        for other in ranges[i + 1 :]:
            assert one.stop <= other.start or other.stop <= one.start


def test_suites(tmp_path):
    for name in SUITES:
        suite = load(name).build(("zero", "pid-flm"))
        assert len({c.id for c in suite.cells}) == len(suite.cells)
        assert all(seed in SPLITS["test"] for c in suite.cells[:1] for seed in c.seeds)
    board = {scenario.name for scenario in load("servo").scenarios}
    assert board == {*scenarios.in_tier("servo", [2]), *scenarios.in_tier("servo-surprise")}
    assert "ppo-torque" not in load("servo").policy_names
    assert "ppo-servo" in load("servo").policy_names
    short = load("geared").build(("zero",), short=True)
    assert (len(short.scenarios), short.seeds) == (3, SHORT_SEEDS)
    assert "computed-torque-tde@tuned" in load("servo").policy_names
    file = tmp_path / "mine.toml"
    file.write_text('policies = ["zero"]\nscenarios = ["noise", {name = "own", noise = {position = 0.1}}]\nseeds = 5\n')
    suite = load(str(file)).build()
    assert [s.name for s in suite.scenarios][-1] == "own"
    assert len(suite.cells) == 4
    assert suite.cells[0].seeds == tuple(range(5))
    file.write_text("policy = 3\n")
    with pytest.raises(ValueError, match=r"unknown entry of .*mine.toml 'policy'; did you mean 'policies'"):
        load(str(file))
    file.write_text("policies = [\n")
    with pytest.raises(ValueError, match="is no TOML"):
        load(str(file))
    with pytest.raises(ValueError, match="unknown suite 'idel'; did you mean 'ideal'"):
        load("idel")
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


def test_a_family_stands_for_its_severities():
    def chosen(*names):
        return [scenario.name for scenario in load("ideal").build(["zero"], names).scenarios]

    assert chosen("noise") == ["noise-1", "noise-2", "noise-3"]
    assert chosen("nominal", "servo-noise") == ["nominal", "servo-noise-1", "servo-noise-2", "servo-noise-3"]
    with pytest.raises(ValueError, match="unknown scenario or family 'noises'; did you mean 'noise'"):
        chosen("noises")


def test_what_is_given_twice_counts_once():
    suite = Suite("twice", ("zero", "zero"), (scenarios.get("nominal"),) * 2, 1)
    assert len(suite.cells) == 1


def rows_of(*policies):
    return {spec.name: spec.rows for spec in members(policies)}


def test_an_agent_stands_for_its_training_seeds_on_a_board():
    """The first has the smallest validation error; a training seed that is asked for has a row too."""
    agent = "ppo-servo"
    rows = rows_of("zero", agent, f"{agent}@2")
    first = best_seed(agent)
    assert list(rows) == [
        "zero",
        *(f"{agent}@{seed}" for seed in (first, *(k for k in shipped()[agent] if k != first))),
    ]
    assert rows["zero"] == ("zero",)
    assert (rows[f"{agent}@0"], rows[f"{agent}@2"]) == ((agent,), (agent, f"{agent}@2"))
    assert rows_of(*load("ideal").build([agent], ["nominal"]).policies) == rows_of(agent)


def test_a_folder_needs_the_sensors_of_its_agent():
    (spec,) = members([str(SHIPPED / "ppo-servo" / "0")])
    assert spec.needs == ("position", "velocity")


def test_folders_of_training_runs_are_grouped_by_their_settings(tmp_path):
    runs = []
    for name, settings in (("a-0", {"seed": 0, "steps": 9}), ("a-1", {"seed": 1, "steps": 9}), ("b-1", {"seed": 1})):
        shutil.copytree(SHIPPED / "sac" / "0", tmp_path / name)
        (tmp_path / name / "run.json").write_text(json.dumps(settings))
        runs.append(str(tmp_path / name))
    assert list(rows_of(*runs).values()) == [(runs[0],), (runs[0],), (runs[2],)]
    (tmp_path / "b-1" / "run.json").write_text(json.dumps({"seed": 1, "steps": 9}))  # a second run of seed 1
    assert list(rows_of(*runs).values()) == [(runs[2],), (runs[0],), (runs[0],)]
    (tmp_path / "b-1" / "run.json").write_text("{}")
    with pytest.raises(ValueError, match=r"run.json must be as fbl-gym train writes it \(KeyError"):
        rows_of(*runs)


def test_two_suites_of_one_name_are_refused(tmp_path, capsys):
    """Their boards are told apart by the name."""
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mine.toml").write_text('policies = ["zero"]\nscenarios = ["nominal"]\nseeds = 1\n')
    files = [str(tmp_path / folder / "mine.toml") for folder in ("a", "b")]
    assert cli.main(["leaderboard", "--suite", *files, "--store", str(tmp_path / "store")]) == 2
    assert "--suite must give suites of different names, got mine, mine" in capsys.readouterr().err
