"""The programs in `examples/` run as they stand, with shorter numbers."""

import re
import runpy
import sys
from pathlib import Path

import pytest

ELSEWHERE = {"swing_up", "train_sb3", "run_on_robot", "priced_ppo", "class_speed"}
"""Run by `test_docs.py` and `controllers/test_runner.py`."""

EXAMPLES = [p for p in sorted((Path(__file__).parents[1] / "examples").glob("*.py")) if p.stem not in ELSEWHERE]

SHORTER = {
    "seeds=16": "seeds=2", "seeds=8": "seeds=2", "4096, 500": "16, 5", "(0.0, 0.005, 0.01, 0.015, 0.02)": "(0.0, 0.01)",
}  # fmt: skip
ARGUMENTS = {
    "offline_data": ["pd-gravity", "data.npz", "--episodes", "2"],
    "wrong_datasheet": ["geared", "zero"],
    "adjust_gains": ["servo", "pd-gravity"],
    "markov": ["nominal", "--lanes", "4", "--epochs", "1"],
    "ppo_batch": ["--updates", "2", "--lanes", "8", "--steps", "510", "--epochs", "1"],  # beyond the end of an episode
}
PRINTED = {
    "adjust_gains": r"pd-gravity: \d+ degrees, [\d.]+ samples, error [\d.]+ %",
    "ppo_batch": r"8,160 steps .* error [1-9]\d{0,3}(\.\d+)? mrad, ([12]?\d|3[0-2]) of 32",
}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(path, tmp_path, monkeypatch, capsys):
    text = path.read_text()
    for long, short in SHORTER.items():
        text = text.replace(long, short)
    if "import torch" in text:
        pytest.importorskip("torch")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [path.name, *ARGUMENTS.get(path.stem, ())])
    (tmp_path / path.name).write_text(text)
    runpy.run_path(path.name, run_name="__main__")
    assert re.search(PRINTED.get(path.stem, "."), capsys.readouterr().out)


def test_each_number_that_is_shortened_is_in_an_example():
    assert [long for long in SHORTER if not any(long in path.read_text() for path in EXAMPLES)] == []
