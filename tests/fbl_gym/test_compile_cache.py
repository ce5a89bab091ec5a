"""Compiled code is kept where it can be, and an environment works where it cannot."""

import os
import subprocess
import sys

NOWHERE = """
from numba.core import caching
caching.CacheImpl._locator_classes = []  # as in a container whose file system is read-only
import numpy as np
import fbl_gym
env = fbl_gym.TwoLinkArmEnv()
env.reset(seed=0)
print(env.step(np.zeros(2))[0].shape)
from benchmarks.cli import doctor
print(doctor._cache())
"""


def test_an_environment_works_where_nothing_can_be_kept():
    done = subprocess.run([sys.executable, "-c", NOWHERE], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["(12,)", "memory alone: no folder can be written"]
    assert done.stderr.count("RuntimeWarning: compiled code cannot be kept") == 1
    assert "NUMBA_CACHE_DIR" in done.stderr


TOGETHER = """
import numpy as np
import fbl_gym
env = fbl_gym.TwoLinkArmEnv("everything-2")
env.reset(seed=3)
print(env.step(np.array([0.1, -0.2]))[0].tobytes().hex())
"""


def test_processes_that_start_together_share_what_they_compile(tmp_path):
    """Three find nothing kept, compile, and keep it; one that comes after compiles nothing."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", TOGETHER]
    workers = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    found = {worker.communicate()[0] for worker in workers}
    assert [worker.returncode for worker in workers] == [0, 0, 0]
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")}
    assert kept
    later = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert found == {later.stdout}
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")} == kept
