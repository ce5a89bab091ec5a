"""Compiled code is kept where it can be, and an environment works where it cannot."""

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
from benchmarks.commands import doctor
print(doctor._cache())
"""


def test_an_environment_works_where_nothing_can_be_kept():
    done = subprocess.run([sys.executable, "-c", NOWHERE], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["(12,)", "memory alone: no folder can be written"]
    assert done.stderr.count("RuntimeWarning: compiled code cannot be kept") == 1
    assert "NUMBA_CACHE_DIR" in done.stderr
