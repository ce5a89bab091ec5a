"""Real local clusters of Dask and Ray: the same bits as on one machine, and a worker killed mid-run costs nothing."""

import json
from pathlib import Path

import pytest

from benchmarks.run.runner import run
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell, named, narrow

DEADLY = """
import os, pathlib, signal
from controllers.simple import Zero

flag = pathlib.Path({flag!r})


class Deadly(Zero):
    def torque(self, observation, state):
        if not flag.exists():
            flag.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().torque(observation, state)


make_policy = Deadly
"""


def cells():
    some = narrow(named("ideal"), ["zero", "pid-flm"], ["nominal", "noise-1"], 2).cells
    return [Cell(c.policy, c.scenario.replace(duration=0.5), c.seeds) for c in some]


def rows(folder):
    return {p.name: json.loads(p.read_text())["rows"] for p in Store(Path(folder)).files()}


@pytest.mark.parametrize("backend", ["dask", "ray"])
@pytest.mark.filterwarnings("ignore")
def test_a_cluster_gives_the_same_bits_and_survives_a_killed_worker(backend, tmp_path):
    pytest.importorskip({"dask": "distributed", "ray": "ray"}[backend])
    list(run(cells(), Store(tmp_path / "one")))
    file, flag = tmp_path / "deadly.py", tmp_path / "killed"
    file.write_text(DEADLY.format(flag=str(flag)))
    some = [*cells(), Cell(str(file), cells()[0].scenario, (0,))]
    outcomes = list(run(some, Store(tmp_path / "other"), workers=2, backend=backend))
    shut_down(backend)
    assert flag.exists()
    assert not [o for o in outcomes if o.error]
    found = rows(tmp_path / "other")
    assert len(found) == len(some)
    assert {name: found[name] for name in rows(tmp_path / "one")} == rows(tmp_path / "one")


def shut_down(backend):
    if backend == "ray":
        import ray

        ray.shutdown()
    else:
        from distributed import get_client

        client = get_client()
        if client.cluster is not None:
            client.cluster.close()
        client.close()
