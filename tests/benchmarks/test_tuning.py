"""Trials find gains, fresh seeds judge them, and `fbl-gym recommend` tunes briefly for a robot's conditions."""

import dataclasses
import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import optuna
import pytest

from benchmarks.policies.spec import resolve
from benchmarks.run.linearize import linearize
from benchmarks.run.loop import LEAST_DELAY, LEAST_PHASE
from benchmarks.run.runner import run_cell
from benchmarks.seeds import SPLITS
from benchmarks.studies import recommend
from benchmarks.studies.recommend import around, is_safe, likeness, push
from benchmarks.tuning import brief, search
from benchmarks.tuning.search import Task, at_edge, judge, scenarios_of, seeds, summary, tune, write_gains
from controllers.registry import tuned_gains
from fbl_gym import Scenario, scenarios
from fbl_gym.model.arm import ArmParameters
from fbl_gym.records.record import ends
from fbl_gym.scenarios import as_scenario, held_out_reason

NOMINAL = (Scenario(),)

# Of the defaults (trial 0) and two others: kp, the objective of the trial, then objective and diverged runs [%] on fresh seeds.
TRIALS = ((None, 1.0, (0.5, 0.0)), (100.0, -3.0, (0.9, 4.0)), (50.12345, -2.0, (-1.9, 0.0)))


@pytest.fixture
def study():
    found = optuna.create_study()
    reach = optuna.distributions.FloatDistribution(1.0, 1000.0)
    for kp, value, _ in TRIALS:
        own = {} if kp is None else {"params": {"kp": kp}, "distributions": {"kp": reach}}
        found.add_trial(optuna.trial.create_trial(value=value, **own))
    return found


@pytest.fixture
def asked(monkeypatch):
    """The gains that were run, in turn."""
    found = []

    def cost(_, gains, *_best):
        found.append(gains)
        return TRIALS[{None: 0, 100.0: 1, 50.12: 2}[gains.get("kp")]][2]

    monkeypatch.setattr(Task, "cost", cost)
    return found


def test_fresh_seeds_overrule_the_trials(study, asked):
    """Trial 1 was best and fails on fresh seeds, so trial 2 is shipped. The defaults are judged in any case."""
    tried, fresh = seeds(16, 128)
    assert (len({*tried}), len({*fresh}), len({*tried, *fresh})) == (16, 128, 144)
    assert {*tried, *fresh} <= set(SPLITS["tuning"])
    task, judging = Task("pid-flm", NOMINAL, tried), Task("pid-flm", (*NOMINAL, scenarios.get("noise-2")), fresh)
    verdicts = judge(judging, study, 2)
    assert [verdict["trial"] for verdict in verdicts] == [2, 0, 1]
    found = summary(task, study, judging, verdicts, "")
    assert found["gains"] == {"kp": 50.12} == asked[-1]
    assert found["judged"]["defaults"] == {"trial": 0, "objective": 0.5, "diverged_pct": 0.0}
    # What was judged is not run again, unless on something else.
    assert judge(judging, study, 2) == verdicts
    assert len(asked) == 3
    judge(task, study, 1)
    assert len(asked) == 5


def test_gains_pay_for_small_margins():
    """The least of eight arms counts, and the price of gains that cannot be the best is left out."""
    task = Task("pid-flm", (scenarios.get("servo-practice-nominal"),), range(3), (60.0, 0.0))
    gains = tuned_gains("pid-flm@servo")
    loops = [linearize("pid-flm@servo", task.scenarios[0], seed=seed).margins() for seed in range(8)]
    free, paid, hopeless = task.cost(gains, -9.0)[0], task.cost(gains)[0], task.cost(gains, 9.0)[0]
    assert paid - free == pytest.approx(1.0 - min(min(loop.phase) for loop in loops) / 60.0, rel=1e-3)
    assert (paid > free, hopeless) == (True, paid)
    assert dataclasses.replace(task, margins=(0.0, 0.0)).cost(gains)[0] == free


def studies(folder):
    return optuna.get_all_study_names(f"sqlite:///{folder}/studies.db")


def test_tune_goes_on_where_it_stopped(tmp_path, monkeypatch, fbl_gym):
    monkeypatch.setattr("controllers.name.TUNED", tmp_path)
    few = ["--seeds", "2", "--fresh-seeds", "3", "--candidates", "2", "--scenarios", "nominal"]
    arguments = ["tune", "pid-flm", *few, "--storage", f"sqlite:///{tmp_path}/studies.db", "--ship"]
    first = SPLITS["tuning"].start
    for trials in (1, 2):
        fbl_gym([*arguments, "--trials", str(trials)])
        found = json.loads((tmp_path / "servo" / "pid-flm.json").read_text())
        effort = {"count": 3 * trials, "environment_steps": 3 * trials * 2 * 1000, "seeds": [first, first + 2]}
        assert found["trials"].items() >= effort.items()  # so many trials for each gain
    assert found["judged"]["environment_steps"] == 3 * found["judged"]["count"] * 1000
    assert 3 <= found["judged"]["count"] <= 5  # those of the first run are kept
    assert found["judged"]["defaults"]["trial"] == 0
    assert set(found["gains"]) in (set(), {"kp", "ki", "kd"})
    task = Task("pid-flm", (scenarios.get("nominal"),), seeds(2, 3)[0], (LEAST_PHASE, LEAST_DELAY))
    assert studies(tmp_path) == [f"pid-flm {task.digest}"]


def test_the_objective_needs_no_torque_limits_and_prices_each_diverged_run():
    free = scenarios.get("nominal").replace(actuator=None)
    stiff, soft = (Task("pd-gravity", (free,), range(4)).cost({"frequency": w}) for w in (10.0, 5.0))
    assert stiff[1] == soft[1] == 0.0
    assert stiff[0] < soft[0]
    tight = free.replace(limits={"velocity": 1e-3})
    objective, diverged = Task("pd-gravity", (free, tight), range(4)).cost({})
    assert diverged == 50.0
    assert objective > 50 * math.log(2)


LAW = """
from dataclasses import dataclass

from controllers.laws.simple import PdGravity
from fbl_gym.records.record import number


@dataclass(frozen=True)
class Law(PdGravity):
    frequency: float = number(1.0, tune=(10.0, 40.0))
    damping: float = number(1.0)


make_policy = Law
"""


def test_a_law_of_ones_own_is_tuned_and_its_gains_are_tried(folder, fbl_gym):
    (folder / "law.py").write_text(LAW)
    few = "--trials 3 --seeds 1 --fresh-seeds 1 --candidates 2 --scenarios nominal --storage sqlite:///studies.db"
    for policy in ("law.py", "law.py:Law"):
        first, *_, last = fbl_gym(f"tune {policy} {few}").out.splitlines()  # between them, whether a gain is at an edge
        assert first.startswith(f"{policy}: frequency=")
        assert last.endswith(f"use them as {policy}@results/gains")
        assert resolve(f"{policy}@results/gains").gains["frequency"] == float(first.split("=")[1])
        assert f"`fbl-gym tune {policy} --class CLASS` finds some" in fbl_gym(f"evaluate {policy}@tuned", 2).err
    assert len(studies(folder)) == 2
    # Changed code is another law, of which nothing was tried.
    (folder / "law.py").write_text(f"{LAW}changed = True\n")
    fbl_gym(f"tune law.py {few}")
    assert len(studies(folder)) == 3


def gains_of(study):
    return [tuple(trial.params.values()) for trial in study.trials if trial.params]


def test_a_resumed_study_repeats_no_trial(tmp_path, monkeypatch):
    monkeypatch.setattr(Task, "cost", lambda _, gains, best: (sum(gains.values()), 0.0))
    task = Task("pid-flm", NOMINAL, seeds(1, 1)[0])
    for trials in (2, 3, 4, 5):
        study = tune(task, f"sqlite:///{tmp_path}/new/studies.db", trials=trials)
    assert len(gains_of(study)) == len(set(gains_of(study))) == 4


def test_gains_that_a_law_refuses_fail_their_trial(tmp_path, monkeypatch):
    monkeypatch.setattr(Task, "cost", lambda _, gains, best: (1 / (not gains), 0.0))
    for _ in range(2):  # the second call adds none
        study = tune(Task("pid-flm", NOMINAL, seeds(1, 1)[0]), f"sqlite:///{tmp_path}/studies.db", trials=3)
    assert [trial.state.name for trial in study.trials] == ["COMPLETE", "FAIL", "FAIL"]


def test_two_processes_share_a_study(tmp_path):
    """They also make its database at the same time."""
    storage = f"sqlite:///{tmp_path}/studies.db?timeout=60"
    line = f"tune pd-gravity --seeds 1 --fresh-seeds 1 --candidates 1 --scenarios nominal --storage {storage} --out {tmp_path}"
    command = [sys.executable, "-m", "fbl_gym", *line.split(), "--trials", "4"]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    for process in both:
        _, errors = process.communicate(timeout=300)
        assert process.returncode == 0, errors
    (name,) = studies(tmp_path)
    study = optuna.load_study(study_name=name, storage=storage)
    assert {trial.state.name for trial in study.trials} == {"COMPLETE"}
    assert len(set(gains_of(study))) == len(gains_of(study)) >= 2


def test_gains_of_another_law_with_the_same_file_name_are_refused(folder):
    for name in ("a", "b"):
        (folder / name).mkdir()
        (folder / name / "law.py").write_text(LAW)
    gains = {"policy": "a/law.py", "gains": {"frequency": 20.0}}
    path = write_gains(gains, folder / "gains")
    write_gains(gains | {"policy": "./a/law.py"}, folder / "gains")
    with pytest.raises(ValueError, match=r"law\.py\.json has the gains of \./a/law\.py, not of b/law\.py"):
        write_gains(gains | {"policy": "b/law.py"}, folder / "gains")
    with pytest.raises(ValueError, match=r"law\.py\.json has the gains of \./a/law\.py, not of b/law\.py"):
        resolve("b/law.py@gains")
    assert json.loads(path.read_text())["policy"] == "./a/law.py"
    for text in ("a/law.py@gains", f"{folder}/a/law.py@gains", f"a/law.py@{path}"):
        assert resolve(text).gains["frequency"] == 20.0


def test_a_gain_at_the_edge_of_its_range_is_named():
    found = {"gains": {"kp": 2.1, "ki": 20.0, "kd": np.array([5.0, 79.0]), "default": 0.0}}
    ranges = {"ranges": {"kp": [2.0, 200.0], "ki": [2.0, 200.0], "kd": [1.0, 80.0], "default": [1.0, 9.0]}}
    assert at_edge(found | ranges) == {"kp": (2.0, 200.0), "kd": (1.0, 80.0)}


def test_a_class_has_its_own_practice_and_folder(tmp_path, monkeypatch, fbl_gym):
    monkeypatch.setattr("controllers.name.TUNED", tmp_path)
    for robot in ("servo", "direct", "geared"):
        tried, judged = scenarios_of(robot)
        assert set(tried) < set(judged) == set(scenarios.in_tier(f"{robot}-practice"))
    few = "--trials 1 --seeds 1 --fresh-seeds 1 --candidates 1 --scenarios servo-practice-nominal"
    line = f"tune robust-flm --class servo --ship {few} --storage sqlite:///{tmp_path}/studies.db"
    assert "kp=" in fbl_gym(line).out  # of the defaults, some of which are pairs
    assert json.loads((tmp_path / "servo" / "robust-flm.json").read_text())["policy"] == "robust-flm"


BASE = scenarios.get("servo-nominal").replace(name="short", duration=0.6)


def run_cells(cells):
    return {cell: run_cell(cell) for cell in cells}


@pytest.mark.parametrize(("name", "classes"), [
    ("servo-nominal", ("servo",)), ("servo-elastic-2", ("servo",)), ("direct-nominal", ("direct",)),
    ("direct-dfki-a0", ("direct",)), ("geared-nominal", ("geared",)), ("geared-friction-3", ("geared",)),
    ("nominal", ("servo",)), (Scenario(control_dt=0.004), ("direct", "servo")),
])  # fmt: skip
def test_the_class_of_a_robot(name, classes):
    assert likeness(as_scenario(name))[0] == classes


@pytest.mark.parametrize("name", ["nominal", "servo-nominal", "geared-nominal", "servo-everything-2", "paper-6a"])
def test_a_condition_changes_one_option(name):
    base = scenarios.get(name)
    every = around(base)
    assert next(iter(every.values())) is base
    assert ("elastic" in every) == (base.joint is not None)
    for kind, scenario in every.items():
        changed = {field for field, value in vars(scenario).items() if value != getattr(base, field)} - {"name"}
        if kind == "data sheet":
            assert changed <= {"actuator", "joint", "datasheet"}
        else:
            assert len(changed) == (0 if kind == "as described" else 1) or kind == "everything", (kind, changed)


def test_sizes_are_twice_the_given_ones():
    base = scenarios.get("servo-everything-2")
    total = lambda s: ends(s.actuator.delay)[1] + s.actuator.delay_samples * s.control_dt
    assert total(push(base, "delay", 2.0, "servo")) == pytest.approx(2 * total(base))
    assert push(base, "lag", 2.0, "servo").actuator.lag == pytest.approx(2 * ends(base.actuator.lag)[1])
    for field in ("viscous", "coulomb", "stiction"):
        pushed, given = (getattr(s.friction, field) for s in (push(base, "friction", 2.0, "servo"), base))
        assert ends(pushed) == pytest.approx([2 * x for x in ends(given)])
    radius = push(base, "parameters", 2.0, "servo").parameter_error.radius
    assert radius == pytest.approx(2 * base.parameter_error.radius)
    assert ends(push(base, "noise", 2.0, "servo").noise.position.sigma)[1] == 2 * ends(base.noise.position.sigma)[1]
    stiffness = ends(push(base, "elastic", 2.0, "servo").joint.stiffness)[1]
    assert stiffness == pytest.approx(0.5 * ends(base.joint.stiffness)[1])
    soft = Scenario(link={"frequency": {"uniform": [4.0, 8.0]}}, joint={"frequency": 4.0, "rotor_inertia": 1.0})
    softer = push(soft, "elastic", 2.0, "servo")
    assert ends(softer.link.frequency[0]) == pytest.approx((8**0.5, 32**0.5))
    assert softer.joint.frequency == pytest.approx((8**0.5, 8**0.5))
    assert all(push(s, "elastic", 2.0, "servo") == s for s in (Scenario(), Scenario(link=1.5)))  # rigid, and too soft
    assert push(Scenario(), "delay", 2.0, "servo").actuator.delay == 0.01
    for robot, lag in (("servo", 0.015), ("direct", 0.002)):
        assert push(Scenario(), "lag", 2.0, robot).actuator.lag == lag
    assert np.all(np.array(push(base, "saturation", 2.0, "servo").actuator.torque_limit) < base.actuator.torque_limit)
    for noise, std in (({"density": 1e-4}, 1e-4 / 0.02**0.5), ({"snr_db": 40.0}, 0.01)):
        noisy = push(Scenario(noise={"position": noise}), "noise", 2.0, "servo")
        assert noisy.noise.position.sigma == pytest.approx((2 * std, 2 * std))
    loaded = push(base.replace(parameter_error={"payload": {"mass": 1.0, "offset": 0.2}}), "payload", 2.0, "servo")
    assert loaded.parameter_error.payload.offset == 0.2
    assert push(Scenario(actuator={"gain": 0.1}), "torque constant", 2.0, "servo").actuator.gain[0].uniform[0] == 0.0
    slow = Scenario(control_dt=0.015, physics_dt=0.0015, duration=1.5)
    assert push(slow, "disturbance", 2.0, "servo").disturbance.period == pytest.approx(0.4995)
    rubbing = Scenario(friction={"viscous": 900.0})  # almost too much for its physics step
    assert push(rubbing, "friction", 2.0, "servo").physics_dt == 0.5 * rubbing.physics_dt


@pytest.fixture(scope="module")
def result():
    return recommend.recommend(BASE, ["pd-gravity", "computed-torque", "zero"], 4, run_cells)


def test_the_choice(result):
    assert result.safe
    assert {choice.policy for choice in result.choices} == {"pd-gravity", "computed-torque"}  # zero is not safe
    first, second = result.choices
    assert first.errors_pct.shape == first.lost.shape == (len(result.conditions), 4) == (12, 4)
    assert min(first.effort, second.effort) == 1.0
    assert first.safe > second.safe
    assert first.phase_deg > 30.0 > second.phase_deg


def test_small_margins_and_equal_runs_are_said(fbl_gym, monkeypatch):
    """`computed-torque-eso@tuned` has 15 degrees on servo-nominal; another name of a law has the same runs."""
    monkeypatch.setattr("benchmarks.cli.recommend.as_scenario", lambda name: BASE)
    policies = ["--policies", "computed-torque-eso@tuned", "pd-gravity", "pd-gravity@damping=1x"]
    shown = fbl_gym(["recommend", "arm", "--trials", "0", "--seeds", "2", "--workers", "1", *policies]).out
    assert re.search("the same runs as pd-gravity.*: pd-gravity", shown)
    assert "computed-torque-eso@tuned (unsafe)" in shown


def test_a_wrong_data_sheet_lies_on_both_sides():
    for name in ("servo-nominal", "geared-nominal"):
        base = scenarios.get(name)
        pushed, drive = push(base, "data sheet", 2.0, name[:6]), base.actuator
        told = drive.facts(base)["delay"]
        assert pushed.datasheet.delay == pytest.approx(sum(told) / 2)
        assert ends(pushed.actuator.delay)[1] == pytest.approx(recommend.middle(drive.delay) + 0.5 * base.control_dt)
        assert ends(pushed.actuator.lag) == pytest.approx([recommend.middle(drive.lag) * x for x in (1 / 1.4, 1.4)])
        if base.joint is not None:
            assert pushed.datasheet.stiffness == pytest.approx([*map(recommend.middle, base.joint.stiffness)])


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


@pytest.mark.usefixtures("folder")
def test_brief_tuning_improves_a_law_and_goes_on():
    storage, gains, news, margins = search.STORAGE, Path("results/gains"), [], (0.0, 0.0)
    arguments = {"margins": margins, "workers": 1, "command": ""}
    policies = ["ppo-blend", "pd-gravity", "zero", "pd-gravity@damping=1"]
    names = brief.tune_briefly(BASE, policies, 8, report=lambda *part: news.append(part), **arguments)
    assert news[-1][0] == 1.0
    (task,) = brief.tasks_of(BASE, policies, margins)
    assert held_out_reason(BASE)
    assert brief.practice(BASE.replace(control_dt=1 / 64, physics_dt=1 / 640, duration=10.0)).steps == 307
    assert not any(held_out_reason(scenario) for scenario in task.scenarios)
    trials = search.finished(search.open_study(task, storage))
    assert min(trial.value for trial in trials) < trials[0].value
    assert names in ([f"pd-gravity@{gains / 'short'}"], ["pd-gravity@servo"])
    study = search.open_study(dataclasses.replace(task, seeds=range(1)), storage)
    study.enqueue_trial(dict.fromkeys(task.ranges, 10.0))
    study.tell(study.ask(dict.fromkeys(task.ranges, optuna.distributions.FloatDistribution(1.0, 1e3))), -9.0)
    new = brief.write_best(dataclasses.replace(task, seeds=range(1)), storage, gains, "")
    assert new == f"pd-gravity@{gains}"
    assert resolve(new).parsed.given_gains == dict.fromkeys(task.ranges, 10.0)
    assert resolve(new).parsed.gains_of_other_arms(BASE.arm) == []
    assert len(resolve(new).parsed.gains_of_other_arms(ArmParameters())) == 1
    brief.tune_briefly(BASE, policies, 1, report=lambda *_: None, **arguments)
    assert len(search.finished(search.open_study(task, storage))) > len(trials)


def test_the_command(folder, fbl_gym, monkeypatch):
    monkeypatch.setattr("benchmarks.cli.recommend.as_scenario", lambda name: BASE)
    few = ["--seeds", "2", "--workers", "1", "--store", str(folder / "store")]
    loose = ["--least-phase", "0", "--least-delay", "0"]
    printed = fbl_gym(["recommend", "my_arm.toml", *few, "--policies", "pd-gravity", "--trials", "4", *loose]).out
    assert "class: servo (100 Hz, rigid joints, dry friction of 10 % of" in printed
    assert "pd-gravity@" in printed
    assert "torque constant" in printed
    median, worst = re.search(r"([\d.]+) % +([\d.]+) % +0 of 24 \(< 14\.2 %\) +1\.00 ", printed).groups()
    assert float(median) < float(worst)
    arguments = ["recommend", "my_arm.toml", *few, "--trials", "0"]
    assert "error by condition" in fbl_gym([*arguments, "--policies", "pd-gravity", "zero"]).out
    lacks = folder / "lacks.py"
    lacks.write_text("def make_policy(interface):\n    return {}['lost']\n")
    shown = " ".join(fbl_gym([*arguments, "--policies", "pd-gravity", str(lacks), "json:loads"]).out.split())
    assert f"without {lacks}: KeyError: 'lost'" in shown
    assert "without json:loads: TypeError: the JSON object must be" in shown
    assert "No policy is safe on short" in fbl_gym([*arguments, "--policies", "zero"], 1).out
    fbl_gym([*arguments, "--seeds", "1"], 2)
