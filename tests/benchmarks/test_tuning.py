"""Trials find gains, and fresh seeds judge them."""

import json
import math
import shlex
import subprocess
import sys

import numpy as np
import optuna
import pytest

from benchmarks import cli
from benchmarks.policies.spec import resolve
from benchmarks.seeds import SPLITS
from benchmarks.tuning.search import Task, at_edge, judge, scenarios_of, seeds, summary, tune, write_gains
from controllers.gains import parse_gain
from fbl_gym import Scenario, scenarios

NOMINAL = (Scenario(),)

# Of the defaults (trial 0) and two others: kp, the objective of the trial, then objective and diverged runs [%] on fresh seeds.
TRIALS = ((None, 1.0, (0.5, 0.0)), (100.0, -3.0, (0.9, 4.0)), (50.12345, -2.0, (-1.9, 0.0)))


@pytest.fixture
def study():
    found = optuna.create_study()
    ends = optuna.distributions.FloatDistribution(1.0, 1000.0)
    for kp, value, _ in TRIALS:
        own = {} if kp is None else {"params": {"kp": kp}, "distributions": {"kp": ends}}
        found.add_trial(optuna.trial.create_trial(value=value, **own))
    return found


@pytest.fixture
def asked(monkeypatch):
    """The gains that were run, in turn."""
    found = []

    def cost(_, gains):
        found.append(gains)
        return TRIALS[{None: 0, 100.0: 1, 50.12: 2}[gains.get("kp")]][2]

    monkeypatch.setattr(Task, "cost", cost)
    return found


def test_fresh_seeds_overrule_the_trials(study, asked):
    """Trial 1 was best and fails on fresh seeds, so trial 2 is shipped. The defaults are judged in any case."""
    tried, fresh = seeds(16, 128)
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


def test_judging_is_on_tuning_seeds_that_no_trial_saw():
    tried, fresh = seeds(16, 128)
    assert len(tried) == 16
    assert len(fresh) == 128
    assert not set(tried) & set(fresh)
    assert {*tried, *fresh} <= set(SPLITS["tuning"])
    with pytest.raises(ValueError, match="there are 10000 tuning seeds, for trials and judging, got 16 and 9985"):
        seeds(16, 9985)


def studies(folder):
    return optuna.get_all_study_names(f"sqlite:///{folder}/studies.db")


def test_tune_goes_on_where_it_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr("controllers.registry.TUNED", tmp_path)
    few = ["--seeds", "2", "--fresh-seeds", "3", "--candidates", "2", "--scenarios", "nominal"]
    arguments = ["tune", "pid-flm", *few, "--storage", f"sqlite:///{tmp_path}/studies.db", "--ship"]
    assert cli.main([*arguments, "--trials", "1"]) == 0
    assert json.loads((tmp_path / "servo" / "pid-flm.json").read_text())["trials"]["count"] == 3  # one for each gain
    assert cli.main([*arguments, "--trials", "2"]) == 0
    found = json.loads((tmp_path / "servo" / "pid-flm.json").read_text())
    assert found["trials"]["count"] == 6
    assert found["trials"]["environment_steps"] == 6 * 2 * 1000
    assert found["trials"]["seeds"] == [SPLITS["tuning"].start, SPLITS["tuning"].start + 2]
    assert found["judged"]["environment_steps"] == 3 * 3 * 1000
    assert found["judged"]["count"] == 3
    assert found["judged"]["defaults"]["trial"] == 0
    assert set(found["gains"]) in (set(), {"kp", "ki", "kd"})
    task = Task("pid-flm", (scenarios.get("nominal"),), seeds(2, 3)[0])
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

from controllers.simple import PdGravity
from fbl_gym.records import number


@dataclass(frozen=True)
class Law(PdGravity):
    frequency: float = number(1.0, tune=(10.0, 40.0))
    damping: float = number(1.0)


make_policy = Law
"""


def test_a_law_of_ones_own_is_tuned_and_its_gains_are_tried(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "law.py").write_text(LAW)
    few = shlex.split(
        "--trials 3 --seeds 1 --fresh-seeds 1 --candidates 2 --scenarios nominal --storage sqlite:///studies.db"
    )
    for policy in ("law.py", "law.py:Law"):
        assert cli.main(["tune", policy, *few]) == 0
        first, *_, last = capsys.readouterr().out.splitlines()  # between them, whether a gain is at an edge
        assert first.startswith(f"{policy}: frequency=")
        assert last.endswith(f"use them as {policy}@results/gains")
        assert resolve(f"{policy}@results/gains").gains["frequency"] == float(first.split("=")[1])
        assert cli.main(["evaluate", f"{policy}@tuned"]) == 2
        assert f"`fbl-gym tune {policy} --class CLASS` finds some" in capsys.readouterr().err
    assert len(studies(tmp_path)) == 2
    # Changed code is another law, of which nothing was tried.
    (tmp_path / "law.py").write_text(f"{LAW}changed = True\n")
    assert cli.main(["tune", "law.py", *few]) == 0
    assert len(studies(tmp_path)) == 3


def gains_of(study):
    return [tuple(trial.params.values()) for trial in study.trials if trial.params]


@pytest.fixture
def quick_cost(monkeypatch):
    monkeypatch.setattr(Task, "cost", lambda _, gains: (sum(gains.values()), 0.0))


@pytest.mark.usefixtures("quick_cost")
def test_a_resumed_study_repeats_no_trial(tmp_path):
    task = Task("pid-flm", NOMINAL, seeds(1, 1)[0])
    for trials in (2, 3, 4, 5):
        study = tune(task, f"sqlite:///{tmp_path}/new/studies.db", trials=trials)
    assert len(gains_of(study)) == len(set(gains_of(study))) == 4


def test_pairs_of_default_gains_are_printed(tmp_path, capsys, monkeypatch):
    """The first trial of a law has its default gains, some of which are pairs."""
    monkeypatch.chdir(tmp_path)
    few = "--trials 1 --seeds 1 --candidates 1 --fresh-seeds 1 --scenarios servo-practice-nominal"
    assert cli.main(f"tune robust-flm {few}".split()) == 0
    assert "kp=" in capsys.readouterr().out


def test_a_pair_of_gains_is_one_for_each_joint():
    """To a law that never thought of pairs, too: it multiplies joints by it."""
    name, value = parse_gain("w=20,30")
    assert name == "w"
    assert list(value**2) == [400, 900]
    assert parse_gain("w=20") == ("w", 20.0)


def test_two_processes_share_a_study(tmp_path):
    storage = f"sqlite:///{tmp_path}/studies.db?timeout=60"
    line = f"tune pd-gravity --seeds 1 --fresh-seeds 1 --candidates 1 --scenarios nominal --storage {storage} --out {tmp_path}"
    assert cli.main([*line.split(), "--trials", "1"]) == 0
    command = [sys.executable, "-m", "fbl_gym", *line.split(), "--trials", "4"]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    for process in both:
        _, errors = process.communicate(timeout=300)
        assert process.returncode == 0, errors
    (name,) = studies(tmp_path)
    study = optuna.load_study(study_name=name, storage=storage)
    assert {trial.state.name for trial in study.trials} == {"COMPLETE"}
    gains = [tuple(trial.params.values()) for trial in study.trials if trial.params]
    assert len(set(gains)) == len(gains) >= 2


def test_gains_of_another_law_with_the_same_file_name_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "law.py").write_text(LAW)
    gains = {"policy": "a/law.py", "gains": {"frequency": 20.0}}
    path = write_gains(gains, tmp_path / "gains")
    write_gains(gains | {"policy": "./a/law.py"}, tmp_path / "gains")
    with pytest.raises(ValueError, match=r"law\.py\.json has the gains of \./a/law\.py, not of b/law\.py"):
        write_gains(gains | {"policy": "b/law.py"}, tmp_path / "gains")
    with pytest.raises(ValueError, match=r"law\.py\.json has the gains of \./a/law\.py, not of b/law\.py"):
        resolve("b/law.py@gains")
    assert json.loads(path.read_text())["policy"] == "./a/law.py"
    for text in ("a/law.py@gains", f"{tmp_path}/a/law.py@gains", f"a/law.py@{path}"):
        assert resolve(text).gains["frequency"] == 20.0


def test_a_gain_at_the_edge_of_its_range_is_named():
    found = {"gains": {"kp": 2.1, "ki": 20.0, "kd": np.array([5.0, 79.0]), "default": 0.0}}
    ranges = {"ranges": {"kp": [2.0, 200.0], "ki": [2.0, 200.0], "kd": [1.0, 80.0], "default": [1.0, 9.0]}}
    assert at_edge(found | ranges) == {"kp": (2.0, 200.0), "kd": (1.0, 80.0)}


def test_a_class_has_its_own_practice_and_folder(tmp_path, monkeypatch):
    monkeypatch.setattr("controllers.registry.TUNED", tmp_path)
    for robot in ("servo", "direct", "geared"):
        tried, judged = scenarios_of(robot)
        assert set(tried) < set(judged) == set(scenarios.in_tier(f"{robot}-practice"))
    few = "--trials 1 --seeds 1 --fresh-seeds 1 --candidates 1 --scenarios servo-practice-nominal"
    line = f"tune pd-gravity --class servo --ship {few} --storage sqlite:///{tmp_path}/studies.db"
    assert cli.main(line.split()) == 0
    assert json.loads((tmp_path / "servo" / "pd-gravity.json").read_text())["policy"] == "pd-gravity"
