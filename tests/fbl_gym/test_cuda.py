"""The batch of a GPU gives the bits of the batch of a processor in every way of use.

Where there is no GPU, its code runs lane by lane on this processor.
"""

import contextlib
import copy
import functools
import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import error

from fbl_gym import TwoLinkArmVectorEnv
from fbl_gym.kernel import cuda
from fbl_gym.kernel.maths import fastmath
from tests.fbl_gym.episodes import EVENTFUL, ID, TIGHT, TRACKING
from tests.fbl_gym.test_vector_env import CHANGES, MODES, compare

with contextlib.suppress(ImportError):
    import torch

LANES = 37
BUSY = {"friction": {"coulomb": 10.0, "law": "literal"}, "noise": {"position": 1e-3, "acceleration": 1e-1}}
#: Name and options of environments, by the number of their compiled step.
CASES = {
    0: (ID, {"duration": 0.2, "parameter_error": 1.3, "actuator": {"delay": 0.01}}),
    1: (ID, {**BUSY, "disturbance": {"kind": "sine", "amplitude": 10.0}, "duration": 0.2, "constraints": TIGHT}),
    2: (ID, {**EVENTFUL, **CHANGES}),
    3: (TRACKING, {"scenario": "servo-elastic-2", "duration": 0.2, "preview": 2}),
    4: (ID, {**EVENTFUL, **CHANGES, "link": 8.0, "info": True}),
}


@functools.cache
def loop(name):
    """Return a function that runs the code of a thread for each lane."""
    lane_function = fastmath.kernel_njit(cuda.lane_function(name))

    def run(a, b, c, d, e, lanes):
        for lane in range(lanes):
            lane_function(a, b, c, d, e, lane)

    return fastmath.cached_njit(fastmath.named(run, name))


class Processor(cuda.TorchGpu):
    """Torch's tensors of this processor, in the place of those of a GPU."""

    place = "cpu"

    def _run(self, name, lanes, *numbers):
        loop(name)(*numbers, lanes)


@pytest.fixture
def gpu(monkeypatch):
    if not pytest.importorskip("torch").cuda.is_available():
        monkeypatch.setattr(cuda, "open_gpu", lambda: Processor(None))


def host(value):
    """Return a tensor as an array."""
    return value.cpu().numpy() if hasattr(value, "cpu") else value


class OnHost:
    """A vector environment on a GPU with the arrays and the `final_obs` of one on a processor."""

    def __init__(self, env):
        self.env, self.num_envs, self.metadata = env, env.num_envs, env.metadata

    def reset(self, seed=None, options=None):
        options = {name: torch.as_tensor(mask) for name, mask in (options or {}).items()}
        observations, infos = self.env.reset(seed=seed, options=options)
        return host(observations), infos

    def step(self, actions):
        *signals, infos = self.env.step(torch.as_tensor(actions))
        assert all(isinstance(x, torch.Tensor) for x in signals)
        observations, rewards, terminated, truncated = map(host, signals)
        if self.metadata["autoreset_mode"].value == "SameStep":  # a GPU has the rows of all lanes
            rows, ended = host(infos.pop("final_obs")), host(infos.pop("_final_obs"))
            np.testing.assert_array_equal(ended, terminated | truncated)
            if ended.any():
                final = np.array([row if over else None for row, over in zip(rows, ended, strict=True)], dtype=object)
                infos = {"final_info": {}, "_final_info": ended} | infos | {"final_obs": final, "_final_obs": ended}
        return observations, rewards, terminated, truncated, infos


def pair(number=0, mode="NextStep"):
    """Return an environment on a processor and on a GPU."""
    name, options = CASES[number]
    options = {"vectorization_mode": "vector_entry_point", "autoreset_mode": mode, **options}
    return gym.make_vec(name, LANES, **options), gym.make_vec(name, LANES, device="cuda", **options).unwrapped


@pytest.mark.usefixtures("gpu")
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("number", [pytest.param(n, marks=[pytest.mark.slow] * (n not in (1, 4))) for n in CASES])
def test_steps_and_resets_have_the_bits_of_the_processor(number, mode):
    ours, theirs = pair(number, mode)
    assert theirs._batch._class == number
    actions = iter(np.random.default_rng(0).uniform(-1, 1, (200, LANES, 2)))
    assert compare(ours, OnHost(theirs), actions, 100)[0] > 0
    theirs = copy.deepcopy(theirs)
    np.testing.assert_array_equal(ours.reset()[0], host(theirs.reset()[0]))
    given = next(actions)
    np.testing.assert_array_equal(ours.step(given)[0], host(theirs.step(given)[0]))
    theirs.check()
    np.testing.assert_equal(vars(ours.unwrapped.truth), vars(theirs.truth))


@pytest.mark.usefixtures("gpu")
def test_a_lane_that_is_refused_stands_still_and_check_names_it():
    env = pair(mode="Disabled")[1]
    env.reset(seed=0)
    before = env.truth.time
    actions = np.zeros((LANES, 2))
    actions[20, 1] = np.inf
    rewards = env.step(actions)[1]
    for stands in (env.truth.time == before, np.isnan(host(rewards))):
        np.testing.assert_array_equal(stands, np.arange(LANES) == 20)
    with pytest.raises(ValueError, match="finite in lane 20"):
        env.check()
    env.check()
    for _ in range(20):
        env.step(np.zeros((LANES, 2)))
    with pytest.raises(error.ResetNeeded, match="the episode of lane"):
        env.check()
    with pytest.raises(ValueError, match="action must have shape"):
        env.step(np.zeros((LANES, 3)))


def test_what_a_gpu_cannot_do_is_refused_by_name():
    for more, match in (
        ({"plant": "mujoco"}, "'cpu' with plant='mujoco'"),
        ({"threads": 2}, "threads must be None with dev"),
    ):
        with pytest.raises(ValueError, match=match):
            TwoLinkArmVectorEnv(2, device="cuda", **more)
    with pytest.raises(ValueError, match=r"unknown device 'gpu'.*Known: cpu, cuda"):
        TwoLinkArmVectorEnv(2, device="gpu")
    try:
        cuda.open_gpu()
    except (ImportError, RuntimeError):
        with pytest.raises(error.DependencyNotInstalled, match=r"fbl-gym\[cuda\]|NVIDIA GPU and its driver"):
            TwoLinkArmVectorEnv(2, device="cuda")


SLOW = [pytest.param(number, marks=pytest.mark.slow) for number in (1, 2, 3, 4)]


@pytest.mark.parametrize("name", ["scale", 0, *SLOW])
def test_the_linked_code_contracts_nothing(monkeypatch, name):
    """With a sum of a product in place of the source's `fma`, there is none. It is linked here without a GPU."""
    pytest.importorskip("numba_cuda", reason="needs the extra cuda", exc_type=ImportError)
    from numba.cuda import dispatcher

    monkeypatch.setattr(fastmath, "fma", fastmath.inline_njit(lambda a, b, c: a * b + c))
    monkeypatch.setattr(dispatcher, "get_current_device", lambda: type("Card", (), {"compute_capability": (9, 0)}))
    text = cuda.compile_lane(name, (9, 0), ptx=True).decode()
    found = set(re.findall(r"\b(add|sub|mul|mad|fma|div|sqrt)((?:\.\w+)*)\.f64", text))
    assert {"sub", "div"} <= {operation for operation, _ in found} <= {"add", "sub", "mul", "div", "sqrt"}
    assert {rounding for _, rounding in found} == {".rn"}
