"""Speeds compared with a baseline, and peers."""

import json
import sys

import pytest

from benchmarks.speed import __main__, environments
from benchmarks.speed.environments import compare

ROWS = [{"name": "peer", "ratio": 1.0, "peer": ""}, {"name": "arm", "ratio": 8.0, "peer": "peer"}]


def test_ratios_are_compared_with_a_baseline():
    """A contestant that the baseline lacks is left out."""
    assert compare(ROWS, [ROWS[0], ROWS[1] | {"ratio": 4.0}]) == {"arm": 2.0}
    assert compare(ROWS, ROWS[:1]) == {}


def test_the_command_prints_and_stores_the_measurements(monkeypatch, tmp_path, capsys):
    path = tmp_path / "speed.json"
    contestants = {"peer": (lambda: 1, ""), "arm": (lambda: 8, "peer")}
    monkeypatch.setattr(environments, "_contestants", lambda: contestants)
    monkeypatch.setattr(environments, "ROUND_S", 0.01)
    for arguments in (["--json", str(path)], ["--baseline", str(path)]):
        monkeypatch.setattr(sys, "argv", ["speed", "--rounds", "1", *arguments])
        __main__.main()
    stored = json.loads(path.read_text())
    assert [row["name"] for row in stored["contestants"]] == ["peer", "arm"]
    assert "times its ratio in" in capsys.readouterr().out
    monkeypatch.setattr(sys, "argv", ["speed", "--rounds", "0"])
    with pytest.raises(SystemExit):
        __main__.main()
    assert "--rounds: must be at least 1, got 0" in capsys.readouterr().err
