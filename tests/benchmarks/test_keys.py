"""A cell's key: it follows all that the result depends on, and nothing else. Verification, and the promises of policies."""

import dataclasses
import json
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from benchmarks.agents.policy import SHIPPED
from benchmarks.cli.common import command_line
from benchmarks.cli.verify import compare
from benchmarks.policies import key as keys
from benchmarks.policies.isolation import run_isolated, run_parallel
from benchmarks.policies.spec import PolicySpec, _resolved, resolve
from benchmarks.run.cell import Cell
from benchmarks.run.contract import check
from benchmarks.run.runner import run_cell
from benchmarks.run.store import Store
from controllers.name import PolicyName
from fbl_gym import TwoLinkArmEnv
from fbl_gym.neighbours import ROOT

LAW = "from controllers.laws.simple import Zero as make_policy\n"
SUBCLASS = "from controllers.laws.simple import Zero\n\n\nclass make_policy(Zero):\n"


def tree(folder, files):
    """Write Python files, by their names without .py."""
    for name, text in files.items():
        path = folder / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def test_the_key_follows_policy_scenario_and_seeds():
    cell = Cell("pid-flm", "nominal", (0, 1, 2))
    others = [
        Cell("cascade-flm", cell.scenario, cell.seeds), Cell("pid-flm@tuned", cell.scenario, cell.seeds),
        Cell("ppo-blend@1", cell.scenario, cell.seeds), Cell("ppo-blend@2", cell.scenario, cell.seeds),
        Cell("pid-flm", cell.scenario.replace(noise={"position": 1e-9}), cell.seeds),
        Cell("pid-flm", cell.scenario.replace(control_dt=0.02), cell.seeds), Cell("pid-flm", cell.scenario, (0, 1)),
        Cell("controllers.laws.simple:Zero", cell.scenario, cell.seeds),
        Cell("controllers.laws.simple:PdGravity", cell.scenario, cell.seeds),
    ]  # fmt: skip
    assert len({c.key for c in (cell, *others)}) == len(others) + 1
    assert Cell("pid-flm", cell.scenario.replace(description="other words"), cell.seeds).key == cell.key


def test_the_key_of_a_training_seed_follows_its_own_weights():
    folders = {name: {Path(file).parent.name for file in resolve(name).data} for name in ("ppo-blend@1", "ppo-blend")}
    assert folders == {"ppo-blend@1": {"1"}, "ppo-blend": set("01234")}


def test_the_key_follows_the_bytes_of_an_external_file_and_of_all_that_it_imports(tmp_path):
    """A docstring counts too, as the law may read it."""
    files = {
        "mine": f"import importlib\nimportlib.import_module('helper')\n{LAW}", "helper": "from parts import deep\n",
        "parts/__init__": "", "parts/deep": "from .deeper import x\n", "parts/deeper": "x = 1\n", "other": "",
    }  # fmt: skip
    tree(tmp_path, files)

    def key(changed=()):
        for name in changed:
            path = tmp_path / f"{name}.py"
            path.write_text(f"'changed'\n{path.read_text()}")
        return Cell(str(tmp_path / "mine.py"), "nominal", (0,)).key

    keys = [key(), *(key([name]) for name in files)]
    assert len(set(keys)) == len(files)
    assert keys[-2] == keys[-1]  # nobody imports it


@pytest.mark.parametrize("folder", ["lib", "site-packages"])
def test_the_key_follows_the_package_of_an_external_policy(folder, tmp_path, monkeypatch):
    """Named by a module, or by an entry point, installed in place or not; a built-in name stays built-in."""
    monkeypatch.syspath_prepend(tmp_path / folder)
    tree(tmp_path / folder, {"external_laws/part/law": f"import external_laws.gains\n{LAW}", "external_laws/gains": ""})
    factory = "external_laws.part.law:make_policy"
    points = tmp_path / folder / "theirs-1.0.dist-info" / "entry_points.txt"
    points.parent.mkdir()
    points.write_text(f"[fbl_gym.policies]\ntheirs = {factory}\npid-flm = {factory}\n")
    policies = (factory, "theirs", "pid-flm")
    before = [Cell(name, "nominal", (0,)) for name in policies]
    tree(tmp_path / folder, {"external_laws/gains": "changed = True\n"})
    assert [cell.key != Cell(cell.policy.name, "nominal", (0,)).key for cell in before] == [True, True, False]
    assert [cell.policy.external for cell in before] == [True, True, False]
    (tmp_path / folder / "external_laws/k.txt").write_text("0.5")
    reads = "    def initial(self, observation):\n        return open(__file__.replace('law.py', '../k.txt')) and ()\n"
    tree(tmp_path / folder, {"external_laws/part/law": f"exec({SUBCLASS + reads!r})"})
    error = run_cell(Cell("theirs", "nominal", (0,))).error
    assert "k.txt, which its key does not cover: add make_policy.data_files" in error


@pytest.mark.parametrize(("declares", "error"), [
    ("kind = 'foo'", "kind"), ("access = 'all'", "access"), ("preview = 'far'", "must be a finite number not below 0"),
    *[(f"preview = float('{x}')", "preview of ") for x in ("nan", "1e9")],
    *[(f"data_files = ('{x}',)", f"must exist, but there is no file '{x}'") for x in ("K.txt", "weights/*.bin")],
    *[(f"data_files = {x}", "must be a list of text") for x in ("iter('a')", "(1,)", "'gain.txt'")],
])  # fmt: skip
def test_a_wrong_declaration_is_a_failed_cell(declares, error, tmp_path):
    (tmp_path / "law.py").write_text(f"{SUBCLASS}    access = 'oracle'\n    {declares}\n")
    result = run_cell(cell := Cell(str(tmp_path / "law.py"), "nominal", (0,)))
    assert cell.key
    assert result.rows == ()
    assert error in result.error


@pytest.mark.parametrize("policy", ["law.py", "pd-gravity@one.json@two.json"])
def test_exchanged_contents_of_two_files_change_the_key(policy, folder):
    (folder / "law.py").write_text(f"{SUBCLASS}    data_files = ['one.json', 'two.json']\n")

    def key(*frequencies):
        for name, frequency in zip(("one.json", "two.json"), frequencies, strict=True):
            (folder / name).write_text(f'{{"frequency": {frequency}}}')
        return Cell(policy, "nominal", (0,)).key

    assert key(8, 9) != key(9, 8)


def test_the_key_follows_the_gains_of_a_file_and_not_how_they_were_found(tmp_path):
    def key(**content):
        (tmp_path / "gains.json").write_text(json.dumps(content))
        return Cell(f"pid-flm@{tmp_path}/gains.json", "nominal", (0,)).key

    assert key(gains={"kp": 30}, command="by hand") == key(gains={"kp": 30}, cpu_s=1.0) != key(gains={"kp": 31})


def edit(monkeypatch, module):
    """As if the module had other code."""
    real, edited = keys.file_digest, ROOT.joinpath(*module.split(".")).with_suffix(".py")
    monkeypatch.setattr(keys, "file_digest", lambda path: "edited" if Path(path) == edited else real(path))
    monkeypatch.setattr(keys, "shared", keys.shared.__wrapped__)


@pytest.mark.parametrize(("policy", "module", "stale"), [
    ("pid-flm", "controllers.paper.pid", True), ("pid-flm", "fbl_gym.kernel.arm.physics", True),
    ("pid-flm", "benchmarks.run.metrics", True), ("pid-flm", "benchmarks.run.loop", True),
    ("ppo-blend@1", "controllers.laws.lqg_elastic", True),
    ("pid-flm", "controllers.laws.adrc", False), ("pid-flm", "fbl_gym.view.render", False),
    ("pid-flm", "benchmarks.policies.spec", False), ("pid-flm", "benchmarks.cli.tune", False),
    ("sliding-mode+kalman", "controllers.laws.sliding_mode", True), ("law.py", "controllers.laws.adrc", False),
    ("law.py", "controllers.laws.sliding_mode", True), ("sliding-mode+kalman", "controllers.laws.adrc", False),
    ("./agent", "controllers.laws.sliding_mode", True), ("./agent", "controllers.laws.adrc", False),
])  # fmt: skip
def test_a_law_depends_on_its_modules_the_kernel_and_the_metrics_alone(policy, module, stale, folder, monkeypatch):
    """But for those that it uses: a law lists them by name, and the folder of a residual agent names its base law."""
    (folder / "law.py").write_text(f"{SUBCLASS}    uses = ('sliding-mode',)\n")
    shutil.copytree(SHIPPED / "ppo-blend" / "0", folder / "agent")
    description = json.loads((folder / "agent" / "agent.json").read_text())
    description["interface"] |= {"base": "sliding-mode"}
    (folder / "agent" / "agent.json").write_text(json.dumps(description))
    before = _resolved(PolicyName.parse(policy)).identity
    edit(monkeypatch, module)
    assert (_resolved(PolicyName.parse(policy)).identity != before) == stale


def test_a_law_that_changes_while_its_board_runs_is_a_failed_cell(tmp_path):
    """Its process meets the new code under the old key."""
    (file := tmp_path / "law.py").write_text(LAW)
    cell = Cell(str(file), "nominal", (0,))
    assert PolicySpec.from_dict(cell.policy.to_dict()).identity == cell.policy.identity
    assert run_cell(cell).error == ""
    file.write_text(LAW.replace("Zero", "PdGravity"))
    assert "changed since it was resolved" in run_cell(cell).error


def test_a_name_of_the_package_wins_over_a_folder_of_that_name(folder):
    for name in ("oracle-flm", "mine"):
        shutil.copytree(SHIPPED / "ppo-blend" / "1", folder / name)
    specs = [resolve(text) for text in ("oracle-flm", "./oracle-flm", "./mine")]
    expected = [("oracle", False), ("nominal", True), ("nominal", True)]
    assert [(spec.access, spec.external) for spec in specs] == expected
    with pytest.raises(ValueError, match=r"policy 'mine'; the folder of that name is named by its path, ./mine"):
        resolve("mine")
    with pytest.raises(ValueError, match=r"must be a module .*, controllers.laws.simple:CLASS, got the file"):
        resolve(str(ROOT / "controllers" / "laws" / "simple.py"))


IMPORTS = """
import importlib, sys
from benchmarks.policies.key import LAWS, law_modules
from controllers.registry import CATALOGUE
for module in {f"controllers.{law['module']}" for law in CATALOGUE.values()}:
    for name in [name for name in sys.modules if name.startswith(LAWS[:3])]:
        del sys.modules[name]
    found = law_modules([importlib.import_module(module)])
    assert {*found} == {name for name in sys.modules if name.startswith(LAWS[:3])}, module
"""


def test_the_key_of_a_built_in_law_has_every_law_module_that_it_imports():
    subprocess.run([sys.executable, "-c", IMPORTS], check=True)


def test_every_module_of_the_arm_is_in_the_key():
    """All of fbl_gym but pictures and the data of scenarios."""
    others = {*ROOT.glob("fbl_gym/**/*.py")}.difference(*map(ROOT.glob, keys.SHARED))
    assert {path.relative_to(ROOT).parts[1] for path in others} == {"view", "scenarios"}


def test_the_key_follows_the_version_of_an_installed_package(tmp_path):
    """Whatever calls came before in other processes: one of them has imported it."""
    run_isolated(command_line)
    (tmp_path / "law.py").write_text(f"import rich\n{LAW}")
    assert "rich" in Cell(str(tmp_path / "law.py"), "nominal", (0,)).identity["packages"]


def test_an_agent_has_a_key_without_the_packages_of_other_policies():
    """Its base law alone is resolved with it."""
    code = "import sys; sys.modules |= dict.fromkeys(('casadi', 'torch', 'mujoco', 'pygame'))\n"
    code += "from benchmarks.policies.spec import resolve; print(resolve('ppo-blend').identity)"
    shown = subprocess.check_output([sys.executable, "-c", code], text=True)
    assert shown.strip() == str(resolve("ppo-blend").identity)


# Verification, and promises.


def test_verify_command(tmp_path, fbl_gym):
    store, published = Store(tmp_path), run_cell(Cell("pid-flm", "noise-1", (0, 1)))
    path = store.save(published)
    shown = fbl_gym(f"verify pid-flm/noise-1 --store {tmp_path}").out
    assert "pid-flm/noise-1, 2 seeds: holds, bit for bit" in shown
    rounded = tuple(row | {"error_pct": row["error_pct"] * (1 + 1e-9)} for row in published.rows)
    store.save(dataclasses.replace(published, rows=rounded))
    shown = fbl_gym(f"verify {path}").out
    assert "holds but for rounding, as on another processor: error_pct by up to" in shown
    far = {**published.rows[1], "error_pct": 1e6}  # hides no smaller difference of another run
    for factor, verdict in ((1.0, "holds, bit for bit"), (1.00001, "holds but"), (1.001, "DIFFERS in 1 of 2 runs")):
        near = {**published.rows[0], "error_pct": factor * published.rows[0]["error_pct"]}
        one, other = (dataclasses.replace(published, rows=(row, far)) for row in (published.rows[0], near))
        assert compare(one, other)[1].startswith(verdict)
    forged = ({**published.rows[0], "error_pct": 0.001}, *published.rows[1:])
    store.save(dataclasses.replace(published, rows=forged))
    shown = fbl_gym(f"verify {path}", 1).out
    assert "DIFFERS in 1 of 2 runs: error_pct by up to" in shown
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
        tree(tmp_path / f"of_{gain:g}", {"helper": f"GAIN = {gain}\n", "law": HELPED})
        made = resolve(str(tmp_path / f"of_{gain:g}/law.py")).make(TwoLinkArmEnv())
        assert made.frequency == (gain, gain)
    monkeypatch.chdir(tmp_path / "of_11")
    (tmp_path / "of_11/law_of_11.py").write_text(HELPED)
    for text in ("law_of_11:make_policy", "law_of_11.py"):
        assert resolve(text).make(TwoLinkArmEnv()).frequency == (11.0, 11.0)
    assert sys.path[: len(before)] == before
    found = run_isolated(find_spec, "helper"), *dict(run_parallel(find_spec, ["helper"], 2)).values()
    assert found == (None, None)  # a call and a worker find what lies beside their own policy
    del sys.modules["helper"], sys.modules["law_of_11"]
