"""External policies in a run: they reach no other row and stop no other cell."""

import contextlib
import os
import pickle
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks import cli
from benchmarks.policies.isolation import CallLimits, Failed, run_isolated
from benchmarks.policies.spec import resolve_isolated
from benchmarks.run.cell import run_cell
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
        "from benchmarks.policies.spec import resolve_isolated; import numpy; "
        f"cells = [Cell(resolve_isolated(p), 'noise-1', (0, 1)) for p in ({str(tmp_path / 'patches.py')!r}, 'pd-gravity')]; "
        f"print([r.error for _, r in run(cells, Store(Path({str(store.folder)!r})), workers={workers})]); "
        "print(numpy.geterr()['divide'])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "['', '']\nwarn\n"
    assert str(store.find(clean).rows[0]["error_pct"]) == truth.stdout.strip()


def test_a_policy_that_patches_the_package_changes_no_other_row_that_is_shown(tmp_path):
    (tmp_path / "patches.py").write_text(PATCHES)
    script = "from benchmarks import cli; cli.main(['evaluate', 'patches.py', 'pd-gravity', '--seeds', '1'])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=tmp_path)
    rows = {line.split()[0]: line.split()[1] for line in done.stdout.splitlines() if len(line.split()) > 4}
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
    cell = Cell(resolve_isolated("asks.py"), "nominal", (0,))
    assert run_cell(cell).error == ""
    assert (tmp_path / "got.txt").read_text() == argument
    assert cell.policy.ranked == ranked


def test_what_a_policy_prints_and_reads_stays_with_it(tmp_path):
    law = tmp_path / "prints.py"
    law.write_text("from controllers.simple import Zero as make_policy\nimport sys\nprint('hello', sys.stdin.read())\n")
    outcomes = list(run([Cell(resolve_isolated(str(law)), "nominal", (0,))], Store(tmp_path / "store")))
    assert [result.error for _, result in outcomes] == [""]


def test_a_relative_path_is_that_of_the_present_folder(tmp_path, monkeypatch):
    for folder, law in (("one", "Zero"), ("two", "PdGravity")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "law.py").write_text(f"from controllers.simple import {law} as make_policy\n")
    digests = []
    for folder in ("one", "two"):
        monkeypatch.chdir(tmp_path / folder)
        digests.append(resolve_isolated("law.py").digest)
    assert digests[0] != digests[1]


LAW = "from controllers.simple import Zero\nclass make_policy(Zero):\n    def torque(self, observation, state):\n        {}\n"
WORKS = "return super().torque(observation, state)"
NAMES = ("[red]a[" + "日本語" * 25, ":zap: a:b|`c*_<i>\n" + os.fsdecode(b"\xff"))
BAD = {
    "exits": ("import sys\nsys.exit(0)\n", WORKS, "SystemExit: 0"),
    "leaves": ("import os\n", "os._exit(0)", "its process died, with exit status 0"),
    "lacks": ("", "{}['lost']", "KeyError: 'lost'"),
    "goes": ("import os\nos.chdir('/')\n", WORKS, "No such file or directory"),
}


@pytest.mark.parametrize(("command", "law"), [
    ("evaluate", "goes"), ("evaluate zero", "exits"), ("margins", "exits"), ("margins", "leaves"),
    ("check-policy", "leaves"), ("record --out data/a-v0", "leaves"), ("record --out data/a-v0", "lacks"),
])  # fmt: skip
def test_a_bad_policy_is_one_line_of_other_commands_too(command, law, tmp_path, monkeypatch, capfd):
    """Its code runs in another process, so it cannot end this one without a word."""
    head, body, reason = BAD[law]
    (tmp_path / f"{law}.py").write_text(head + LAW.format(body))
    monkeypatch.chdir(tmp_path)
    pytest.importorskip("minari")
    assert cli.main([*command.split(), f"{law}.py"]) in (1, 2)
    out, errors = capfd.readouterr()
    assert reason in out + errors
    assert "Traceback" not in errors
    assert Path.cwd() == tmp_path


FAILS = {
    "text": ("class E(Exception):\n    def __str__(self):\n        raise RuntimeError\n", "raise E"),
    "loads": ("class E(BaseException):\n    pass\nraise E('no')\n", WORKS),
    "exits": ("import sys\nsys.exit(0)\n", WORKS),
    "kills": ("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n", WORKS),
    "segment": ("import ctypes\nctypes.string_at(0)\n", WORKS),
    "memory": ("import numpy as np\n", "return np.ones(10**10), state"),
}
REASONS = {
    "text": "E: (its text raises an error)",
    "loads": "ValueError: E: no, while it was loaded",
    "exits": "SystemExit: 0",
    "kills": "ValueError: its process died, with exit status 137, while it was loaded",
    "segment": "ValueError: its process died, with exit status 139, while it was loaded",
    "memory": "MemoryError: Unable to allocate 74.5 GiB",
}  # fmt: skip


def test_a_process_that_changes_its_folder_runs_the_policies_of_the_new_one(tmp_path, monkeypatch):
    """The workers of the first board are still there when the second one starts."""
    for name in ("first", "second"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / f"{name}.py").write_text("from controllers.simple import Zero as make_policy\n")
        monkeypatch.chdir(folder)
        ((done, result),) = run([Cell(f"{name}.py", "nominal", (0,))], Store(folder / "store"), workers=2)
        assert (done, result.error) == ("computed", "")


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
    monkeypatch.chdir(tmp_path)
    (tmp_path / "shaky.py").write_text(RANDOM)
    line = "leaderboard --policies zero shaky.py --scenarios servo-nominal --seeds 1 --workers 1 --store store"
    assert cli.main(line.split()) == 1
    assert "shaky.py: breaks a promise (a lane of a batch acts as a single policy)" in " ".join(
        capsys.readouterr().out.split()
    )


LATE = "it took longer than 1 s, see leaderboard --cell-timeout"


def test_a_policy_that_hangs_is_a_failed_cell(tmp_path):
    """While it runs, and while it is loaded."""
    (tmp_path / "hangs.py").write_text(LAW.format("while True: pass"))
    (tmp_path / "loading.py").write_text("import time\ntime.sleep(600)\n")
    hangs = Cell(resolve_isolated(str(tmp_path / "hangs.py")), "nominal", (0,))
    limits = CallLimits(seconds=1.0)
    assert run_cell(hangs, limits=limits).error == LATE
    loading = resolve_isolated(str(tmp_path / "loading.py"), limits)
    assert loading.problem == f"{LATE}, while it was loaded"


def start_and_hang(flag):
    """Start a process that holds all pipes and never ends, as a careless policy may."""
    if os.fork() == 0:
        time.sleep(600)
    open(flag, "w").close()
    time.sleep(600)


def answer_and_leave(flag):
    child = os.fork()
    if child == 0:
        time.sleep(600)
    Path(flag).write_text(str(child))
    return "answer"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize("function", [start_and_hang, answer_and_leave])
def test_the_processes_of_a_call_end_with_it(function, tmp_path):
    """At its limit of time, too, though a grandchild holds the standard output."""
    begin = time.monotonic()
    arguments, limits = (function, str(tmp_path / "flag")), CallLimits(seconds=5.0)
    if function is answer_and_leave:
        assert run_isolated(*arguments, limits=limits) == "answer"
        time.sleep(0.5)
        status = Path("/proc", (tmp_path / "flag").read_text(), "stat")
        assert not status.exists() or status.read_text().rpartition(") ")[2].startswith("Z")
    else:
        with pytest.raises(Failed, match="it took longer than 5 s"):
            run_isolated(*arguments, limits=limits)
    assert time.monotonic() - begin < 20


class Opens:
    def __reduce__(self):
        return open, ("ran", "w")


def answer_with(data):
    """Write an answer in place of the call, as a policy may."""
    for number in range(3, 64):
        with contextlib.suppress(OSError):
            os.write(number, data)
    os._exit(0)


@pytest.mark.parametrize("data", [b"garbage", pickle.dumps(5), pickle.dumps(Opens()), pickle.dumps(CallLimits())])
def test_an_answer_is_data_or_an_error(data, tmp_path, monkeypatch):
    """And no code of it runs in this process."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(Failed, match="its answer cannot be read"):
        run_isolated(answer_with, data)
    assert not Path("ran").exists()


def test_no_standard_module_is_imported_from_the_current_folder(tmp_path):
    for name in ("signal", "select", "pickle", "multiprocessing", "tempfile"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w').close()\nraise SystemExit\n")
    (tmp_path / "law.py").write_text(LAW.format(WORKS))
    code = (
        "import sys; from benchmarks import cli; "
        "sys.exit(cli.main('leaderboard --policies zero law.py --scenarios nominal noise-1 --seeds 1 --workers 2'.split()))"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "ran").exists()


STATE = """
from controllers.simple import PdGravity
calls = []


class make_policy(PdGravity):
    def torque(self, observation, state):
        calls.append(1)
        torque, state = super().torque(observation, state)
        return torque * (0.9 if len(calls) > 900 else 1.0), state
"""


def test_a_law_with_state_in_its_module_has_one_number_for_each_cell(tmp_path):
    """Whatever the order of the cells and the number of workers."""
    (tmp_path / "state.py").write_text(STATE)
    spec = resolve_isolated(str(tmp_path / "state.py"))
    cells = [Cell(spec, name, (0,)) for name in ("nominal", "noise-1")]
    numbers = []
    for order, workers in ((1, 1), (-1, 1), (1, 2)):
        store = Store(tmp_path / f"store{len(numbers)}")
        assert [result.error for _, result in run(cells[::order], store, workers=workers)] == ["", ""]
        numbers.append([store.find(cell).rows[0]["error_pct"] for cell in cells])
    assert numbers[0] == numbers[1] == numbers[2]
