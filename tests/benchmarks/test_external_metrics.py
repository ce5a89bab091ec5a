"""Metrics from a file: on the board, in the store and in CSV files; errors before the first run."""

import shlex

import numpy as np
import pytest

import benchmarks
from benchmarks import cli
from benchmarks.run.metrics import METRICS, find_metrics, measure
from benchmarks.run.rollout import rollout
from benchmarks.run.suite import Cell
from fbl_gym import scenarios

CODE = '''
import numpy as np

def peak_torque(trace):
    """Largest torque of joint 1 [N m]."""
    return _size(trace)[..., 0].max(axis=0)

def _size(trace):
    return np.abs(trace.torque)
'''


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(CODE)
    return tmp_path


def test_a_metric_is_a_function_of_a_trace():
    (metric,) = find_metrics("mine.py")
    assert (metric.name, metric.meaning) == ("peak_torque", "Largest torque of joint 1 [N m]")
    trace = rollout("pd-gravity", scenarios.get("nominal").replace(duration=0.5), range(3))
    rows = measure(trace, more=[metric])
    assert list(rows[0]) == [*METRICS, "peak_torque"]
    np.testing.assert_array_equal([row["peak_torque"] for row in rows], np.abs(trace.torque[..., 0]).max(axis=0))


def test_a_metric_reaches_no_other_number(folder):
    """In `evaluate` too, its code runs in another process."""
    (folder / "mine.py").write_text(f"import benchmarks\nbenchmarks.reached = True\n{CODE}")
    assert cli.main(["evaluate", "zero", "pd-gravity", "--seeds", "1", "--metrics", "mine.py"]) == 0
    assert not hasattr(benchmarks, "reached")


def test_a_module_names_a_metric():
    (metric,) = find_metrics("mine:peak_torque")
    assert metric.source == "mine:peak_torque"
    assert metric.digest == find_metrics("mine.py")[0].digest


def test_the_code_of_a_metric_is_part_of_the_key(folder):
    def key():
        return Cell("zero", "nominal", (0,), find_metrics("mine.py")).key

    before = key()
    assert before != Cell("zero", "nominal", (0,)).key
    (folder / "mine.py").write_text(CODE.replace("Largest", "The largest"))
    assert key() == before
    (folder / "mine.py").write_text(CODE.replace("np.abs", "np.square"))
    assert key() != before


def test_a_metric_is_a_column_of_each_table(folder, capsys):
    line = "--scenarios nominal --policies zero pd-gravity --seeds 2 --metrics mine.py"
    assert cli.main(shlex.split(f"leaderboard {line} --workers 1")) == 0
    assert "peak_torque" in capsys.readouterr().out
    assert cli.main(shlex.split(f"report {line} --out .")) == 0
    assert (folder / "board.csv").read_text().splitlines()[0].endswith(",peak_torque")
    assert "Largest torque of joint 1 [N m]: median of the runs" in (folder / "board.html").read_text()
    assert cli.main(shlex.split("evaluate zero pd-gravity --seeds 2 --metrics mine.py:peak_torque")) == 0
    assert cli.main(shlex.split("evaluate zero --seeds 1 --metrics mine.py")) == 0
    shown = capsys.readouterr().out
    assert shown.count("peak_torque") == 3
    (folder / "mine.py").write_text(CODE.replace("np.abs", "np.square"))
    assert cli.main(shlex.split(f"report {line} --out stale")) == 2  # those of older code are not reported


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("def iae(trace): return 1", "mine.py must have a name that no other column has, got 'iae'"),
        ("def Policy(trace): return 1", "mine.py must have a name that no other column has, got 'Policy'"),
        (
            "def power(trace): return trace.power",
            "mine.py:power raises AttributeError: 'Trace' object has no attribute",
        ),
        ("def power(trace): return trace.torque.max()", "must return a number for each seed, 3 in all, got "),
        ("def power(trace): return ['high'] * 3", "must return a number for each seed, 3 in all, got ['high', "),
        ("def power(trace): return [float('inf')] * 3", "must return a number for each seed, 3 in all, got [inf, "),
        ("power = 1", "mine.py must have a function of a trace"),
        ("def power(trace) return 1", "mine.py must be Python code"),
        (None, "metrics must be a Python file that exists, or module:function, got 'mine.py'"),
    ],
)
def test_a_wrong_metric_is_refused_before_the_first_run(folder, capsys, code, message):
    (folder / "mine.py").unlink() if code is None else (folder / "mine.py").write_text(code)
    with pytest.raises(SystemExit):
        cli.main(shlex.split("evaluate zero --metrics mine.py"))
    assert message in capsys.readouterr().err
