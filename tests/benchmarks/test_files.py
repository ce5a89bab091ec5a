"""Files of users: whatever a name stands for, no reader hangs, and no name is a formula or controls a terminal."""

import gzip
import os
import sys
from pathlib import Path

import pytest

from benchmarks.agents.agent import read
from benchmarks.cli.curves import read_groups
from benchmarks.cli.train import _hyperparameters
from benchmarks.files import write_text
from benchmarks.identification import logs
from benchmarks.policies.key import file_digest
from benchmarks.report.export import write_runs
from benchmarks.run.metrics import METRICS
from benchmarks.run.store import Store
from benchmarks.run.suite import load
from controllers.name import PolicyName
from fbl_gym import reading, scenarios
from fbl_gym.model.urdf import read_robot

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="has no named pipes")

DESCRIPTION = '{"interface": {}, "network": {"layers": 1}}'
READERS = {
    "arm.urdf": read_robot, "arm.toml": scenarios.get,
    "base.toml": lambda path: write_text(Path("of.toml"), f'base = "{path}"\n') or scenarios.get("of.toml"),
    "suite.toml": load, "log.csv": lambda path: logs.read(Path(path)), "log.csv.gz": lambda path: logs.read(Path(path)),
    "gains.json": lambda path: PolicyName.parse(f"pd-gravity@{path}").given_gains,
    "weights.npz": lambda path: write_text(Path("agent.json"), DESCRIPTION) or read(Path()),
    "agent.json": lambda path: read(Path()), "run.json": lambda path: read_groups([Path()]),
    "curve.csv": lambda path: write_text(Path("run.json"), '{"seed": 0}') or read_groups([Path()]),
    "hyperparameters.json": lambda path: _hyperparameters(Path(path), "ppo"),
    "result.json": lambda path: Store(Path()).load(Path(path)), "data.txt": lambda path: file_digest(Path(path)),
}  # fmt: skip


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("name", READERS)
def test_every_reader_refuses_what_is_no_regular_file(name):
    for make in (os.mkfifo, lambda path: os.symlink("/dev/zero", path), os.mkdir):
        make(name)
        with pytest.raises(ValueError, match="must be a regular file, got a"):
            READERS[name](name)
        (os.rmdir if make is os.mkdir else os.unlink)(name)


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_a_file_is_bounded_after_unpacking_too(pack, folder):
    (path := folder / ("a.gz" if pack is gzip.compress else "a")).write_bytes(pack(bytes(1000)))
    assert reading.read_bytes(path, 1000) == bytes(1000)
    with pytest.raises(ValueError, match=r"must have at most 0\.000999 MB"):
        reading.read_bytes(path, 999)


def test_files_have_no_control_characters_and_no_formulas(folder):
    write_text(folder / "a.json", '"\x1b[2J\x7f\u202e\n"')
    assert (folder / "a.json").read_text() == '"\\u001b[2J\\u007f\\u202e\n"'
    names = ("=cmd|'/C calc'!A0", "+1", "-1", " @x", "\x1b[2J", "plain", -1.5)
    write_runs(folder / "a.csv", ("name",), [((name,), (0,), [dict.fromkeys(METRICS, 1.0)]) for name in names])
    cells = [line.split(",")[0] for line in (folder / "a.csv").read_text().splitlines()[1:]]
    assert cells == ["'=cmd|'/C calc'!A0", "'+1", "'-1", "' @x", "\\u001b[2J", "plain", "-1.5"]


@pytest.mark.usefixtures("folder")
def test_a_path_of_any_depth_is_made():
    write_text(path := Path(*["a"] * 1200, "file"), "text")
    assert path.read_text() == "text"
    path.unlink()
    os.removedirs(path.parent)
