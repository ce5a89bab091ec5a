"""Stopped runs: nothing is left behind, and the message says what is kept."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks.run.store import Store

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")

SLOW = """
import time
from controllers.laws.simple import Zero


class make_policy(Zero):
    def initial(self, observation):
        open({flag!r}, "w").close()
        {wait}
        return super().initial(observation)
"""
WAITS = {"sleeps": "time.sleep(600)", "computes": "while True: pass"}


def living(number, folder=None):
    """The processes of a group without zombies, and isolated calls that run in a folder."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, _, of = (process / "stat").read_text().rpartition(") ")[2].split()[:3]
            isolated = "fresh.py" in (process / "cmdline").read_text() and (process / "cwd").readlink() == folder
            if isolated or (int(of) == number and state != "Z"):
                found.append(int(process.name))
    return found


def wait(until, seconds):
    end = time.monotonic() + seconds
    while not until() and time.monotonic() < end:
        time.sleep(0.05)
    return until()


def begin(*command, **options):
    """Start a process that takes Ctrl-C, which a shell's background job ignores."""
    return subprocess.Popen(
        [sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL), **options,
    )  # fmt: skip


@pytest.fixture
def start(tmp_path):
    """A board with a law that never ends, once the law runs and some cells are stored."""
    processes = []

    def start(how="sleeps", workers=2):
        flag, law = tmp_path / "runs", tmp_path / "slow.py"
        law.write_text(SLOW.format(flag=str(flag), wait=WAITS[how]))
        line = f"leaderboard --policies zero slow.py --scenarios nominal noise mass-error --seeds 1 --workers {workers}"
        command = "-m", "fbl_gym", *line.split(), "--store", "store"
        process = begin(*command, start_new_session=True, stdin=subprocess.DEVNULL, cwd=tmp_path)
        processes.append(process)
        assert wait(lambda: flag.exists() and (workers == 1 or Store(tmp_path / "store").files()), 120)
        return process

    yield start
    for process in processes:
        for pid in living(process.pid):
            os.kill(pid, signal.SIGKILL)
        process.communicate()


def test_a_stopped_board_leaves_no_process_and_says_what_is_kept(start):
    """A terminal sends Ctrl-C to all processes."""
    process = start()
    os.killpg(process.pid, signal.SIGINT)
    out, errors = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "stopped; finished cells are kept, and the same command goes on" in errors
    assert "Traceback" not in out + errors
    assert wait(lambda: not living(process.pid), 5)


def test_a_board_whose_store_cannot_be_written_ends(tmp_path):
    """With more cells than workers. The largest size of a file stands for a full disk."""
    line = "leaderboard --policies zero pd-gravity --workers 2 --scenarios nominal noise mass-error --seeds 1 --store"
    command = f"ulimit -f 0; exec {sys.executable} -m fbl_gym {line} {tmp_path}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 2
    assert "File too large" in done.stderr


@pytest.mark.parametrize(("how", "workers", "number"), [("sleeps", 2, signal.SIGKILL), ("computes", 1, signal.SIGTERM)])
def test_workers_end_within_five_seconds_of_a_killed_parent(how, workers, number, start, tmp_path):
    process = start(how, workers)
    assert living(-1, tmp_path)
    process.send_signal(number)
    assert wait(lambda: not living(process.pid, tmp_path), 5)


LOST = """
import os, signal, time
from fbl_gym.__main__ import keep_interrupts
class Finalized:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1)
keep_interrupts()
try:
    Finalized()
    time.sleep(60)
except KeyboardInterrupt:
    print("stopped")
"""


def test_an_interrupt_in_a_finalizer_is_not_lost():
    assert begin("-c", LOST).communicate(timeout=60) == ("stopped\n", "")


def test_other_commands_say_what_is_kept_too(tmp_path):
    line = f"tune pd-gravity --trials 100000 --seeds 1 --scenarios nominal --storage sqlite:///{tmp_path}/studies.db"
    process = begin("-m", "fbl_gym", *line.split())
    assert wait(lambda: list(tmp_path.glob("*.db")), 240)
    time.sleep(1)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors == "fbl-gym: stopped; finished trials are kept, and the same command goes on\n"
