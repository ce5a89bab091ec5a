"""The command `fbl-gym train`, with hyperparameters that make it short."""

import json
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from benchmarks import cli
from benchmarks.rl.agent import describe

DOCS = Path(__file__).parents[3] / "docs"
PAGES = "\n".join(
    (DOCS / page).read_text() for page in ("how-to/train.md", "how-to/offline-learning.md", "results/agents.md")
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = {"n_steps": 20, "batch_size": 40, "learning_rate": 1e-3}
    Path("short.json").write_text(json.dumps({"ppo": {"lanes": 4, "steps": 80, "arguments": arguments}}))
    return tmp_path


def train(*options):
    return cli.main(["train", "ppo", *options, "--hyperparameters", "short.json"])


def test_options_reach_the_agent(folder, capsys):
    options = "--interface residual --history 1 --context --scenario mixed-error-1 --steps 80"
    assert train(*options.split()) == 0
    printed = capsys.readouterr()
    assert "agent: runs/ppo-residual-0" in printed.out
    assert "left" in printed.err
    description = describe(folder / "runs" / "ppo-residual-0")
    assert description["interface"]["history"] == 1
    assert description["interface"]["context"] is True
    assert description["scenario"]["name"] == "mixed-error-1"


@pytest.mark.slow
def test_the_pages_on_learning_run(tmp_path, monkeypatch):
    """Their training and recording commands with fewer steps, then its Python as printed, in one process."""
    monkeypatch.chdir(tmp_path)
    (command,) = [line for line in PAGES.splitlines() if line == "fbl-gym train ppo"]
    assert cli.main([*command.split()[1:], "--steps", "16384"]) == 0
    for line in PAGES.splitlines():
        if line.startswith("fbl-gym record") and find_spec("minari"):
            assert cli.main([*line.split()[1:], "--episodes", "2"]) == 0
    blocks = re.findall(r"```python\n(.*?)```", PAGES, flags=re.S)
    absent = [package for package in ("d3rlpy", "minari") if find_spec(package) is None]
    code = "\n".join(block for block in blocks if not any(f"import {package}" in block for package in absent))
    code = code.replace("learn(150_000)", "learn(2_048)").replace("range(20_000)", "range(20)")
    code = code.replace("(1, 3)", "()").replace("n_steps=10_000", "n_steps=20, n_steps_per_epoch=10")
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    assert (tmp_path / "trace.png").exists()
    for archive in ("model.zip", *([] if "minari" in absent else ["cloned.zip"])):
        assert cli.main(["evaluate", archive, "--trust", "--scenario", "everything-2", "--seeds", "1"]) == 0
    assert json.loads((tmp_path / "runs/ppo-torque-0/agent.json").read_text())["algorithm"] == "ppo"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--scenario mixed-eror-1", "did you mean 'mixed-error"),
        ("--hyperparameters lanes.json", "hyperparameters.lanes must be a whole number not below 1 and not above 1000"),
        ("--hyperparameters rate.json", "hyperparameters must have lanes, steps and arguments with a learning_rate"),
        ("--hyperparameters words.json", "hyperparameters.arguments must fit PPO: TypeError"),
        ("--hyperparameters list.json", "list.json must be JSON with an entry 'ppo': TypeError"),
        ("--hyperparameters none.json", "none.json must be JSON with an entry 'ppo': JSONDecodeError"),
    ],
)
def test_a_mistake_is_answered_with_what_is_right(options, message, folder, capsys):
    files = {
        "lanes": {"ppo": {"lanes": 1001, "steps": 80, "arguments": {"learning_rate": 1e-3}}},
        "rate": {"ppo": {"lanes": 4, "steps": 80, "arguments": {}}},
        "words": {"ppo": {"lanes": 4, "steps": 80, "arguments": {"learning_rate": 1e-3, "n_step": 3}}}, "list": [],
    }  # fmt: skip
    for name, content in files.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
    (folder / "none.json").touch()
    try:
        status = cli.main(["train", "ppo", "--hyperparameters", "short.json", *options.split()])
    except SystemExit as end:
        status = end.code
    assert status == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "content"),
    [("run.json", b""), ("run.json", b"[]"), ("checkpoint.pt", b"PK")],
)
def test_a_damaged_run_is_refused(name, content, folder, capsys):
    assert train("--steps", "80", "--out", "run") == 0
    (folder / "run" / name).write_bytes(content)
    capsys.readouterr()
    assert train("--steps", "80", "--out", "run") == 2
    assert "fbl-gym: only steps and minutes" in (said := capsys.readouterr().err) or "cannot be resumed" in said
