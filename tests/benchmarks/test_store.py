"""The store and the engine: killed, damaged, shared, full, and spread over workers."""

import json
import os
import signal
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

import controllers
from benchmarks.policies import resolve
from benchmarks.run import runner, store
from benchmarks.run.runner import run, run_cell
from benchmarks.run.store import Damaged, Store, identity, key
from benchmarks.run.suite import SPLITS, SUITES, Cell, load, named, narrow
from controllers.registry import ENTRY_POINTS
from fbl_gym import TwoLinkArmEnv

SHORT = {"duration": 0.5}


def cells(policies=("zero", "pid-flm", "cascade-flm"), seeds=3, families=("nominal", "mass-error-1", "noise-1")):
    suite = narrow(named("quick"), policies, families, seeds)
    return [Cell(c.policy, c.scenario.replace(**SHORT), c.seeds) for c in suite.cells]


def finish(some, folder, **options):
    return list(run(some, Store(Path(folder)), **options))


def contents(folder):
    """The numbers of each file, without times and machines."""
    found = {}
    for path in Store(Path(folder)).files():
        document = json.loads(path.read_text())
        found[path.name] = document["rows"]
    return found


def test_a_finished_cell_is_found_and_not_run_again(tmp_path, monkeypatch):
    assert {o.done for o in finish(cells(), tmp_path)} == {"computed"}
    before = {p: p.stat().st_mtime_ns for p in Store(tmp_path).files()}
    monkeypatch.setattr(runner, "rollout", lambda *_: pytest.fail("it was run again"))
    assert {o.done for o in finish(cells(), tmp_path)} == {"found"}
    assert {p: p.stat().st_mtime_ns for p in Store(tmp_path).files()} == before


def test_a_stored_result_is_what_was_measured(tmp_path):
    (cell,) = cells(["cascade-flm"], families=["noise-1"])
    fresh = run_cell(cell)
    path = Store(tmp_path).save(fresh)
    again = Store(tmp_path).load(path)
    assert again.cell == cell
    for one, two in zip(fresh.rows, again.rows, strict=True):
        np.testing.assert_array_equal(list(one.values()), list(two.values()))
    assert again.provenance["packages"]["numpy"] == np.__version__


def test_the_key_follows_everything_that_matters():
    (cell,) = cells(["pid-flm"], families=["nominal"])
    others = [
        Cell("cascade-flm", cell.scenario, cell.seeds),
        Cell("pid-flm", cell.scenario.replace(noise={"position": 1e-9}), cell.seeds),
        Cell("pid-flm", cell.scenario.replace(control_dt=0.02), cell.seeds),
        Cell("pid-flm", cell.scenario, (0, 1)),
    ]
    keys = [key(identity(c)) for c in (cell, *others)]
    assert len(set(keys)) == len(keys)
    assert key(identity(Cell("pid-flm", cell.scenario.replace(description="other words"), cell.seeds))) == keys[0]


def test_the_key_follows_gains_and_the_results_version(monkeypatch):
    (cell,) = cells(["pid-flm"], families=["nominal"])
    before = key(identity(cell))
    real = controllers.make
    monkeypatch.setattr("benchmarks.policies.resolve.controllers.make", lambda name, env: real(name, env, kp=11.0))
    assert key(identity(cell)) != before
    monkeypatch.undo()
    assert key(identity(cell)) == before
    monkeypatch.setattr(store, "VERSION", 99)
    assert key(identity(cell)) != before


def test_the_key_follows_a_strangers_code(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text("from controllers.simple import Zero as make_policy\n")
    cell = Cell(str(file), "nominal", (0,))
    before = key(identity(cell))
    file.write_text("from controllers.simple import Zero as make_policy  # changed\n")
    assert key(identity(cell)) != before


def tree(folder, files):
    """Files of Python, by their names without .py."""
    for name, text in files.items():
        path = folder / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


LAW = "from controllers.simple import Zero as make_policy\n"


def test_the_key_follows_what_a_strangers_file_imports(tmp_path):
    files = {
        "mine": f"def late():\n    import helper\n{LAW}",
        "helper": "from parts import deep\n",
        "parts/__init__": "",
        "parts/deep": "from .deeper import x\n",
        "parts/deeper": "x = 1\n",
        "other": "",
    }
    tree(tmp_path, files)
    cell = Cell(str(tmp_path / "mine.py"), "nominal", (0,))
    keys = [key(identity(cell))]
    for name in ("helper", "parts/__init__", "parts/deep", "parts/deeper"):
        with (tmp_path / f"{name}.py").open("a") as file:
            file.write("# changed\n")
        keys.append(key(identity(cell)))
    assert len(set(keys)) == 5
    (tmp_path / "other.py").write_text("# nobody imports it\n")
    assert key(identity(cell)) == keys[-1]


def test_the_key_follows_a_strangers_package(tmp_path, monkeypatch):
    """Named by a module, or by an entry point; a name of fbl-gym's own stays its own."""
    monkeypatch.syspath_prepend(tmp_path)
    tree(tmp_path, {"strangers_laws/part/law": LAW, "strangers_laws/gains": ""})
    points = [
        metadata.EntryPoint(name, "strangers_laws.part.law:make_policy", ENTRY_POINTS) for name in ("own", "pid-flm")
    ]
    monkeypatch.setattr("controllers.registry._entry_points", lambda: tuple(points))
    monkeypatch.setattr("benchmarks.policies.resolve._entry_points", lambda: tuple(points))
    some = [Cell(name, "nominal", (0,)) for name in ("strangers_laws.part.law:make_policy", "own", "pid-flm")]
    before = [key(identity(cell)) for cell in some]
    tree(tmp_path, {"strangers_laws/gains": "# changed\n"})
    after = [key(identity(cell)) for cell in some]
    assert [old == new for old, new in zip(before, after, strict=True)] == [False, False, True]


def test_the_keys_of_the_packages_own_policies_stay():
    """The board's results are found by them."""
    for policy in (*resolve.names(), "ppo-memory@1"):
        assert resolve.sources(policy) == []
    assert set(resolve.configuration("pid-flm", resolve.make("pid-flm", TwoLinkArmEnv()))) == {"kp", "ki", "kd"}


@pytest.mark.parametrize("workers", [1, 2])
def test_results_do_not_depend_on_workers_or_order(tmp_path, workers):
    finish(cells(), tmp_path / "one")
    finish(cells()[::-1], tmp_path / "other", workers=workers)
    assert contents(tmp_path / "one") == contents(tmp_path / "other")


def test_a_failing_policy_is_a_row_with_its_error(tmp_path):
    file = tmp_path / "bad.py"
    file.write_text("def make_policy(interface):\n    raise RuntimeError('I never work')\n")
    some = [*cells(["zero"]), Cell(str(file), "nominal", (0,))]
    outcomes = finish(some, tmp_path / "store")
    assert sorted(o.done for o in outcomes) == ["computed", "computed", "computed", "failed"]
    (failed,) = [o for o in outcomes if o.error]
    assert failed.error == "RuntimeError: I never work"
    (kept,) = [r for r in Store(tmp_path / "store").results(failed=True) if r.error]
    assert kept.error == failed.error
    # Mended, it runs, and the error is gone.
    file.write_text("from controllers.simple import Zero as make_policy\n")


def test_a_damaged_file_is_named_and_the_others_are_read(tmp_path):
    finish(cells(), tmp_path)
    victim = Store(tmp_path).files()[0]
    victim.write_text(victim.read_text().replace('"seeds":[0,1,2]', '"seeds":[0,1,3]'))
    with pytest.raises(Damaged, match=rf"{victim.name} is damaged \(its checksum is wrong\); delete it"):
        list(Store(tmp_path).results())
    victim.write_text("{")
    with pytest.raises(Damaged, match="is damaged"):
        Store(tmp_path).load(victim)
    assert len([Store(tmp_path).load(p) for p in Store(tmp_path).files()[1:]]) == len(cells()) - 1
    victim.unlink()
    assert [o.done for o in finish(cells(), tmp_path)].count("computed") == 1


def test_a_full_disk_is_an_error_and_leaves_the_rest(tmp_path, monkeypatch):
    some = cells(["zero"])
    finish(some[:1], tmp_path)
    real = os.fsync
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(OSError, match="No space left"):
        finish(some, tmp_path)
    monkeypatch.setattr(os, "fsync", real)
    assert len(Store(tmp_path).files()) == 1
    assert not list(tmp_path.glob(".*"))
    assert sorted(o.done for o in finish(some, tmp_path)) == ["computed", "computed", "found"]


COMMAND = [
    sys.executable, "-m", "benchmarks.cli.parser", "leaderboard", "--policies", "zero", "pd-gravity", "pid-flm", "cascade-flm",
    "--seeds", "8", "--workers", "1", "--scenarios", "nominal", "mass-error", "noise-1",
]  # fmt: skip


def test_kill_9_in_a_loop(tmp_path):
    """Killed again and again while it runs, the run goes on where it was: nothing lost, nothing doubled, nothing twice."""
    total, seen = 4 * 8, {}
    for _ in range(3):
        process = subprocess.Popen([*COMMAND, "--store", str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        target, deadline = len(seen) + 4, time.monotonic() + 60
        while len(Store(tmp_path).files()) < target and time.monotonic() < deadline and process.poll() is None:
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        now = {p.name: (p.stat().st_mtime_ns, p.read_bytes()) for p in Store(tmp_path).files()}
        assert now.items() >= seen.items()
        assert len(now) > len(seen)
        seen = now
    done = subprocess.run([*COMMAND, "--store", str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    now = {p.name: (p.stat().st_mtime_ns, p.read_bytes()) for p in Store(tmp_path).files()}
    assert now.items() >= seen.items()
    assert len(now) == total
    assert len(list(Store(tmp_path).results())) == total


def test_two_processes_share_a_store(tmp_path):
    both = [
        subprocess.Popen([*COMMAND, "--store", str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        for _ in range(2)
    ]
    for process in both:
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
    assert len(list(Store(tmp_path).results())) == 4 * 8
    assert not list(tmp_path.glob(".*"))


def test_a_worker_killed_in_a_cell_costs_no_result(tmp_path):
    """The policy kills its own worker the first time: the pool dies, and the run notices what is missing."""
    file = tmp_path / "deadly.py"
    flag = tmp_path / "killed"
    file.write_text(
        "import os, pathlib, signal\n"
        "from controllers.simple import Zero\n"
        f"flag = pathlib.Path({str(flag)!r})\n"
        "class Deadly(Zero):\n"
        "    def torque(self, observation, state):\n"
        "        if not flag.exists():\n"
        "            flag.touch()\n"
        "            os.kill(os.getpid(), signal.SIGKILL)\n"
        "        return super().torque(observation, state)\n"
        "make_policy = Deadly\n"
    )
    some = [*cells(["zero", "pid-flm"]), Cell(str(file), cells()[0].scenario, (0, 1))]
    outcomes = finish(some, tmp_path / "store", workers=2)
    assert flag.exists()
    assert len(list(Store(tmp_path / "store").results())) == len(some)
    assert not [o for o in outcomes if o.error]


def test_a_policy_that_always_kills_its_worker_is_a_failure_and_the_rest_is_done(tmp_path):
    file = tmp_path / "deadly.py"
    file.write_text(
        "import os, signal\nfrom controllers.simple import Zero\n"
        "class Deadly(Zero):\n    def torque(self, observation, state):\n        os.kill(os.getpid(), signal.SIGKILL)\n"
        "make_policy = Deadly\n"
    )
    some = [*cells(["zero"]), Cell(str(file), cells()[0].scenario, (0, 1))]
    outcomes = finish(some, tmp_path / "store", workers=2)
    assert len(list(Store(tmp_path / "store").results())) == len(some) - 1
    (failed,) = [o for o in outcomes if o.error]
    assert "its worker died" in failed.error


def test_splits_do_not_overlap():
    ranges = list(SPLITS.values())
    for i, one in enumerate(ranges):
        for other in ranges[i + 1 :]:
            assert one.stop <= other.start or other.stop <= one.start


def test_suites(tmp_path):
    for name in SUITES:
        suite = named(name)
        assert len({c.id for c in suite.cells}) == len(suite.cells)
        assert all(seed in SPLITS["test"] for c in suite.cells[:1] for seed in c.seeds)
    assert {c.scenario.control_dt for c in named("kilohertz").cells} == {1e-3}
    assert len(named("full").scenarios) >= 8 * 4
    assert named("full").seeds == 256
    file = tmp_path / "mine.toml"
    file.write_text('policies = ["zero"]\nscenarios = ["noise", {name = "own", noise = {position = 0.1}}]\nseeds = 5\n')
    suite = load(str(file))
    assert [s.name for s in suite.scenarios][-1] == "own"
    assert len(suite.cells) == 7
    assert suite.cells[0].seeds == tuple(range(5))
    file.write_text("policy = 3\n")
    with pytest.raises(ValueError, match=r"unknown entry of .*mine.toml 'policy'; did you mean 'policies'"):
        load(str(file))
    file.write_text("policies = [\n")
    with pytest.raises(ValueError, match="is no TOML"):
        load(str(file))
    with pytest.raises(ValueError, match="unknown suite 'quik'; did you mean 'quick'"):
        load("quik")
    with pytest.raises(ValueError, match="seeds must be at most"):
        narrow(named("quick"), seeds=20_000)
