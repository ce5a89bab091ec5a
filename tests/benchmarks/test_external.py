"""External policies in a run: they reach no other row and stop no other cell, and run only with trust."""

import contextlib
import os
import pickle
import py_compile
import re
import shutil
import subprocess
import sys
import time
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest

from benchmarks import cli
from benchmarks.policies.isolation import CallLimits, Failed, run_isolated
from benchmarks.policies.loading import NotFound, load
from benchmarks.policies.spec import resolve
from benchmarks.run.cell import Cell
from benchmarks.run.runner import run, run_cell
from benchmarks.run.store import Store
from controllers.name import PolicyName

PATCHES = """
import sys
import numpy as np
from controllers.laws import simple
from controllers.laws.simple import Zero

np.seterr(all="raise")
print("hello", sys.stdin.read())
simple.PdGravity.torque = lambda self, observation, state: (np.zeros((len(observation), 2)), state)


def make_policy(interface):
    return Zero(interface)
"""


def test_a_policy_that_patches_the_package_changes_no_other_row(tmp_path):
    """Its prints and what it reads stay with it."""
    (tmp_path / "patches.py").write_text(PATCHES)
    cells = [Cell(policy, "noise-1", (0, 1)) for policy in (str(tmp_path / "patches.py"), "pd-gravity")]
    truth, results = run_cell(cells[1]), [result for _, result in run(cells, Store(tmp_path / "store"), workers=1)]
    assert [result.error for result in results] == ["", ""]
    assert np.geterr()["divide"] == "warn"
    assert truth.rows[0]["error_pct"] in [result.rows[0]["error_pct"] for result in results]


LAW = """from controllers.laws.simple import Zero
class make_policy(Zero):
    def torque(self, observation, state):
        {}
"""
WORKS = "return super().torque(observation, state)"
NAMES = ("[red]a[" + "日本語" * 25, ":zap: a:b|`c*_<i>\n" + os.fsdecode(b"\xff"))
BAD = {
    "exits": ("import sys\nsys.exit(0)\n", WORKS, "SystemExit: 0"),
    "leaves": ("import os\n", "os._exit(0)", "its process died, with exit status 0"),
    "lacks": ("", "{}['lost']", "KeyError: 'lost'"),
}
TEXT = "class E(Exception):\n    def __str__(self):\n        raise RuntimeError\n"
FAILS = {
    "text": (TEXT, "raise E", "E: (its text raises an error)"),
    "loads": ("class E(BaseException):\n    pass\nraise E('no')\n", WORKS, "ValueError: E: no, while it was loaded"),
    "exits": BAD["exits"],
    "kills": ("import os\nos.kill(os.getpid(), 9)\n", WORKS, "ValueError: its process died, with exit status 137, while"),
    "segment": ("import ctypes\nctypes.string_at(0)\n", WORKS, "ValueError: its process died, with exit status 139, while"),
    "memory": ("import numpy as np\n", "return np.ones(10**10), state", "MemoryError: Unable to allocate 74.5 GiB"),
}  # fmt: skip


OTHERS = [("evaluate zero", "exits"), ("margins", "leaves"), ("check-policy", "leaves"), ("check-policy", "lacks")]


@pytest.mark.parametrize(("command", "law"), OTHERS)
def test_a_bad_policy_is_one_line_of_other_commands_too(command, law, folder, capfd):
    """Its code runs in another process, so it cannot end this one without a word."""
    head, body, reason = BAD[law]
    (folder / f"{law}.py").write_text(head + LAW.format(body))
    assert cli.main([*command.split(), f"{law}.py"]) in (1, 2)
    out, errors = capfd.readouterr()
    assert reason in out + errors
    assert "Traceback" not in errors
    assert Path.cwd() == folder


def test_a_process_that_changes_its_folder_runs_the_policies_of_the_new_one(tmp_path, monkeypatch):
    """The workers of the first board are still there when the second one starts."""
    digests = set()
    for law in ("Zero", "PdGravity"):
        (tmp_path / law).mkdir()
        monkeypatch.chdir(tmp_path / law)
        Path("law.py").write_text(f"from controllers.laws.simple import {law} as make_policy\n")
        ((done, result),) = run([Cell("law.py", "nominal", (0,))], Store(tmp_path / law / "store"), workers=2)
        assert (done, result.error) == ("computed", "")
        digests.add(resolve("law.py").code[""])
    assert len(digests) == 2


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits memory, and uses any file name")
def test_no_bad_policy_stops_the_board(tmp_path):
    """Each failure is listed with its reason, and names of any kind have their rows, in a report too."""
    for name in NAMES:
        (tmp_path / f"{name}.py").write_text(LAW.format(WORKS))
    for name, (head, body, _) in FAILS.items():
        (tmp_path / f"{name}.py").write_text(head + LAW.format(body))
    policies = (f"{name}.py" for name in (*NAMES, *FAILS))
    same = *["--scenarios", "nominal", "--seeds", "1", "--store", "store", "--policies", "zero"], *policies

    def fbl_gym(*words):
        line = [sys.executable, "-m", "fbl_gym", *words]
        done = subprocess.run(line, capture_output=True, text=True, cwd=tmp_path, stdin=subprocess.DEVNULL)
        assert (done.returncode, "Traceback" in done.stdout + done.stderr) == (1, False), done.stderr
        return " ".join(done.stdout.split())

    shown = fbl_gym("leaderboard", *same, "--cell-memory", "3", "--workers", "2")
    for name, (_, _, reason) in FAILS.items():
        assert f"Left out: {name}.py: {reason}" in shown
    assert shown.count("Left out") == len(FAILS)
    assert len(list((tmp_path / "store").glob("*--*.json"))) == 1 + len(NAMES)
    fbl_gym("report", *same)
    table = (tmp_path / "results" / "report" / "board.md").read_text(encoding="utf-8")
    assert sum(line.startswith("|") for line in table.splitlines()) == 2 + 1 + len(NAMES)
    assert "`` :zap: a:b\\|`c*_<i> " in table
    assert "Left out: loads.py: ValueError: E: no" in table


@pytest.mark.parametrize("gain", ["kind", "needs"])
def test_a_gain_with_the_name_of_a_declaration_is_refused(gain, tmp_path):
    text = "from dataclasses import dataclass\nfrom controllers.laws.simple import Zero\n@dataclass(frozen=True)\n"
    (tmp_path / "law.py").write_text(f"{text}class make_policy(Zero):\n    {gain}: str = 'pd'\n")
    assert f"gain '{gain}' of" in (problem := resolve(str(tmp_path / "law.py")).problem)
    assert "must have another name: the name is reserved" in problem


LATE = "it took longer than 1 s, see leaderboard --cell-timeout"


HANGS = {
    "hangs": "while True: pass",
    "stops": "import os, signal; os.kill(os.getpid(), signal.SIGSTOP)",
    "stops-parent": "import os, signal; os.kill(os.getppid(), signal.SIGSTOP); return super().torque(observation, state)",
}


@pytest.mark.parametrize("how", HANGS)
def test_a_policy_that_hangs_is_a_failed_cell(how, tmp_path):
    """While it runs, and while it is loaded. The next call has a server that works."""
    (tmp_path / "hangs.py").write_text(LAW.format(HANGS[how]))
    (tmp_path / "loading.py").write_text("import time\ntime.sleep(600)\n")
    limits = CallLimits(seconds=1.0)
    assert run_cell(Cell(str(tmp_path / "hangs.py"), "nominal", (0,)), limits=limits).error == LATE
    assert resolve(str(tmp_path / "loading.py"), limits).problem == f"{LATE}, while it was loaded"


def leave_group():
    os.setpgid(0, os.getpgid(os.getppid()))


def print_much():
    print("\x1b[2J" + "x" * 10**7)
    return "answer"


@pytest.mark.skipif(sys.platform == "win32", reason="has no groups of processes")
def test_a_call_stays_in_its_group_and_shows_the_first_of_its_prints(capfd):
    with pytest.raises(Failed, match="PermissionError"):
        run_isolated(leave_group)
    assert run_isolated(print_much) == "answer"
    assert re.fullmatch(r"\\u001b\[2Jx{9000,20000} \.\.\.\n", capfd.readouterr().err)


def test_the_order_of_a_set_is_the_same_in_each_run():
    fixed = os.environ | {"PYTHONHASHSEED": "0"}
    shown = subprocess.check_output([sys.executable, "-c", "print(hash('kp'))"], env=fixed)
    assert run_isolated(hash, "kp") == int(shown)


def start_and_hang():
    """Start a process that holds all pipes and never ends, as a careless policy may."""
    os.fork()
    time.sleep(600)


def answer_and_leave(flag):
    child = os.fork()
    if child == 0:
        time.sleep(600)
    Path(flag).write_text(str(child))
    return "answer"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_the_processes_of_a_call_end_with_it(tmp_path):
    """At its limit of time, too, though a grandchild holds the standard output."""
    begin = time.monotonic()
    assert run_isolated(answer_and_leave, str(tmp_path / "flag")) == "answer"
    with pytest.raises(Failed, match="it took longer than 2 s"):
        run_isolated(start_and_hang, limits=CallLimits(seconds=2.0))
    status = Path("/proc", (tmp_path / "flag").read_text(), "stat")
    assert not status.exists() or status.read_text().rpartition(") ")[2].startswith("Z")
    assert time.monotonic() - begin < 60  # of 600 s that the processes sleep


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
def test_an_answer_is_data_or_an_error(data, folder):
    """And no code of it runs in this process."""
    with pytest.raises(Failed, match="its answer cannot be read"):
        run_isolated(answer_with, data)
    assert not (folder / "ran").exists()


def test_no_standard_module_is_imported_from_the_current_folder(tmp_path):
    for name in ("signal", "select", "pickle", "multiprocessing", "tempfile"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w').close()\nraise SystemExit\n")
    (tmp_path / "law.py").write_text(LAW.format(WORKS))
    line = "leaderboard --policies zero law.py --scenarios nominal noise-1 --seeds 1 --workers 2"
    code = f"import sys; from benchmarks import cli; sys.exit(cli.main({line.split()}))"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "ran").exists()


BROKEN = tomllib.loads(Path(__file__).with_name("broken_promises.toml").read_text(encoding="utf-8"))
PROLOGUE = BROKEN.pop("prologue")


@pytest.mark.parametrize(("promise", "law"), [(promise, law) for promise, laws in BROKEN.items() for law in laws])
def test_the_board_runs_no_law_whose_number_depends_on_more_than_its_key(promise, law, tmp_path):
    """Even if it shows after 70 steps alone."""
    late, *named = law
    (tmp_path / "k.txt").write_text("0.5")
    (tmp_path / "helper.py").write_text("K = 0.5")
    py_compile.compile(str(tmp_path / "helper.py"), str(tmp_path / "compiled.pyc"))
    (tmp_path / "names" / "one").mkdir(parents=True)
    shutil.copy(np.random.bit_generator.__file__, tmp_path / "k.so")
    with zipfile.ZipFile(tmp_path / "k.zip", "w") as archive:
        archive.writestr("k", "0.5")
    (tmp_path / "law.py").write_text(PROLOGUE.format(late=late))
    factory = ":Law" if promise == "beside its key" else ""
    error = run_cell(Cell(f"{tmp_path}/law.py{factory}", "nominal", (0,))).error
    assert all(text in error for text in ("breaks a promise", promise, *named)), error


FAILS_ONCE = """
from pathlib import Path
from controllers.laws.simple import Zero as make_policy
if not (flag := Path(__file__).with_name("flag")).exists():
    flag.touch()
    raise RuntimeError
"""


def test_a_law_that_failed_when_it_was_resolved_has_no_number(tmp_path):
    """Its key would lack its code."""
    (tmp_path / "law.py").write_text(FAILS_ONCE)
    errors = [run_cell(Cell(str(tmp_path / "law.py"), "nominal", (0,))).error for _ in range(2)]
    assert "law.py could not be read when it was resolved; run it again" in errors[0]
    assert errors[1] == ""


DECLARED = """
from pathlib import Path
import numba
from controllers.laws.simple import PdGravity
from helper import gain

@numba.njit(cache=True)
def scaled(torque):
    return torque * gain()

class make_policy(PdGravity):
    data_files = {declared!r}
    def torque(self, observation, state):
        torque, state = super().torque(observation, state)
        return scaled(torque) * float((Path(__file__).parent / "weights" / "k.txt").read_text()), state
"""


COMPILED = "import numba\n@numba.njit\ndef gain():\n    return {}\n"


@pytest.mark.parametrize("declared", [("weights",), ("*/k.t?t",)])
def test_a_number_follows_what_the_law_declares_and_imports(declared, tmp_path):
    """Files, folders and patterns; a compiled helper is not kept from an earlier run."""
    files = {"law.py": DECLARED.format(declared=declared), "weights/k.txt": "1.0", "helper.py": ""}
    (tmp_path / "weights").mkdir()
    results = []
    for file, content in (("helper.py", "1.0"), ("helper.py", "0.5"), ("weights/k.txt", "0.5")):
        files[file] = content if file != "helper.py" else COMPILED.format(content)
        for name, text in files.items():
            (tmp_path / name).write_text(text)
        results.append(run_cell(Cell(str(tmp_path / "law.py"), "nominal", (0,))))
    assert [result.error for result in results] == ["", "", ""]
    assert len({result.cell.key for result in results}) == len({result.rows[0]["error_pct"] for result in results}) == 3


FLAGGED = "from controllers.laws.simple import Zero as make_policy\nopen({flag!r}, 'w').close()\n"


@pytest.fixture
def flag(folder):
    """Files of this name are written by the law's code."""
    (folder / "law_for_trust.py").write_text(FLAGGED.format(flag=str(folder / "ran")))
    return folder / "ran"


@pytest.mark.parametrize("name", ["law_for_trust.py", "law_for_trust:make_policy"])
def test_a_result_that_names_code_is_verified_only_with_trust(name, flag, fbl_gym):
    store = Store(flag.parent / "store")
    path = store.save(run_cell(Cell(name, "nominal", (0,))))
    flag.unlink()
    shown = fbl_gym(f"verify {path} --store store", 2).err
    assert f"names {name}, whose code would be run; give --trust if you trust it" in shown
    assert (len(list(store.results())), flag.exists()) == (1, False)
    fbl_gym(f"verify {path} --store store --trust")
    assert flag.exists()


@pytest.mark.parametrize(("named", "status"), [("law_for_trust.py", 0), ("a.zip", 1)])
def test_a_suite_that_names_code_runs_only_with_trust(named, status, flag, fbl_gym):
    """Trust covers archives too; this one is then refused for its content."""
    (flag.parent / "a.zip").write_bytes(b"PK")
    (flag.parent / "mine.toml").write_text(f'policies = ["zero", "{named}"]\nscenarios = ["nominal"]\nseeds = 1\n')
    line = "leaderboard --suite mine.toml --store store --workers 1"
    assert f"mine.toml names {named}, whose code would be run; give --trust" in fbl_gym(line, 2).err
    assert not flag.exists()
    shown = " ".join(fbl_gym(f"{line} --trust", status).out.split())
    assert (flag.exists(), "a.zip must be an archive" in shown) == (status == 0, status == 1)


FILES = {
    "broken_law.py": "raise ImportError('my dependency is missing')\n",
    "works_law.py": "from controllers.laws.simple import Zero as make_policy\n",
    "theirs-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n",
    "theirs-1.0.dist-info/entry_points.txt": "[fbl_gym.policies]\nbroken = broken_law:make_policy\n"
    "works = works_law:make_policy\ntd3 = works_law:make_policy\n",
}


def test_a_broken_plugin_is_named_and_the_rest_works(tmp_path):
    (tmp_path / "theirs-1.0.dist-info").mkdir()
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    code = f"import sys; sys.path.append({str(tmp_path)!r}); from fbl_gym.__main__ import main; sys.exit(main())"

    def fbl_gym(line):
        return subprocess.run([sys.executable, "-c", code, *line.split()], capture_output=True, text=True, cwd=tmp_path)

    lines = {line.split()[0]: line for line in fbl_gym("list policies").stdout.splitlines()}
    missing = "ImportError: my dependency is missing"
    shown = {"broken": f"cannot be loaded: {missing}", "works": "access: none", "td3": "trained on everything-2"}
    assert all(text in lines[name] for name, text in shown.items())
    board = fbl_gym("leaderboard --policies zero broken works --scenarios nominal --seeds 1 --workers 1")
    assert f"Left out: broken: {missing}" in board.stdout
    assert " works " in board.stdout
    assert "Traceback" not in board.stderr


def test_a_file_without_a_factory_suggests_its_class_and_no_imported_name(tmp_path):
    law = tmp_path / "law.py"
    law.write_text("from controllers import TorqueLaw\ndef helper(): ...\nclass MyLaw(TorqueLaw): ...\nother = MyLaw\n")
    with pytest.raises(NotFound, match=r"law.py has no make_policy: add `make_policy = MyLaw`, or give .*:MyLaw"):
        load(PolicyName.parse(str(law)))
    assert load(PolicyName.parse(f"{law}:other")).__name__ == "MyLaw"
    with pytest.raises(NotFound, match=r"unknown factory of .*law\.py 'Law'.* Known: MyLaw$"):
        load(PolicyName.parse(f"{law}:Law"))
    law.write_text("from controllers.laws.simple import Zero\n")
    with pytest.raises(NotFound, match=r"unknown factory of .*law\.py 'make_policy'\. Known: none"):
        load(PolicyName.parse(str(law)))
