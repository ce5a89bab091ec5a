"""External policies in a run: they reach no other row and stop no other cell."""

import subprocess
import sys

import pytest

from benchmarks import cli
from benchmarks.policies.spec import resolve_apart
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
        f"cells = [Cell(p, 'noise-1', (0, 1)) for p in ({str(tmp_path / 'patches.py')!r}, 'pd-gravity')]; "
        f"print([o.error for o in run(cells, Store(Path({str(store.folder)!r})), workers={workers})])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "['', '']\n"
    assert str(store.find(clean).rows[0]["error_pct"]) == truth.stdout.strip()


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
