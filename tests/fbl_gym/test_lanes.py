"""The batch: each lane bit for bit the single environment, in every autoreset mode."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from tests.fbl_gym.episodes import EVENTFUL, ID, MUJOCO, TIGHT, TRACKING, started, started_batch

MODES = [mode.value for mode in AutoresetMode]
LOAD = {"mass": 2.0, "offset": 0.1, "drop": 0.07}
CHANGES = {
    "actuator": {"delay": 0.003, "jitter": 0.02, "lag": 0.01, "ripple": 5.0},
    "parameter_error": {"radius": 0.3, "centre": {"uniform": [0.8, 1.2]}, "inertia": 1.0, "payload": LOAD},
    "events": [{"kind": "pick-up", "time": 0.05, "mass": 3.0}, {"kind": "drive", "time": 0.1, "factor": (1.0, 0.0)}],
}  # fmt: skip
DELAYED = {"scenario": "servo-delay-2", "duration": 0.08}
#: Name, lanes and options of environments.
CASES = {
    "tracking": (TRACKING, 3, {"scenario": "everything-2", "duration": 0.08, "preview": 1}),
    "history": (TRACKING, 3, {**DELAYED, "history": 2, "fine": 0.01, "drive": True}),
    "context": (TRACKING, 3, {"scenario": "everything-2", "duration": 0.08, "context": True}),
    "info": (ID, 3, {"scenario": "everything-2", "duration": 0.1, "info": True}),
    "costs": (ID, 3, {"duration": 0.08, "constraints": TIGHT}),
    "ends by constraints": (TRACKING, 3, {"duration": 0.3, "constraints": {**TIGHT, "violation": "end"}}),
    "late commands, changes": (ID, 9, {**EVENTFUL, **CHANGES}),
    "links": (ID, 9, {**EVENTFUL, **CHANGES, "link": 8.0}),
    "mujoco": (MUJOCO, 3, {**EVENTFUL, **CHANGES, "duration": 0.15, "link": 8.0}),
}

#: Mode of a batch by its number of lanes; `test_fuzz.py` has others.
NUMBERS = dict(zip((1, 2, 8, 9, 17, 33), MODES * 2, strict=True))


def assert_same_infos(a, b):
    """Check that the infos of two vector environments are equal; a key that one of them lacks is zero in the other."""
    for key in a.keys() | b.keys():
        x, y = a.get(key, 0.0), b.get(key, 0.0)
        if key == "final_info" and key in a and key in b:
            assert_same_infos(x, y)
        elif key == "final_obs":
            for one, other in zip(x, y, strict=True):
                assert (one is None) == (other is None)
                np.testing.assert_array_equal(one, other)
        else:
            np.testing.assert_allclose(x, y, rtol=1e-12)
            assert key not in a or key not in b or x.dtype == y.dtype


def compare(ours, theirs, actions, calls, seed=3):
    """Check that two vector environments are equal to the bit over random calls; return the ends and the keys of resets.

    The calls are steps with some actions; and resets of all or some lanes, with a seed, a list with None, or without.
    """
    lanes, mode = ours.num_envs, ours.metadata["autoreset_mode"]
    rng, ends, keys = np.random.default_rng(lanes), 0, set()
    ended = np.zeros(lanes, dtype=bool)
    np.testing.assert_array_equal(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0])
    for _ in range(calls):
        if rng.random() < 0.85:
            if mode == AutoresetMode.DISABLED and ended.any():
                continue
            given = next(actions)
            a, b = ours.step(given), theirs.step(given)
            for x, y in zip(a[:4], b[:4], strict=True):
                np.testing.assert_array_equal(x, y)
                assert x.dtype == y.dtype
            assert_same_infos(a[4], b[4])
            ended = a[2] | a[3]
            ends += ended.sum()
            continue
        several = [None if rng.random() < 0.5 else int(rng.integers(1000)) for _ in range(lanes)]
        arguments = {"seed": (None, int(rng.integers(1000)), several)[rng.integers(3)]}
        mask = rng.random(lanes) < 0.4
        if rng.random() < 0.7 and mask.any() and not (mode == AutoresetMode.DISABLED and (ended & ~mask).any()):
            a, b = (env.reset(**arguments, options={"reset_mask": mask.copy()}) for env in (ours, theirs))
            ended &= ~mask
        else:
            a, b = ours.reset(**arguments), theirs.reset(**arguments)
            ended[:] = False
        np.testing.assert_array_equal(a[0], b[0])
        assert_same_infos(a[1], b[1])
        keys |= set(a[1])
    return ends, keys


@pytest.mark.parametrize(("case", "mode"), [*NUMBERS.items(), *((case, mode) for case in CASES for mode in MODES)])
def test_any_order_of_steps_and_resets_gives_what_single_environments_give(case, mode):
    name, lanes, options = CASES.get(case, (ID, case, EVENTFUL))
    if case == "mujoco":
        pytest.importorskip("mujoco")
    ours = gym.make_vec(name, lanes, vectorization_mode="vector_entry_point", autoreset_mode=mode, **options)
    theirs = SyncVectorEnv([lambda: gym.make(name, **options)] * lanes, autoreset_mode=mode)
    actions = iter(np.random.default_rng(0).uniform(-1, 1, (200, lanes, 2)))
    ends, keys = compare(ours, theirs, actions, 200)
    assert ends >= 3
    assert keys == ({"context", "_context"} if case == "context" else set())
    truths = [vars(env.unwrapped.truth) for env in theirs.envs]
    for field, values in vars(ours.unwrapped.truth).items():
        np.testing.assert_array_equal(values, [truth[field] for truth in truths], err_msg=field)


def test_a_hundred_thousand_lanes_step():
    env = started_batch(100_000, "everything-3")
    observations, rewards, *_ = env.step(np.zeros((100_000, 2)))
    assert np.isfinite(observations).all()
    single = started("everything-3", seed=99999)
    np.testing.assert_array_equal(observations[-1], single.step(np.zeros(2))[0])
    assert env._batch._memory.nbytes + observations.nbytes < 2**28
    assert rewards.shape == (100_000,)
