"""A cell's key: it follows all that the result depends on, and nothing else."""

import json
import pickle
import shutil
import subprocess
import sys
from importlib import metadata

import numpy as np
import pytest

from benchmarks.policies import digest
from benchmarks.policies.digest import closure, file_of, source_digest
from benchmarks.policies.name import PolicyName
from benchmarks.policies.spec import PolicySpec, names, resolve
from benchmarks.rl.policy import SHIPPED
from benchmarks.run.cell import run_cell
from benchmarks.run.suite import Cell
from controllers.registry import ENTRY_POINTS

LAW = "from controllers.simple import Zero as make_policy\n"
SUBCLASS = "from controllers.simple import Zero\n\n\nclass make_policy(Zero):\n"


def tree(folder, files):
    """Write Python files, by their names without .py."""
    for name, text in files.items():
        path = folder / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def test_the_key_follows_policy_scenario_and_seeds():
    cell = Cell("pid-flm", "nominal", (0, 1, 2))
    others = [
        Cell("cascade-flm", cell.scenario, cell.seeds),
        Cell("pid-flm@tuned", cell.scenario, cell.seeds),
        Cell("ppo-servo@1", cell.scenario, cell.seeds),
        Cell("ppo-servo@2", cell.scenario, cell.seeds),
        Cell("pid-flm", cell.scenario.replace(noise={"position": 1e-9}), cell.seeds),
        Cell("pid-flm", cell.scenario.replace(control_dt=0.02), cell.seeds),
        Cell("pid-flm", cell.scenario, (0, 1)),
    ]
    keys = {c.key for c in (cell, *others)}
    assert len(keys) == len(others) + 1
    assert Cell("pid-flm", cell.scenario.replace(description="other words"), cell.seeds).key == cell.key


def test_a_policy_is_made_once_for_all_its_keys(monkeypatch):
    resolve("cascade-flm@tuned")
    monkeypatch.setattr("benchmarks.policies.spec._make", lambda *_: pytest.fail("it was made again"))
    cells = [Cell("cascade-flm@tuned", "nominal", (seed,)) for seed in range(100)]
    assert len({cell.key for cell in cells}) == 100
    monkeypatch.setattr(Cell, "identity", None)
    assert len({cell.key for cell in cells}) == 100


SOURCE = b'''"""A module."""
import math  # for pi


class Law:
    """A law."""

    gain = 2.0
    """Its gain."""

    def torque(self, x):
        """Return the torque."""
        return (self.gain * x, f"{x} Nm")
'''


def test_comments_docstrings_and_layout_do_not_count():
    plain = b"""import math
class Law:
  gain = 2.0
  def torque(self, x):
    return (self.gain *
            x, f"{x} Nm")
"""
    assert source_digest(SOURCE) == source_digest(plain)


@pytest.mark.parametrize(
    ("old", "new"),
    [(b"2.0", b"2.1"), (b"self.gain * x", b"self.gain + x"), (b"import math", b"import cmath"), (b"{x} Nm", b"{x} N")],
)
def test_code_counts(old, new):
    assert source_digest(SOURCE) != source_digest(SOURCE.replace(old, new))


def test_a_law_depends_on_its_modules_the_kernel_and_the_metrics_but_on_no_other_law():
    roots = {
        name: file_of(name) for name in ("benchmarks.run.rollout", "benchmarks.run.metrics", "controllers.adaptive")
    }
    modules = closure(roots)
    assert {"fbl_gym.kernel.physics", "fbl_gym.model.arm", "controllers.estimator", "controllers.policy"} <= set(
        modules
    )
    assert not {"controllers.adrc", "fbl_gym.view.render", "benchmarks.policies.spec", "benchmarks.cli.tune"} & set(
        modules
    )


@pytest.mark.parametrize("module", ["controllers.pid", "fbl_gym.kernel.physics", "benchmarks.run.metrics"])
def test_an_edit_of_the_packages_code_changes_the_key(module, monkeypatch):
    before = resolve("pid-flm").digest
    real = source_digest
    text = file_of(module).read_bytes()
    monkeypatch.setattr(digest, "source_digest", lambda source: "edited" if source == text else real(source))
    monkeypatch.setattr("benchmarks.policies.spec._RESOLVED", {})
    assert resolve("pid-flm").digest != before


def test_the_key_follows_the_code_of_an_external_policy(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(LAW)
    before = Cell(str(file), "nominal", (0,)).key
    file.write_text(f"# A sentence.\n{LAW}")
    assert Cell(str(file), "nominal", (0,)).key == before
    file.write_text(LAW.replace("Zero", "PdGravity"))
    assert Cell(str(file), "nominal", (0,)).key != before


def test_two_factories_of_one_file_have_two_keys(tmp_path):
    (tmp_path / "two.py").write_text("from controllers.simple import PdGravity, Zero\n")
    assert (
        Cell(f"{tmp_path}/two.py:Zero", "nominal", (0,)).key
        != Cell(f"{tmp_path}/two.py:PdGravity", "nominal", (0,)).key
    )


def test_the_key_follows_all_that_an_external_file_imports(tmp_path):
    files = {
        "mine": f"def late():\n    import helper\n{LAW}",
        "helper": "from parts import deep\n",
        "parts/__init__": "",
        "parts/deep": "from .deeper import x\n",
        "parts/deeper": "x = 1\n",
        "other": "",
    }
    tree(tmp_path, files)
    keys = [Cell(str(tmp_path / "mine.py"), "nominal", (0,)).key]
    for name in ("helper", "parts/__init__", "parts/deep", "parts/deeper"):
        with (tmp_path / f"{name}.py").open("a") as file:
            file.write("changed = True\n")
        keys.append(Cell(str(tmp_path / "mine.py"), "nominal", (0,)).key)
    assert len(set(keys)) == 5
    (tmp_path / "other.py").write_text("nobody = 'imports it'\n")
    assert Cell(str(tmp_path / "mine.py"), "nominal", (0,)).key == keys[-1]


def test_the_key_follows_the_package_of_an_external_policy(tmp_path, monkeypatch):
    """Named by a module, or by an entry point; a built-in name stays built-in."""
    monkeypatch.syspath_prepend(tmp_path)
    tree(tmp_path, {"external_laws/part/law": LAW, "external_laws/gains": ""})
    points = [
        metadata.EntryPoint(name, "external_laws.part.law:make_policy", ENTRY_POINTS) for name in ("theirs", "pid-flm")
    ]
    monkeypatch.setattr("controllers.registry.entry_points", lambda: tuple(points))
    policies = ("external_laws.part.law:make_policy", "theirs", "pid-flm")

    def keys():
        monkeypatch.setattr("benchmarks.policies.spec._RESOLVED", {})
        return [Cell(name, "nominal", (0,)).key for name in policies]

    before = keys()
    tree(tmp_path, {"external_laws/gains": "changed = True\n"})
    assert [old == new for old, new in zip(before, keys(), strict=True)] == [False, False, True]
    assert [resolve(name).external for name in policies] == [True, True, False]


def test_built_in_policies_are_built_in():
    for name in (*names(), "ppo-servo@1"):
        assert not resolve(name).external


WEIGHTS = """
from dataclasses import dataclass, field
import numpy as np
from controllers.simple import PdGravity


@dataclass(frozen=True)
class Law(PdGravity):
    weights: object = field(default_factory=lambda: np.load({path!r}))

    def torque(self, observation, state):
        torque, state = super().torque(observation, state)
        return torque * self.weights[1000], state


make_policy = Law
Law.data_files = [{path!r}]
"""


def test_every_number_of_an_array_counts(tmp_path):
    """NumPy prints the ends of a long array alone."""
    weights = np.ones(2000)
    np.save(tmp_path / "weights.npy", weights)
    (tmp_path / "law.py").write_text(WEIGHTS.format(path=str(tmp_path / "weights.npy")))
    one = Cell(str(tmp_path / "law.py"), "nominal", (0,))
    error = run_cell(one).rows[0]["error_pct"]
    weights[800:1200] = 0.5
    np.save(tmp_path / "weights.npy", weights)
    other = Cell(str(tmp_path / "law.py"), "nominal", (0,))
    assert one.key != other.key
    assert run_cell(other).rows[0]["error_pct"] > error
    # The first cell's result can no longer be computed, and is not confused with the second's.
    assert "changed since it was resolved" in run_cell(one).error


@pytest.mark.parametrize("declares", ["kind = 'foo'", "access = 'all'", "preview = 'far'"])
def test_a_wrong_declaration_is_a_failed_cell(declares, tmp_path):
    (tmp_path / "law.py").write_text(
        f"from controllers.simple import Zero\n\n\nclass make_policy(Zero):\n    access = 'privileged'\n    {declares}\n"
    )
    result = run_cell(Cell(str(tmp_path / "law.py"), "nominal", (0,)))
    assert result.rows == ()
    assert result.error


READER = """
from pathlib import Path
from controllers.simple import PdGravity

file = Path(__file__).with_name("gain.txt")


class Law(PdGravity):
    def initial(self, observation):
        {late}
        return super().initial(observation)


def make_policy(interface):
    {early}
    return Law(interface, 5.0)


make_policy.data_files = ({declared})
"""
READ = "float(file.read_text())"


@pytest.mark.parametrize("early", [READ, "pass"])
def test_the_key_follows_declared_data_files(early, tmp_path):
    (tmp_path / "gain.txt").write_text("5")
    (tmp_path / "law.py").write_text(READER.format(late=READ, early=early, declared='"gain.txt",'))
    before = Cell(str(tmp_path / "law.py"), "nominal", (0,))
    assert run_cell(before).error == ""
    (tmp_path / "gain.txt").write_text("6")
    assert Cell(str(tmp_path / "law.py"), "nominal", (0,)).key != before.key


@pytest.mark.parametrize("declared", ["1,", '"gain.txt"'])
def test_data_files_are_a_list_of_paths(declared, tmp_path):
    (tmp_path / "law.py").write_text(READER.format(late="5", early="pass", declared=declared))
    assert "data_files of" in run_cell(Cell(str(tmp_path / "law.py"), "nominal", (0,))).error


def test_exchanged_contents_of_two_data_files_change_the_key(tmp_path):
    (tmp_path / "law.py").write_text(f"{SUBCLASS}    data_files = ['a.txt', 'b.txt']\n")

    def key(one, two):
        (tmp_path / "a.txt").write_text(one)
        (tmp_path / "b.txt").write_text(two)
        return Cell(str(tmp_path / "law.py"), "nominal", (0,)).key

    assert key("1", "2") != key("2", "1")
    assert key("1", "2") == key("1", "2")


def test_exchanged_contents_of_two_gains_files_change_the_key(tmp_path):
    texts = '{"frequency": 8}', '{"damping": 0.7}'

    def key(one, two):
        (tmp_path / "a.json").write_text(one)
        (tmp_path / "b.json").write_text(two)
        return Cell(f"pd-gravity@{tmp_path}/a.json@{tmp_path}/b.json", "nominal", (0,)).key

    assert key(*texts) != key(*texts[::-1])


def test_the_key_follows_the_gains_of_a_file_and_not_how_they_were_found(tmp_path):
    def key(**content):
        (tmp_path / "gains.json").write_text(json.dumps(content))
        return Cell(f"pid-flm@{tmp_path}/gains.json", "nominal", (0,)).key

    assert key(gains={"kp": 30}, command="by hand") == key(gains={"kp": 30}, cpu_s=1.0) != key(gains={"kp": 31})


def edit(monkeypatch, module):
    """As if the module had other code."""
    real, text = source_digest, file_of(module).read_bytes()
    monkeypatch.setattr(digest, "source_digest", lambda source: "edited" if source == text else real(source))
    monkeypatch.setattr("benchmarks.policies.spec._RESOLVED", {})


@pytest.mark.parametrize("form", ["folder", "law"])
def test_an_edit_of_the_law_that_a_policy_uses_makes_its_results_stale(form, tmp_path, monkeypatch):
    """The folder of a residual agent names its base law, and a law lists those that it uses by name."""
    if form == "folder":
        shutil.copytree(SHIPPED / "ppo-servo" / "0", tmp_path / "agent")
        description = json.loads((tmp_path / "agent" / "agent.json").read_text())
        description["interface"] |= {"base": "sliding-mode"}
        (tmp_path / "agent" / "agent.json").write_text(json.dumps(description))
        name = str(tmp_path / "agent")
    else:
        (tmp_path / "law.py").write_text(f"{SUBCLASS}    uses = ('sliding-mode',)\n")
        name = str(tmp_path / "law.py")
    before = resolve(name).identity
    edit(monkeypatch, "controllers.adrc")
    assert resolve(name).identity == before
    edit(monkeypatch, "controllers.sliding_mode")
    assert resolve(name).identity != before


def test_a_shipped_agent_depends_on_its_base_law(monkeypatch):
    before = resolve("ppo-servo@1")
    edit(monkeypatch, "controllers.computed_torque")
    assert resolve("ppo-servo@1").identity != before.identity


def test_a_law_that_changes_while_its_board_runs_is_a_failed_cell(tmp_path):
    """Another process, as a worker is, meets the new code under the old key."""
    file = tmp_path / "law.py"
    file.write_text(LAW)
    cell = Cell(str(file), "nominal", (0,))
    assert PolicySpec.from_dict(cell.policy.to_dict()).identity == cell.policy.identity
    code = (
        "import pickle, sys; from benchmarks.run.cell import run_cell; "
        "print(run_cell(pickle.load(sys.stdin.buffer)).error)"
    )

    def worker():
        return subprocess.run([sys.executable, "-c", code], input=pickle.dumps(cell), capture_output=True, check=True)

    assert worker().stdout == b"\n"
    file.write_text(LAW.replace("Zero", "PdGravity"))
    assert b"changed since it was resolved" in worker().stdout


def test_a_name_of_the_package_wins_over_a_folder_of_that_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    agent = file_of("benchmarks.rl.policy").parent / "agents" / "ppo-servo" / "1"
    for name in ("oracle-flm", "mine"):
        (tmp_path / name).mkdir()
        for file in agent.iterdir():
            (tmp_path / name / file.name).write_bytes(file.read_bytes())
    assert resolve("oracle-flm").access == "privileged"
    assert not resolve("oracle-flm").external
    assert resolve("./oracle-flm").access == "nominal"
    assert resolve("./mine").external
    with pytest.raises(
        ValueError, match=r"unknown policy 'mine'; the folder of that name is named by its path, ./mine"
    ):
        resolve("mine")


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("C:\\laws\\my.py", ("C:\\laws\\my.py", "")),
        ("C:\\laws\\my.py:Law", ("C:\\laws\\my.py", "Law")),
        ("a:b/law.py:Law", ("a:b/law.py", "Law")),
        ("a:b/law.py", ("a:b/law.py", "")),
        ("package.module:Law", ("package.module", "Law")),
        ("law.py", ("law.py", "")),
    ],
)
def test_a_path_may_contain_a_colon(text, parts):
    name = PolicyName.parse(text)
    assert (name.source, name.attribute) == parts


def test_a_law_in_a_folder_with_a_colon_runs(tmp_path):
    (tmp_path / "a:b").mkdir()
    (tmp_path / "a:b" / "law.py").write_text(LAW)
    for text in (f"{tmp_path}/a:b/law.py", f"{tmp_path}/a:b/law.py:make_policy"):
        assert run_cell(Cell(text, "nominal", (0,))).error == ""


def test_an_agent_has_a_key_without_the_packages_of_other_policies():
    """Its base law alone is resolved with it."""
    code = (
        "import sys; sys.modules |= dict.fromkeys(('casadi', 'torch', 'mujoco', 'pygame'))\n"
        "from benchmarks.policies.spec import resolve\n"
        "print(resolve('ppo-servo').digest)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == resolve("ppo-servo").digest
