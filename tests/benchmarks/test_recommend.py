"""Recommendations: conditions around a scenario, the choice, and what overturns it."""

import dataclasses
import json

import numpy as np
import pytest

from benchmarks import cli
from benchmarks.analysis import drawn_arms, recommend
from benchmarks.analysis.recommend import around, is_safe, push
from benchmarks.run.cell import run_cell
from fbl_gym import Scenario, scenarios
from fbl_gym.records import ends

BASE = scenarios.get("servo-nominal").replace(name="short", duration=0.6)


def run(cells):
    return {cell.id: run_cell(cell) for cell in cells}


@pytest.mark.parametrize("name", ["nominal", "servo-nominal", "servo-elastic-1", "servo-everything-2", "paper-6a"])
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
    assert total(push(base, "delay", 2.0)) == pytest.approx(2 * total(base))
    assert push(base, "lag", 2.0).actuator.lag == pytest.approx(2 * ends(base.actuator.lag)[1])
    for field in ("viscous", "coulomb", "stiction"):
        pushed, given = (getattr(s.friction, field) for s in (push(base, "friction", 2.0), base))
        assert ends(pushed) == pytest.approx([2 * x for x in ends(given)])
    assert push(base, "parameters", 2.0).parameter_error.radius == pytest.approx(2 * base.parameter_error.radius)
    assert ends(push(base, "noise", 2.0).noise.position.sigma)[1] == 2 * ends(base.noise.position.sigma)[1]
    assert ends(push(base, "elastic", 2.0).joint.stiffness)[1] == pytest.approx(0.5 * ends(base.joint.stiffness)[1])
    assert push(Scenario(), "delay", 2.0).actuator.delay == 0.01
    assert np.all(np.array(push(base, "saturation", 2.0).actuator.torque_limit) < base.actuator.torque_limit)


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
    assert min(first.effort, second.effort) == 1.0
    assert all(policy != first.policy for policy, _, _ in result.overturned.values())


def test_an_arm_that_stays_is_not_safe():
    good = {"error_pct": 1.0, "baseline_error_pct": 80.0, "diverged": 0.0}
    rows = lambda diverged: tuple(good | {"diverged": float(i < diverged)} for i in range(16))
    base = run_cell(recommend.Cell("zero", BASE, (0,)))
    assert is_safe(dataclasses.replace(base, rows=rows(1)))
    assert not is_safe(dataclasses.replace(base, rows=rows(2)))  # lower bound 1.6 %
    assert not is_safe(dataclasses.replace(base, rows=(good | {"error_pct": 50.0},) * 16))


def test_the_command(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("benchmarks.cli.recommend.as_scenario", lambda name: BASE)
    arguments = ["recommend", "my_arm.toml", "--seeds", "2", "--workers", "1", "--store", str(tmp_path)]
    assert cli.main([*arguments, "--policies", "pd-gravity", "zero", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["safe"]
    assert data["choices"][0]["policy"] == "pd-gravity"
    lacks = tmp_path / "lacks.py"
    lacks.write_text("def make_policy(interface):\n    return {}['lost']\n")
    assert cli.main([*arguments, "--policies", "pd-gravity", str(lacks), "json:loads"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert f"without {lacks}: KeyError: 'lost'" in shown
    assert "without json:loads: TypeError: the JSON object must be" in shown
    assert cli.main([*arguments, "--policies", "zero"]) == 1
    assert "No policy is safe on short" in capsys.readouterr().out
    assert cli.main([*arguments, "--seeds", "1"]) == 2
    monkeypatch.setattr(recommend, "candidates", lambda: ("pd-gravity",))
    assert cli.main(arguments) == 0
    assert "pd-gravity" in capsys.readouterr().out


def test_the_check_on_drawn_arms(monkeypatch, tmp_path, capsys):
    pytest.importorskip("mujoco")
    draw = drawn_arms.draw
    assert draw(3) == draw(3)
    assert len({draw(i).arm for i in range(20)}) == 20
    monkeypatch.setattr(drawn_arms, "draw", lambda i: draw(i).replace(duration=0.3))
    few = ["1", "--seeds", "2", "--workers", "1", "--store", str(tmp_path), "--policies"]
    drawn_arms.main([*few, "pd-gravity", "computed-torque"])
    line, share, *always = capsys.readouterr().out.splitlines()
    assert sorted(text.split()[5].rstrip(":") for text in always) == ["computed-torque", "pd-gravity"]
    assert line.startswith(f"{draw(0).name}: ")
    assert "of 1 first choices within 1.5 times the best" in share
    drawn_arms.main([*few, "zero"])
    assert "none is safe" in capsys.readouterr().out
