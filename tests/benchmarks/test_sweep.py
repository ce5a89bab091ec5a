"""A sweep measures policies over the values of options, goes on in the store, and writes all runs."""

import csv
import dataclasses
import shlex

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
