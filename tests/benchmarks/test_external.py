"""External policies in a run: they reach no other row and stop no other cell."""

import os
import subprocess
import sys

import pytest

from benchmarks import cli
from benchmarks.policies import apart
from benchmarks.policies.apart import Limits
from benchmarks.policies.spec import resolve_apart
from benchmarks.run.cell import run_apart
from benchmarks.run.runner import run
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell

PATCHES = """
import numpy as np
from controllers import simple
from controllers.simple import Zero

np.seterr(all="raise")
simple.PdGravity.torque = lambda self, observation, state: (np.zeros((len(observation), 2)), state)


def make_policy(interface):
    return Zero(interface)
"""


@pytest.mark.parametrize("workers", [1, 2])
def test_a_policy_that_patches_the_package_changes_no_other_row(workers, tmp_path):
    (tmp_path / "patches.py").write_text(PATCHES)
    clean = Cell("pd-gravity", "noise-1", (0, 1))
    code = "from benchmarks.run.cell import run_cell; from benchmarks.run.suite import Cell; "
    store = Store(tmp_path / "store")
    truth = subprocess.run(
        [sys.executable, "-c", f"{code}print(run_cell(Cell('pd-gravity', 'noise-1', (0, 1))).rows[0]['error_pct'])"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    script = (
        "from pathlib import Path; from benchmarks.run.runner import run; from benchmarks.run.store import Store; "
        "from benchmarks.run.suite import Cell; "
        "from benchmarks.policies.spec import resolve_apart; import numpy; "
        f"cells = [Cell(resolve_apart(p), 'noise-1', (0, 1)) for p in ({str(tmp_path / 'patches.py')!r}, 'pd-gravity')]; "
        f"print([o.error for o in run(cells, Store(Path({str(store.folder)!r})), workers={workers})]); "
        "print(numpy.geterr()['divide'])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "['', '']\nwarn\n"
    assert str(store.find(clean).rows[0]["error_pct"]) == truth.stdout.strip()


def test_a_policy_that_patches_the_package_changes_no_other_row_that_is_shown(tmp_path):
    """`compare`, and the traces of the report's page."""
    (tmp_path / "patches.py").write_text(PATCHES)
    script = (
        "import sys; from pathlib import Path; from benchmarks import cli; from benchmarks.run.suite import Cell; "
        "from benchmarks.policies.spec import resolve_apart; from benchmarks.run.store import Store; "
        "from benchmarks.run.runner import traces; import numpy; store = Store(Path('store')); "
        "cells = [Cell(resolve_apart(p), 'nominal', (0,)) for p in ('patches.py', 'zero', 'pd-gravity')]; "
        "print([float(numpy.abs(t['position']).max()) for t in traces(cells, store).values()], numpy.geterr()['divide']); "
        "cli.main(['compare', 'patches.py', 'pd-gravity', '--seeds', '1'])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=tmp_path)
    traces, *table = done.stdout.splitlines()
    assert traces.endswith("] warn")
    patched, zero, clean = (float(x) for x in traces[1:-6].split(","))
    assert patched == zero != clean
    rows = {line.split()[0]: line.split()[1] for line in table if len(line.split()) > 4}
    assert rows["patches.py"] != rows["pd-gravity"]


ASKS = """
class Policy:
    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return 0 * observation[..., :2], None


def make_policy(env):
    open("got.txt", "w").write(type(env).__name__)
    return Policy()
"""


@pytest.mark.parametrize(("declares", "argument", "ranked"), [
    ("", "Interface", True), ("\nmake_policy.access = 'none'\n", "Interface", True),
    ("\nmake_policy.access = 'privileged'\n", "TwoLinkArmVectorEnv", False),
])  # fmt: skip
def test_only_a_factory_that_declares_it_gets_the_environment(declares, argument, ranked, tmp_path, monkeypatch):
    """The name of the argument does not count."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "asks.py").write_text(ASKS + declares)
    cell = Cell(resolve_apart("asks.py"), "nominal", (0,))
    assert run_apart(cell).error == ""
    assert (tmp_path / "got.txt").read_text() == argument
    assert cell.policy.ranked == ranked


@pytest.mark.parametrize("place", ["", "    "])
def test_a_policy_that_exits_is_a_failed_cell_and_the_board_goes_on(place, tmp_path, capsys):
    """At import, or when it is made."""
    law = tmp_path / "leaves.py"
    law.write_text(f"import sys\n\ndef make_policy(interface):\n    pass\n{place}sys.exit(0)\n")
    few = ["--scenarios", "nominal", "--seeds", "1", "--workers", "1", "--store", str(tmp_path / "store")]
    assert cli.main(["leaderboard", "--policies", "zero", str(law), *few]) == 1
    shown = capsys.readouterr().out
    assert "zero" in shown
    assert "SystemExit" in shown


def test_a_policy_that_kills_its_process_while_it_loads_is_a_failed_cell(tmp_path, capsys):
    law = tmp_path / "kills.py"
    law.write_text("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n")
    few = ["--scenarios", "nominal", "--seeds", "1", "--workers", "1", "--store", str(tmp_path / "store")]
    assert cli.main(["leaderboard", "--policies", "zero", str(law), *few]) == 1
    assert "its worker died 2 times" in capsys.readouterr().out.replace("\n", " ")


def test_what_a_policy_prints_and_reads_stays_with_it(tmp_path):
    law = tmp_path / "prints.py"
    law.write_text("from controllers.simple import Zero as make_policy\nimport sys\nprint('hello', sys.stdin.read())\n")
    outcomes = list(run([Cell(resolve_apart(str(law)), "nominal", (0,))], Store(tmp_path / "store")))
    assert [outcome.error for outcome in outcomes] == [""]


def test_a_relative_path_is_that_of_the_present_folder(tmp_path, monkeypatch):
    for folder, law in (("one", "Zero"), ("two", "PdGravity")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "law.py").write_text(f"from controllers.simple import {law} as make_policy\n")
    digests = []
    for folder in ("one", "two"):
        monkeypatch.chdir(tmp_path / folder)
        digests.append(resolve_apart("law.py").digest)
    assert digests[0] != digests[1]


@pytest.mark.parametrize("command", [["evaluate"], ["compare", "zero"], ["margins"]])
def test_a_policy_that_exits_is_an_error_of_other_commands_too(command, tmp_path):
    (tmp_path / "leaves.py").write_text("import sys\nsys.exit(0)\n")
    line = [sys.executable, "-m", "fbl_gym", *command, "leaves.py"]
    done = subprocess.run(line, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert "SystemExit" in done.stderr
    assert "Traceback" not in done.stderr


LAW = "from controllers.simple import Zero\nclass make_policy(Zero):\n    def torque(self, observation, state):\n        {}\n"
WORKS = "return super().torque(observation, state)"
NAMES = ("[red]a[" + "日本語" * 25, ":zap: a:b|`c*_<i>\n" + os.fsdecode(b"\xff"))
FAILS = {
    "text": ("class E(Exception):\n    def __str__(self):\n        raise RuntimeError\n", "raise E"),
    "loads": ("class E(BaseException):\n    pass\nraise E('no')\n", WORKS),
    "segment": ("import ctypes\nctypes.string_at(0)\n", WORKS),
    "memory": ("import numpy as np\n", "return np.ones(10**10), state"),
}
REASONS = {
    "text": "E: (its text raises an error)", "loads": "ValueError: E: no, while it was loaded",
    "segment": "ValueError: its worker died 2 times, while it was loaded", "memory": "MemoryError: Unable to allocate 74.5 GiB",
}  # fmt: skip


def test_a_process_that_changes_its_folder_runs_the_policies_of_the_new_one(tmp_path, monkeypatch):
    """The workers of the first board are still there when the second one starts."""
    for name in ("first", "second"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / f"{name}.py").write_text("from controllers.simple import Zero as make_policy\n")
        monkeypatch.chdir(folder)
        (outcome,) = run([Cell(f"{name}.py", "nominal", (0,))], Store(folder / "store"), workers=2)
        assert (outcome.done, outcome.error) == ("computed", "")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits memory, and uses any file name")
def test_no_bad_policy_stops_the_board(tmp_path):
    """Each failure is listed with its reason, and names of any kind have their rows, in a report too."""
    for name in NAMES:
        (tmp_path / f"{name}.py").write_text(LAW.format(WORKS))
    for name, (head, body) in FAILS.items():
        (tmp_path / f"{name}.py").write_text(head + LAW.format(body))
    policies = [f"{name}.py" for name in (*NAMES, *FAILS)]
    line = [sys.executable, "-m", "fbl_gym", "leaderboard", "--policies", "zero", *policies, "--scenarios", "nominal"]
    line += ["--seeds", "1", "--store", "store", "--cell-memory", "3", "--workers", "2"]
    done = subprocess.run(line, capture_output=True, text=True, check=False, cwd=tmp_path, stdin=subprocess.DEVNULL)
    assert done.returncode == 1
    assert "Traceback" not in done.stdout + done.stderr
    shown = " ".join(done.stdout.split())
    for name, reason in REASONS.items():
        assert f"Left out: {name}.py: {reason}" in shown
    assert shown.count("Left out") == len(FAILS)
    assert len(list((tmp_path / "store").glob("*--*.json"))) == 1 + len(NAMES)
    line[3:4] = ["report"]
    del line[-2:]
    done = subprocess.run(line, capture_output=True, text=True, check=False, cwd=tmp_path, stdin=subprocess.DEVNULL)
    assert (done.returncode, "Traceback" in done.stderr) == (1, False), done.stderr
    table = (tmp_path / "results" / "report" / "board.md").read_text(encoding="utf-8")
    rows = [line for line in table.splitlines() if line.startswith("|")]
    assert len(rows) == 2 + 1 + len(NAMES)
    assert "`` :zap: a:b\\|`c*_<i> " in table
    assert "Left out: loads.py: ValueError: E: no" in table


RANDOM = "import numpy as np\n" + LAW.format("return np.random.randn(len(observation), 2), state")


def test_the_board_runs_no_policy_that_breaks_a_promise(tmp_path, monkeypatch, capsys):
    """And the store counts which policies were looked at on a scenario for judging."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "shaky.py").write_text(RANDOM)
    line = "leaderboard --policies zero shaky.py --scenarios hardware-nominal --seeds 1 --workers 1 --store store"
    assert cli.main(line.split()) == 1
    assert "shaky.py: breaks a promise (a lane of a batch acts as a single policy)" in " ".join(
        capsys.readouterr().out.split()
    )
    assert cli.main(["evaluate", "zero", "--scenario", "hardware-nominal", "--seeds", "1", "--store", "store"]) == 0
    assert (
        cli.main(["evaluate", "pd-gravity@damping=2", "--scenario", "nominal", "--seeds", "1", "--store", "store"]) == 0
    )
    for gains in ("damping=2", "damping=3", "damping=2"):
        assert cli.main(f"evaluate pd-gravity@{gains} --scenario hardware-nominal --seeds 1 --store store".split()) == 0
    assert Store(tmp_path / "store").looks() == {("zero", "hardware-nominal"): 1, ("pd-gravity", "hardware-nominal"): 2}


def test_a_policy_that_hangs_is_a_failed_cell(tmp_path, monkeypatch):
    """While it runs, and while it is loaded."""
    (tmp_path / "hangs.py").write_text(LAW.format("while True: pass"))
    (tmp_path / "loading.py").write_text("import time\ntime.sleep(600)\n")
    hangs = Cell(resolve_apart(str(tmp_path / "hangs.py")), "nominal", (0,))
    monkeypatch.setattr(apart, "_LIMITS", [Limits(seconds=1.0)])
    assert run_apart(hangs).error == "it took longer than 1 s, see --cell-timeout"
    loading = resolve_apart(str(tmp_path / "loading.py"))
    assert loading.problem == "it took longer than 1 s, see --cell-timeout, while it was loaded"


@pytest.mark.parametrize(("option", "value"), [("timeout", "0"), ("timeout", "nan"), ("memory", "-1")])
def test_limits_are_checked(option, value, capsys):
    assert cli.main(["leaderboard", f"--cell-{option}", value]) == 2
    assert f"cell-{option} must be a finite number" in capsys.readouterr().err
