"""A sweep measures policies over the values of options, goes on in the store, and writes all runs."""

import csv
import dataclasses
import shlex

import numpy as np
import pytest

from benchmarks import cli
from benchmarks.run.suite import with_option
from fbl_gym import scenarios


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text('base = "noise-1"\nduration = 0.5')
    return tmp_path


def rows(path):
    with open(path) as file:
        return list(csv.DictReader(file))


def test_an_option_changes_where_its_path_leads():
    base = scenarios.get("noise-1")
    scenario = with_option(base, "noise.position", 0.01)
    assert scenario.name == "noise-1,noise.position=0.01"
    assert scenario.noise.velocity == base.noise.velocity
    assert scenario.noise.position == base.replace(noise={"position": 0.01}).noise.position
    assert with_option(base, "arm.m1", 7.0).arm.m1 == 7.0
    # Ranges that agents generalise over are values of the radius.
    trained_on = scenarios.get("everything-2")
    swept = with_option(trained_on, "parameter_error.radius", 2.0)
    assert swept.parameter_error == dataclasses.replace(trained_on.parameter_error, radius=2.0)


def test_one_option(folder):
    line = "sweep pd-gravity zero --over noise.position=1e-4:1e-2:log:3 --scenario arm.toml --seeds 2 --workers 1"
    assert cli.main(shlex.split(line)) == 0
    runs = rows("results/sweep.csv")
    assert len(runs) == 3 * 2 * 2
    assert [run["noise.position"] for run in runs[::4]] == ["0.0001", "0.001", "0.01"]
    assert (folder / "results/sweep.png").stat().st_size > 1000
    stored = {path: path.stat().st_mtime_ns for path in (folder / "results/board").iterdir()}
    assert cli.main(shlex.split(line)) == 0
    assert stored == {path: path.stat().st_mtime_ns for path in (folder / "results/board").iterdir()}


def test_two_options_give_every_pair_of_values(folder):
    line = "sweep pd-gravity --over arm.m2=2,4 --over noise.position=0:1e-2:lin:2 --scenario arm.toml --seeds 1"
    assert cli.main(shlex.split(f"{line} --workers 1 --csv two.csv --plot two.svg")) == 0
    assert [(run["arm.m2"], run["noise.position"]) for run in rows("two.csv")] == [
        ("2.0", "0.0"), ("2.0", "0.01"), ("4.0", "0.0"), ("4.0", "0.01"),
    ]  # fmt: skip
    drawn = (folder / "two.svg").read_text()
    assert "pd-gravity, noise.position 0<" in drawn
    assert "pd-gravity, noise.position 0.01<" in drawn


@pytest.mark.parametrize(
    ("over", "message"),
    [
        ("--over noise.position=1:2:log", "must be such as noise.position=1e-4:1e-2:log:9"),
        ("--over noise.position=0.0010000001,0.0010000002", "must have values that differ in their first six digits"),
        ("--over nois.position=1,2", "unknown field of scenario 'nois'; did you mean 'noise'"),
        (
            "--over arm.m1=1 --over arm.m2=1 --over arm.m1=2",
            "--over must name options that are no part of each other, got arm.m1 arm.m2 arm.m1",
        ),
    ],
)
def test_a_wrong_sweep_is_refused(over, message, capsys):
    try:
        status = cli.main(shlex.split(f"sweep zero {over}"))
    except SystemExit as end:
        status = end.code
    assert status == 2
    assert message in capsys.readouterr().err


def test_a_trace_has_names_with_units():
    assert cli.main(shlex.split("evaluate pd-gravity --scenario arm.toml --seeds 2 --trace trace.csv")) == 0
    samples = [row for row in rows("trace.csv") if row["seed"] == "1"]
    assert (len(samples), samples[-1]["time_s"]) == (51, "0.5")
    assert set(samples[0]) >= {"alive", "velocity_1_rad_s", "torque_2_Nm", "payload_kg"}
    assert np.isfinite([float(row["position_2_rad"]) for row in samples]).all()


def test_a_trace_of_another_format_is_refused_before_the_run(capsys):
    with pytest.raises(SystemExit):
        cli.main(shlex.split("evaluate pd-gravity --trace trace.txt"))
    assert "must end in .csv, got 'trace.txt'" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["tune pid-flm --scenarios", "train ppo --steps 10 --scenario"])
def test_a_judged_scenario_is_neither_tuned_nor_trained_on(command, capsys):
    assert cli.main([*command.split(), "servo-noise-2"]) == 2
    error = capsys.readouterr().err
    assert "servo-noise-2" in error
    assert "its motion is the board's" in error
