"""The programs in `examples/` run as they stand, with shorter numbers."""

import re
import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))

SHORTER = {
    "seeds=16": "seeds=2", "seeds=8": "seeds=2", "150_000": "64", "4096, 500": "16, 5", "range(400)": "range(40)",
    "(0.0, 0.005, 0.01, 0.015, 0.02)": "(0.0, 0.01)", 'device="cpu")': 'device="cpu", n_steps=64)',
}  # fmt: skip
ARGUMENTS = {
    "offline_data": ["pd-gravity", "data.npz", "--episodes", "2"],
    "markov": ["nominal", "--lanes", "4", "--epochs", "1"],
}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(path, tmp_path, monkeypatch, capsys):
    text = path.read_text()
    for root in ("torch", "stable_baselines3"):
        if re.search(rf"^(import|from) {root}", text, flags=re.M):
            pytest.importorskip(root)
    for long, short in SHORTER.items():
        text = text.replace(long, short)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [path.name, *ARGUMENTS.get(path.stem, ())])
    (tmp_path / path.name).write_text(text)
    runpy.run_path(path.name, run_name="__main__")
    assert capsys.readouterr().out


def test_each_number_that_is_shortened_is_in_an_example():
    assert [long for long in SHORTER if not any(long in path.read_text() for path in EXAMPLES)] == []
