"""The cache of compiled code: shared by processes; without one, an environment still works."""

import os
import subprocess
import sys

import pytest

from fbl_gym.kernel.maths import fastmath
from fbl_gym.kernel.memory.program import make_program
from fbl_gym.kernel.step import api
from fbl_gym.options import Reward
from fbl_gym.scenarios import Scenario

WITHOUT_CACHE = """
from numba.core import caching
caching.CacheImpl._locator_classes = []  # as in a container whose file system is read-only
import numpy as np
import fbl_gym
env = fbl_gym.TwoLinkArmEnv()
env.reset(seed=0)
print(env.step(np.zeros(2))[0].shape)
from fbl_gym.kernel.step import api
print(api.STEPS[0]._cache.cache_path or "memory alone")
"""


@pytest.mark.slow
def test_an_environment_works_without_a_writable_cache():
    done = subprocess.run([sys.executable, "-c", WITHOUT_CACHE], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["(12,)", "memory alone"]
    assert done.stderr.count("RuntimeWarning: compiled code cannot be kept") == 1
    assert "NUMBA_CACHE_DIR" in done.stderr


TOGETHER = """
import numpy as np
import fbl_gym
env = fbl_gym.TwoLinkArmEnv("everything-2")
env.reset(seed=3)
print(env.step(np.array([0.1, -0.2]))[0].tobytes().hex())
"""


@pytest.mark.slow
def test_processes_share_what_one_has_compiled(tmp_path):
    """Two processes compile at once; a later one compiles nothing."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", TOGETHER]
    workers = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    outputs = {worker.communicate()[0] for worker in workers}
    assert [worker.returncode for worker in workers] == [0, 0]
    files = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")}
    assert files
    later = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert outputs == {later.stdout}
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")} == files


def test_a_change_of_any_source_changes_the_key():
    """Numba itself notices changes in the file of a cached function only."""
    keys = {step._cache._index_key(None, step.targetctx.codegen()) for step in api.STEPS}
    assert len(keys) == len(api.STEPS)
    assert {key[-1] for key in keys} == {fastmath._SOURCES.hexdigest()}


@pytest.mark.parametrize(
    ("options", "number"),
    [
        ({"parameter_error": 1.3, "actuator": {"delay": 0.01}}, 0),
        ({"noise": {"position": 1e-3}}, 1),
        ({"encoder": {"difference": 1}}, 2),
        ({"joint": {"stiffness": 3000.0, "rotor_inertia": 1.0}}, 3),
        ({"link": 8.0}, 4),
    ],
)
def test_a_scenario_gets_the_step_of_its_class(options, number):
    program = make_program(Scenario(**options), action="normalized", reward=Reward(), preview=0)
    assert api.step_number(program.settings) == number
