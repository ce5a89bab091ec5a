"""The command `fbl-gym train`, with hyperparameters that make it short."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import cli
from benchmarks.rl.agent import describe

PAGE = Path(__file__).parents[3] / "docs" / "rl.md"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = {"n_steps": 20, "batch_size": 40, "learning_rate": 1e-3}
    Path("short.json").write_text(json.dumps({"ppo": {"lanes": 4, "steps": 80, "arguments": arguments}}))
    return tmp_path


def train(*options):
    return cli.main(["train", "ppo", *options, "--hyperparameters", "short.json"])


def test_options_reach_the_agent(folder, capsys):
    options = "--interface residual --history 1 --scenario mixed-error-1 --radius 0.1 --steps 80"
    assert train(*options.split()) == 0
    printed = capsys.readouterr()
    assert "agent: runs/ppo-residual-history-1-0" in printed.out
    assert "left" in printed.err
    description = describe(folder / "runs" / "ppo-residual-history-1-0")
    assert description["interface"]["history"] == 1
    assert description["scenario"]["parameter_error"]["radius"] == 0.1


def test_an_agent_can_have_context(folder):
    assert train("--context") == 0
    assert describe(folder / "runs" / "ppo-torque-context-0")["interface"]["context"] is True


@pytest.mark.usefixtures("folder")
def test_an_unknown_scenario_is_refused(capsys):
    assert train("--scenario", "mixed-eror-1") == 2
    assert "did you mean 'mixed-error" in capsys.readouterr().err


def test_the_page_on_learning_runs(tmp_path, monkeypatch):
    """Its training command with fewer steps, then its Python as printed."""
    monkeypatch.chdir(tmp_path)
    (command,) = [line for line in PAGE.read_text().splitlines() if line == "fbl-gym train ppo"]
    assert cli.main([*command.split()[1:], "--steps", "16384"]) == 0
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.S):
        process = subprocess.run([sys.executable, "-c", block], capture_output=True, text=True)
        assert process.returncode == 0, process.stderr
    assert (tmp_path / "trace.png").exists()
    assert json.loads((tmp_path / "runs/ppo-torque-0/agent.json").read_text())["algorithm"] == "ppo"
