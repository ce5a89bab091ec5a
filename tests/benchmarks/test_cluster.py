"""Cells on a Dask cluster: a scheduler and two workers on this machine, one of which is killed."""

import subprocess
import sys
import time

import pytest

from benchmarks.run.cell import Cell
from benchmarks.run.runner import run
from benchmarks.run.store import Store
from fbl_gym import scenarios

pytestmark = pytest.mark.slow
distributed = pytest.importorskip("distributed")

SLOW = """
import time
from controllers.laws.simple import PdGravity


class make_policy(PdGravity):
    def initial(self, observation):
        time.sleep(0.05)
        return super().initial(observation)
"""


@pytest.fixture
def cluster(tmp_path):
    """The address of a scheduler, and its workers."""
    file = tmp_path / "scheduler.json"
    worker = "worker --nthreads 1 --no-nanny"
    processes = []
    for line in ("scheduler --host 127.0.0.1 --port 0", worker, worker):
        command = f"-m distributed.cli.dask_{line} --no-dashboard --scheduler-file"
        processes.append(subprocess.Popen([sys.executable, *command.split(), file], stderr=subprocess.DEVNULL))
    with distributed.Client(scheduler_file=str(file), timeout=60, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=120)
        address = client.scheduler.address
    yield address, processes[1:]
    for process in processes[::-1]:
        process.kill()
        process.wait()


@pytest.mark.filterwarnings("default")
def test_a_killed_worker_costs_nothing_and_the_numbers_are_the_same(cluster, tmp_path):
    """One worker is killed while it runs a cell of an external law."""
    address, workers = cluster
    (tmp_path / "slow.py").write_text(SLOW)
    tasks = [scenarios.get(name).replace(duration=0.5) for name in ("nominal", "noise-1", "noise-2", "mass-error-1")]
    cells = [Cell(policy, task, (0, 1)) for task in tasks for policy in ("cascade-flm", str(tmp_path / "slow.py"))]
    here, there = Store(tmp_path / "here"), Store(tmp_path / "there")
    assert not [result.error for _, result in run(cells, here) if result.error]
    outcomes = []
    for outcome in run(cells, there, cluster=address):
        outcomes.append(outcome)
        if len(outcomes) == 1:
            time.sleep(1.0)
            workers[0].kill()
    assert sorted(result.cell.id for _, result in outcomes) == sorted(cell.id for cell in cells)
    assert {done for done, _ in outcomes} == {"computed"}
    assert len(there.files()) == len(cells)
    for cell in cells:
        assert repr(here.find(cell).rows) == repr(there.find(cell).rows)
