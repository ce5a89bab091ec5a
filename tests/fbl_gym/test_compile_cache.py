"""The cache of compiled code: shared by processes; without one, an environment still works."""

import errno
import os
import subprocess
import sys

import pytest
from numba.core import caching

from fbl_gym import compile_cache
from fbl_gym.compile_cache import CompileCache
from fbl_gym.kernel import api
from fbl_gym.program import make_program
from fbl_gym.reward import Reward
from fbl_gym.scenarios import Scenario

WITHOUT_CACHE = """
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


def test_an_environment_works_without_a_writable_cache():
    done = subprocess.run([sys.executable, "-c", WITHOUT_CACHE], capture_output=True, text=True)
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
    """Three processes compile and write the cache; a later one compiles nothing."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", TOGETHER]
    workers = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    outputs = {worker.communicate()[0] for worker in workers}
    assert [worker.returncode for worker in workers] == [0, 0, 0]
    files = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")}
    assert files
    later = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert outputs == {later.stdout}
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")} == files


def first_step(folder):
    """Return the process that makes a first step with the cache in a folder."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    return subprocess.run([sys.executable, "-c", TOGETHER], env=environment, capture_output=True, text=True)


def test_a_damaged_cache_is_named_once_and_mended(tmp_path):
    whole = first_step(tmp_path)
    (index,) = tmp_path.rglob("*step*.nbi")
    (code,) = tmp_path.rglob("*step*.nbc")
    index.write_bytes(index.read_bytes()[:40])
    code.write_bytes(code.read_bytes()[:1000])
    damaged = first_step(tmp_path)
    assert damaged.returncode == 0, damaged.stderr
    assert damaged.stdout == whole.stdout
    assert damaged.stderr.count("RuntimeWarning") == 1
    assert f"{index.with_suffix('')}.*" in damaged.stderr
    assert first_step(tmp_path).stderr == ""


def test_a_cache_that_is_full_costs_time_only(monkeypatch):
    cache = CompileCache(first_step)

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(caching.Cache, "save_overload", full)
    monkeypatch.setattr(CompileCache, "_has_warned", False)
    with pytest.warns(RuntimeWarning, match="No space left"):
        cache.save_overload(None, None)


def test_a_lock_is_free_when_its_holder_has_died_and_no_wait_is_endless(tmp_path, monkeypatch):
    path = str(tmp_path / "lock")
    code = f"import time; from fbl_gym import compile_cache as c; f = c._lock({path!r}); print(1, flush=True); time.sleep(99)"
    monkeypatch.setattr(compile_cache, "PATIENCE", 0.1)
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as holder:
        holder.stdout.readline()
        assert compile_cache._lock(path) is None
        holder.kill()
    file = compile_cache._lock(path)
    assert file is not None
    file.close()


def test_compiled_code_is_kept_outside_the_package():
    assert "site-packages" not in api.STEPS[0]._cache.cache_path
    assert os.path.dirname(api.__file__) not in api.STEPS[0]._cache.cache_path


@pytest.mark.parametrize(
    ("options", "number"),
    [
        ({"parameter_error": 1.3, "actuator": {"delay": 0.01}}, 0),
        ({"noise": {"position": 1e-3}}, 1),
        ({"encoder": {"difference": 1}}, 2),
        ({"joint": {"stiffness": 3000.0, "rotor_inertia": 1.0}}, 3),
    ],
)
def test_a_scenario_gets_the_step_of_its_class(options, number):
    program = make_program(Scenario(**options), action="normalized", reward=Reward(), preview=0)
    assert api.class_of(program.settings) == number
