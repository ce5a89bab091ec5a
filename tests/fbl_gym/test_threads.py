"""Threads of a batch: the same bits for any number, in forks, beside other threads, and at a process's end."""

import copy
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from itertools import product

import gymnasium as gym
import numpy as np
import pytest

from fbl_gym import TwoLinkArmVectorEnv
from fbl_gym.kernel.step import api, pool
from tests.fbl_gym.episodes import ID
from tests.fbl_gym.test_cuda import CASES
from tests.fbl_gym.test_vector_env import MODES, compare

LANES = 330
pytestmark = pytest.mark.skipif(not pool.SUPPORTED, reason="one thread on this system")


def batch(name=ID, threads=3, **options):
    env = gym.make_vec(name, LANES, vectorization_mode="vector_entry_point", threads=threads, **options)
    env.reset(seed=5)
    return env


def joined():
    """Return the number of workers that took part in the last step."""
    job = pool.POOL.job.view(pool._JOB)[0]
    return job["threads"] - 1 - job["seats"]


@pytest.mark.parametrize(("case", "mode"), [*zip(CASES, MODES * 2, strict=False), *product([2], MODES[:2])])
def test_any_number_of_threads_gives_the_same_bits(case, mode):
    name, options = CASES[case]
    rng, workers, deadline = np.random.default_rng(0), [], time.monotonic() + 20

    def actions():
        while True:
            yield rng.uniform(-1, 1, (LANES, 2))
            workers.append(joined())

    for threads in (2, 5):
        alone, env = (batch(name, n, autoreset_mode=mode, **options) for n in (1, threads))
        assert env.unwrapped._batch._class == case
        ends, _ = compare(env, alone, given := actions(), 60)
        assert ends > 0
        assert env.unwrapped._batch._memory.tobytes() == alone.unwrapped._batch._memory.tobytes()
    assert len(api.STEPS[env.unwrapped._batch._class].overloads) == 1  # compiled once for both ways
    while not any(workers) and time.monotonic() < deadline:
        env.reset()
        env.step(next(given))
    assert any(workers)


def test_what_is_refused_moves_no_lane():
    env = batch()
    before = env.unwrapped._batch.field("position")
    actions = np.zeros((LANES, 2))
    actions[300, 1] = np.nan
    with pytest.raises(ValueError, match="lane 300"):
        env.step(actions)
    np.testing.assert_array_equal(env.unwrapped._batch.field("position"), before)
    for threads in (0, 2.5, 2000):
        with pytest.raises((TypeError, ValueError), match="threads"):
            TwoLinkArmVectorEnv(2, threads=threads)
    with pytest.raises(ValueError, match="threads must be 1 or None with a plant"):
        TwoLinkArmVectorEnv(2, plant="mujoco", threads=2)


def test_copies_forks_and_python_threads_step_alike():
    """A fork has no workers; of two threads of Python, one has them at a time."""
    env, actions = batch(scenario="everything-2"), np.full((LANES, 2), 0.1)
    env.step(actions)
    others = [pickle.loads(pickle.dumps(env)), *(copy.deepcopy(env) for _ in range(5))]
    steps = lambda env: [env.step(actions) for _ in range(50)]
    threads = [threading.Thread(target=steps, args=(one,)) for one in others]
    for thread in threads:
        thread.start()
    reader, writer = os.pipe()
    child = os.fork()
    for _ in range(50):
        observations = env.step(actions)[0]
    if not child:
        try:
            os.write(writer, bytes([pool.POOL.workers]) + observations[:100].tobytes())
        finally:
            os._exit(0)
    for thread in threads:
        thread.join()
    assert os.waitpid(child, 0)[1] == 0
    assert os.read(reader, 10**6) == bytes([2]) + observations[:100].tobytes()
    for one in others:
        assert one.unwrapped._batch._memory.tobytes() == env.unwrapped._batch._memory.tobytes()
    assert sum(thread.name == "fbl_gym" for thread in threading.enumerate()) == pool.POOL.workers < 5


LOOP = """
import signal
import numpy as np
import fbl_gym
env = fbl_gym.TwoLinkArmVectorEnv(2048, threads=3)
env.reset(seed=0)
env.step(np.zeros((2048, 2)))
signal.signal(signal.SIGINT, signal.default_int_handler)  # which a job in the background ignores
print("stepped", flush=True)
while {loops}:
    env.step(np.zeros((2048, 2)))
"""


@pytest.mark.parametrize("loops", [False, True])
def test_a_process_ends_by_itself_and_by_an_interrupt(loops):
    line, pipe = [sys.executable, "-c", LOOP.format(loops=loops)], subprocess.PIPE
    process = subprocess.Popen(line, stdout=pipe, stderr=pipe, text=True)
    process.stdout.readline()
    if loops:
        process.send_signal(signal.SIGINT)
    errors = process.communicate(timeout=20)[1]
    assert ("KeyboardInterrupt" in errors) == loops
    assert (process.returncode == 0) != loops


@pytest.mark.parametrize(("variable", "most"), [("1", 1), ("1,2", 1), ("0", 1), ("", 10**6), ("many", 10**6)])
def test_default_threads_are_the_cores_that_the_process_may_use(monkeypatch, variable, most):
    monkeypatch.setenv("OMP_NUM_THREADS", variable)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(3), raising=False)
    assert 1 <= pool.cores() <= min(most, 3)
    assert pool.threads_for(pool.LEAST_LANES, None) == pool.cores()
    assert pool.threads_for(pool.LEAST_LANES - 1, None) == 1
    assert [pool.threads_for(lanes, 4) for lanes in (1, 64, 128, 4096)] == [1, 1, 2, 4]
