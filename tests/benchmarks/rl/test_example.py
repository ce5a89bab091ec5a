"""The programs in `examples` run."""

import re
import runpy
import sys
from pathlib import Path


def test_ppo_batch_trains_and_evaluates(monkeypatch, capsys):
    path = Path(__file__).parents[3] / "examples" / "ppo_batch.py"
    arguments = ["--updates", "2", "--lanes", "8", "--steps", "510", "--epochs", "1"]  # beyond the end of an episode
    monkeypatch.setattr(sys, "argv", [str(path), *arguments])
    runpy.run_path(str(path), run_name="__main__")
    pattern = r"([\d,]+) steps .* error ([\d.]+) mrad, (\d+) of 32"
    steps, error, diverged = re.search(pattern, capsys.readouterr().out).groups()
    assert steps == "8,160"
    assert 1.0 < float(error) < 1e4
    assert 0 <= int(diverged) <= 32
