"""Recommendations: conditions around a scenario, the choice, and what overturns it."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from optuna.distributions import FloatDistribution

from benchmarks import cli
from benchmarks.analysis import recommend
from benchmarks.analysis.recommend import around, is_safe, push
from benchmarks.policies.spec import resolve
from benchmarks.run.cell import run_cell
from benchmarks.tuning import brief, search
from fbl_gym import Scenario, scenarios
from fbl_gym.records import ends
from fbl_gym.scenarios import held_out_reason
from tests import drawn_arms

BASE = scenarios.get("servo-nominal").replace(name="short", duration=0.6)


def run(cells):
    return {cell.id: run_cell(cell) for cell in cells}


@pytest.mark.parametrize("name", ["nominal", "servo-nominal", "geared-nominal", "servo-everything-2", "paper-6a"])
def test_a_condition_changes_one_option(name):
    base = scenarios.get(name)
    every = around(base)
    assert next(iter(every.values())) is base
    assert ("elastic" in every) == (base.joint is not None)
    for kind, scenario in every.items():
        changed = {field for field, value in vars(scenario).items() if value != getattr(base, field)} - {"name"}
        if kind == "parameters" and base.joint is not None:
            changed -= {"physics_dt"}  # a lighter link is faster on its spring
        assert len(changed) == (0 if kind == "as described" else 1) or kind == "everything", (kind, changed)


def test_sizes_are_twice_the_given_ones():
    base = scenarios.get("servo-everything-2")
    total = lambda s: ends(s.actuator.delay)[1] + s.actuator.delay_samples * s.control_dt
    assert total(push(base, "delay", 2.0, "servo")) == pytest.approx(2 * total(base))
    assert push(base, "lag", 2.0, "servo").actuator.lag == pytest.approx(2 * ends(base.actuator.lag)[1])
    for field in ("viscous", "coulomb", "stiction"):
        pushed, given = (getattr(s.friction, field) for s in (push(base, "friction", 2.0, "servo"), base))
        assert ends(pushed) == pytest.approx([2 * x for x in ends(given)])
    assert push(base, "parameters", 2.0, "servo").parameter_error.radius == pytest.approx(
        2 * base.parameter_error.radius
    )
    assert ends(push(base, "noise", 2.0, "servo").noise.position.sigma)[1] == 2 * ends(base.noise.position.sigma)[1]
    assert ends(push(base, "elastic", 2.0, "servo").joint.stiffness)[1] == pytest.approx(
        0.5 * ends(base.joint.stiffness)[1]
    )
    assert push(Scenario(), "delay", 2.0, "servo").actuator.delay == 0.01
    for robot, lag in (("servo", 0.015), ("direct", 0.002)):
        assert push(Scenario(), "lag", 2.0, robot).actuator.lag == lag
    assert np.all(np.array(push(base, "saturation", 2.0, "servo").actuator.torque_limit) < base.actuator.torque_limit)


@pytest.fixture(scope="module")
def result():
    return recommend.recommend(BASE, ["pd-gravity", "computed-torque", "zero"], 4, run)


def test_the_choice(result):
    assert result.safe
    assert {choice.policy for choice in result.choices} == {"pd-gravity", "computed-torque"}  # zero is not safe
    first, second = result.choices
    assert first.median_pct < first.worst_pct
    assert first.runs == 4 * len(result.conditions) == 44
    assert 0.0 < first.diverged_bound < 0.2
    assert len(first.errors_pct) == len(result.conditions)
    assert sum(first.lost) == first.diverged
    assert min(first.effort, second.effort) == 1.0


def test_an_arm_that_stays_is_not_safe():
    good = {"error_pct": 1.0, "baseline_error_pct": 80.0, "diverged": 0.0}
    rows = lambda diverged: tuple(good | {"diverged": float(i < diverged)} for i in range(16))
    base = run_cell(recommend.Cell("zero", BASE, (0,)))
    assert is_safe([dataclasses.replace(base, rows=rows(1))])
    assert not is_safe([dataclasses.replace(base, rows=rows(2))])  # lower bound 1.6 %
    assert not is_safe([dataclasses.replace(base, rows=(good | {"error_pct": 50.0},) * 16)])
    one, none = (dataclasses.replace(base, rows=rows(lost)) for lost in (1, 0))
    assert is_safe([none, one, one, none])
    assert not is_safe([none] + [one] * 7)  # 7 of 128 runs


def test_brief_tuning_improves_a_law_and_goes_on(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    storage, folder, news = search.STORAGE, Path("results/gains"), []
    arguments = {"workers": 1, "command": ""}
    policies = ["ppo-servo", "pd-gravity", "zero", "pd-gravity@damping=1"]
    names = brief.tune_briefly(BASE, policies, 3.0, lambda *part: news.append(part), **arguments)
    assert news[-1][0] == 1.0
    (task,) = brief.tasks_of(BASE, policies)
    assert held_out_reason(BASE)
    assert not any(held_out_reason(scenario) for scenario in task.scenarios)
    trials = search.finished(search.open_study(task, storage))
    best = min(trials, key=lambda trial: trial.value)
    assert best.value < trials[0].value
    assert names in ([f"pd-gravity@{folder / 'short'}"], ["pd-gravity@servo"])
    study = search.open_study(dataclasses.replace(task, seeds=range(1)), storage)
    study.enqueue_trial(dict.fromkeys(task.ranges, 10.0))
    study.tell(study.ask(dict.fromkeys(task.ranges, FloatDistribution(1.0, 1e3))), -9.0)
    new = brief.write_best(dataclasses.replace(task, seeds=range(1)), storage, folder, "")
    assert new == f"pd-gravity@{folder}"
    assert resolve(new).parsed.given_gains == dict.fromkeys(task.ranges, 10.0)
    brief.tune_briefly(BASE, policies, 0.0, lambda *_: None, **arguments)
    assert len(search.finished(search.open_study(task, storage))) > len(trials)


def test_the_command(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("benchmarks.cli.recommend.as_scenario", lambda name: BASE)
    monkeypatch.chdir(tmp_path)
    few = ["--seeds", "2", "--workers", "1", "--store", str(tmp_path / "store")]
    assert cli.main(["recommend", "my_arm.toml", *few, "--policies", "pd-gravity", "--minutes", "0.01"]) == 0
    printed = capsys.readouterr().out
    assert "class of robots: servo" in printed
    assert "pd-gravity@" in printed
    assert "torque constant" in printed
    arguments = ["recommend", "my_arm.toml", *few, "--minutes", "0"]
    assert cli.main([*arguments, "--policies", "pd-gravity", "zero"]) == 0
    assert "error by condition" in capsys.readouterr().out
    lacks = tmp_path / "lacks.py"
    lacks.write_text("def make_policy(interface):\n    return {}['lost']\n")
    assert cli.main([*arguments, "--policies", "pd-gravity", str(lacks), "json:loads"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert f"without {lacks}: KeyError: 'lost'" in shown
    assert "without json:loads: TypeError: the JSON object must be" in shown
    assert cli.main([*arguments, "--policies", "zero"]) == 1
    assert "No policy is safe on short" in capsys.readouterr().out
    assert cli.main([*arguments, "--seeds", "1"]) == 2
    monkeypatch.setattr(recommend, "candidates", lambda _: ("pd-gravity",))
    assert cli.main(arguments) == 0
    assert "pd-gravity" in capsys.readouterr().out


def test_the_check_on_drawn_arms(monkeypatch, tmp_path, capsys):
    draw = drawn_arms.draw
    assert draw(3) == draw(3)
    assert [draw(i).name.split("-")[2] for i in range(3)] == ["servo", "direct", "geared"]
    assert all(draw(i).robot_class == draw(i).name.split("-")[2] for i in range(12))
    monkeypatch.setattr(drawn_arms, "draw", lambda i: draw(i).replace(duration=0.3))
    monkeypatch.setattr(drawn_arms, "TRIALS", 2)
    monkeypatch.chdir(tmp_path)
    few = ["0", "--seeds", "2", "--workers", "1", "--minutes", "0", "--laws", "pd-gravity", "--policies"]
    drawn_arms.main([*few, "pd-gravity", "computed-torque"])
    line, share = capsys.readouterr().out.splitlines()
    assert line.startswith(f"{draw(0).name}: ")
    assert "best of 1 laws tuned: pd-gravity" in line
    assert "of 1 first choices are safe and within 1.5 times the best" in share
    drawn_arms.main([*few, "zero"])
    assert "none is safe" in capsys.readouterr().out
