"""Verification of cells, and the promises of policies."""

import dataclasses
import sys

import pytest

from benchmarks.policies.spec import resolve
from benchmarks.run.cell import Cell
from benchmarks.run.contract import check
from benchmarks.run.runner import run_cell
from benchmarks.run.store import Store
from fbl_gym import TwoLinkArmEnv


def test_verify_command(tmp_path, fbl_gym):
    store, published = Store(tmp_path), run_cell(Cell("pid-flm", "noise-1", (0, 1)))
    path = store.save(published)
    shown = fbl_gym(f"verify pid-flm/noise-1 --store {tmp_path}").out
    assert "pid-flm/noise-1, 2 seeds: holds, bit for bit" in shown
    forged = ({**published.rows[0], "error_pct": 0.001}, *published.rows[1:])
    store.save(dataclasses.replace(published, rows=forged))
    shown = fbl_gym(f"verify {path}", 1).out
    assert "DIFFERS: error_pct by up to" in shown
    assert "the policy keeps every promise that check-policy checks" in shown
    assert "did you mean 'pid-flm/noise-1'" in fbl_gym(f"verify pid-flm/noise-2 --store {tmp_path}", 2).err


CHEAT = """
import numpy as np
class make_policy:
    def __init__(self, interface):
        self.calls = 0
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.calls += 1
        observation[..., 0] += 1.0
        return np.full((*observation.shape[:-1], 2), 1.0 + self.calls), None
"""


def test_broken_promises_are_found(tmp_path, fbl_gym):
    """It keeps its state in itself, acts outside the box, and changes what it is given."""
    (tmp_path / "cheat.py").write_text(CHEAT)
    shown = fbl_gym(f"check-policy {tmp_path}/cheat.py", 1).out
    assert "BROKEN  actions have the observations' shape, are finite and lie in the box" in shown
    assert "BROKEN  predict is a function" in shown


FORGETFUL = """
from controllers.laws.simple import PdGravity
class make_policy(PdGravity):
    def torque(self, observation, state):
        return gain * observation, state
"""


def test_a_mistake_is_said_with_its_line(folder, fbl_gym):
    (folder / "forgetful.py").write_text(FORGETFUL)
    shown = fbl_gym("check-policy forgetful.py", 1).out
    assert shown.count("NameError: name 'gain' is not defined (forgetful.py:5)") == shown.count("BROKEN") == 6
    assert "breaks 6 promises" in shown


#: A gain that amplifies a last bit, and a sum that rounds by the size of its batch.
ROUNDED = """
import numpy as np
from controllers.laws.simple import PdGravity
class make_policy(PdGravity):
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        position = np.asarray(observation)[..., self.interface.layout["position"]]
        action = np.tanh(-100 * position + 1e-6 * (np.ndim(observation) == 2))
        return LANE_ACTION, None
"""


@pytest.mark.parametrize(("action", "kept"), [("action", True), ("action - action.mean(axis=0)", False)])
def test_lanes_are_compared_on_the_same_readings(action, kept, tmp_path):
    """Rounding that a closed loop amplifies is no broken promise; a lane that knows of the others is one."""
    file = tmp_path / "rounded.py"
    file.write_text(ROUNDED.replace("LANE_ACTION", f"np.clip({action}, -1, 1)"))
    (lanes,) = [found for found in check(str(file)) if found.promise == "a lane of a batch acts as a single policy"]
    assert lanes.kept is kept, lanes.detail


UNSTABLE = """
import numpy as np
class make_policy:
    def __init__(self, interface):
        pass
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        last = np.zeros((len(np.atleast_2d(observation)), 2)) if state is None else state
        begins = np.broadcast_to(False if episode_start is None else episode_start, len(last))
        was = np.where(begins[:, None], 0.0, last)
        last = np.clip(1.05 * MEMORY + 1e-7 * (np.ndim(observation) == 2), -1, 1)
        return (was if np.ndim(observation) == 2 else was[0]), last
"""


def test_a_policy_may_amplify_last_bits_by_its_own_actions(folder, fbl_gym):
    mixed = "(0 * was + np.atleast_2d(observation)[:, :2].mean(axis=0))"
    for name, memory in (("unstable", "was"), ("mixing", mixed)):
        (folder / f"{name}.py").write_text(UNSTABLE.replace("MEMORY", memory))
    fbl_gym("check-policy unstable.py --scenario servo-nominal")
    assert "BROKEN  a lane of a batch acts as" in fbl_gym("check-policy mixing.py --scenario servo-nominal", 1).out


HELPED = """
from helper import GAIN
from controllers.laws.simple import PdGravity
make_policy = lambda interface: PdGravity(interface, GAIN)
"""


def test_a_law_imports_what_lies_beside_it(tmp_path, monkeypatch):
    """Two laws with a `helper` each import their own; their folders stay at the end of the path."""
    before = list(sys.path)
    for gain in (11.0, 12.0):
        folder = tmp_path / f"of_{gain:g}"
        folder.mkdir()
        (folder / "helper.py").write_text(f"GAIN = {gain}\n")
        (folder / "law.py").write_text(HELPED)
        made = resolve(str(folder / "law.py")).make(TwoLinkArmEnv())
        assert made.frequency == (gain, gain)
    monkeypatch.chdir(tmp_path / "of_11")
    (tmp_path / "of_11/law_of_11.py").write_text(HELPED)
    for text in ("law_of_11:make_policy", "law_of_11.py"):
        assert resolve(text).make(TwoLinkArmEnv()).frequency == (11.0, 11.0)
    assert sys.path[: len(before)] == before
    for name in ("helper", "law_of_11"):
        sys.modules.pop(name, None)
