"""The batch: each lane bit for bit the single environment, in every autoreset mode."""

import copy
import multiprocessing
import os
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.kernel import doors

OPTIONS = {
    "scenario": "everything-3",
    "duration": 0.3,
    "limits": {"velocity": 9.0},
    "actuator": {"delay": 0.013, "lag": 0.01},
    "preview": 1,
}
MODES = [mode.value for mode in AutoresetMode]


def pair(lanes, mode):
    ours = gym.make_vec(
        "fbl_gym/TwoLinkArm-v0", lanes, vectorization_mode="vector_entry_point", autoreset_mode=mode, **OPTIONS
    )
    theirs = SyncVectorEnv([lambda: gym.make("fbl_gym/TwoLinkArm-v0", **OPTIONS)] * lanes, autoreset_mode=mode)
    return ours, theirs


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("lanes", [1, 2, 8, 9, 16, 17, 37])
def test_lanes_are_single_environments(lanes, mode):
    """Against Gymnasium's own vector environment over single ones: observations, rewards, flags and infos, to the bit."""
    ours, theirs = pair(lanes, mode)
    np.testing.assert_array_equal(ours.reset(seed=3)[0], theirs.reset(seed=3)[0])
    rng, ends = np.random.default_rng(0), 0
    for _ in range(100):
        actions = rng.uniform(-1, 1, (lanes, 2))
        a, b = ours.step(actions), theirs.step(actions)
        for x, y in zip(a[:4], b[:4], strict=True):
            np.testing.assert_array_equal(x, y)
        assert a[4].keys() == b[4].keys()
        done = a[2] | a[3]
        ends += done.sum()
        if "final_obs" in a[4]:
            np.testing.assert_array_equal(a[4]["_final_obs"], b[4]["_final_obs"])
            for lane in np.flatnonzero(done):
                np.testing.assert_array_equal(a[4]["final_obs"][lane], b[4]["final_obs"][lane])
        if mode == "Disabled" and done.any():
            mask = {"reset_mask": done}
            np.testing.assert_array_equal(ours.reset(options=dict(mask))[0], theirs.reset(options=dict(mask))[0])
    assert ends >= 3 * lanes


@pytest.mark.parametrize("mode", MODES)
def test_a_reset_mask_touches_only_its_lanes(mode):
    ours, theirs = pair(5, mode)
    ours.reset(seed=0)
    theirs.reset(seed=0)
    for k in range(10):
        ours.step(np.full((5, 2), 0.001 * k))
        theirs.step(np.full((5, 2), 0.001 * k))
    mask = np.array([False, True, False, True, False])
    seeds = [None, 7, None, None, None]
    a, _ = ours.reset(seed=seeds, options={"reset_mask": mask.copy()})
    b, _ = theirs.reset(seed=seeds, options={"reset_mask": mask.copy()})
    np.testing.assert_array_equal(a, b)
    for _ in range(15):
        np.testing.assert_array_equal(ours.step(np.zeros((5, 2)))[0], theirs.step(np.zeros((5, 2)))[0])


def test_seeds_by_list_and_by_number():
    env = TwoLinkArmVectorEnv(3)
    by_number, _ = env.reset(seed=4)
    by_list, _ = env.reset(seed=[4, 5, 6])
    np.testing.assert_array_equal(by_number, by_list)
    kept, _ = env.reset(seed=[None, 5, None])
    np.testing.assert_array_equal(kept[1], by_list[1])
    assert not np.array_equal(kept[0], by_list[0])
    single = TwoLinkArmEnv()
    single.reset(seed=4)
    np.testing.assert_array_equal(kept[0], single.reset()[0])


def test_the_mode_is_named_and_is_next_step_by_default():
    assert TwoLinkArmVectorEnv(2).metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert TwoLinkArmVectorEnv(2, autoreset_mode="SameStep").metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


def test_max_episode_steps():
    env = gym.make_vec("fbl_gym/TwoLinkArm-v0", 2, vectorization_mode="vector_entry_point", max_episode_steps=5)
    env.reset(seed=0)
    assert [bool(env.step(np.zeros((2, 2)))[3].all()) for _ in range(5)] == [False] * 4 + [True]


def test_one_bad_action_moves_no_lane():
    env, twin = TwoLinkArmVectorEnv(20), TwoLinkArmVectorEnv(20)
    env.reset(seed=0)
    twin.reset(seed=0)
    actions = np.zeros((20, 2))
    actions[13, 1] = np.nan
    with pytest.raises(ValueError, match=r"actions must be finite, got \[ ?0. nan\] in lane 13"):
        env.step(actions)
    with pytest.raises(ValueError, match=r"shape \(20, 2\), got shape \(2, 20\)"):
        env.step(actions.T)
    np.testing.assert_array_equal(env.step(np.zeros((20, 2)))[0], twin.step(np.zeros((20, 2)))[0])


def test_a_finished_lane_must_be_reset_where_nothing_resets_it():
    env = TwoLinkArmVectorEnv(2, autoreset_mode="Disabled", duration=0.02)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros((2, 2)))
    env.reset(seed=0)
    env.step(np.zeros((2, 2)))
    env.step(np.zeros((2, 2)))
    with pytest.raises(ResetNeeded, match="lane 0 has ended"):
        env.step(np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs must be a whole number not below 1, got 0"),
        ({"num_envs": 2.5}, "num_envs must be"),
        ({"num_envs": 2, "autoreset_mode": "Nextstep"}, "did you mean 'NextStep'"),
        ({"num_envs": 2, "max_episode_steps": 0}, "max_episode_steps must be"),
        ({"num_envs": 2, "nois": 3}, "did you mean 'noise'"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        TwoLinkArmVectorEnv(**arguments)


@pytest.mark.parametrize("mask", [[True, False], np.array([1, 0]), np.array([True]), np.array([False, False])])
def test_bad_masks_are_named(mask):
    env = TwoLinkArmVectorEnv(2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="reset_mask must"):
        env.reset(options={"reset_mask": mask})


def test_bad_seeds_are_named():
    env = TwoLinkArmVectorEnv(2)
    for seed in ([1, 2, 3], -1, [0, -1], 2**64 - 1):
        with pytest.raises(ValueError, match="seed must be"):
            env.reset(seed=seed)


def test_a_pickled_batch_goes_on_alike():
    env = TwoLinkArmVectorEnv(20, **OPTIONS)
    env.reset(seed=0)
    for _ in range(25):
        env.step(np.full((20, 2), 0.1))
    other = pickle.loads(pickle.dumps(env))
    for _ in range(25):
        np.testing.assert_array_equal(env.step(np.full((20, 2), 0.1))[0], other.step(np.full((20, 2), 0.1))[0])


def test_a_hundred_thousand_lanes():
    env = TwoLinkArmVectorEnv(100_000, "everything-1")
    env.reset(seed=0)
    observations, rewards, *_ = env.step(np.zeros((100_000, 2)))
    assert np.isfinite(observations).all()
    single = TwoLinkArmEnv("everything-1")
    single.reset(seed=99_999)
    np.testing.assert_array_equal(observations[-1], single.step(np.zeros(2))[0])
    assert env._batch._state.nbytes < 2**28
    assert rewards.shape == (100_000,)


# More of the above: any order of steps and resets, what is returned, copies.


def assert_same_infos(a, b, lanes):
    """Infos of two vector environments: keys, masks, and the final observation of each lane that ended."""
    assert a.keys() == b.keys()
    for key in a:
        if key == "final_obs":
            assert a[key].shape == (lanes,)
            assert a[key].dtype == b[key].dtype == object
            for x, y in zip(a[key], b[key], strict=True):
                assert (x is None) == (y is None)
                if x is not None:
                    np.testing.assert_array_equal(x, y)
        elif key == "final_info":
            assert a[key] == b[key]
        else:
            np.testing.assert_array_equal(a[key], b[key])
            assert a[key].dtype == b[key].dtype


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("seed", range(4))
def test_any_order_of_steps_and_resets(mode, seed):
    """200 random calls (steps; resets of all or some lanes, with a seed, a list with None, or without) on both."""
    rng, lanes = np.random.default_rng(seed), (3, 16, 17, 5)[seed]
    ours, theirs = pair(lanes, mode)
    ended = np.zeros(lanes, dtype=bool)
    np.testing.assert_array_equal(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0])
    for _ in range(200):
        if rng.random() < 0.85:
            if mode == "Disabled" and ended.any():
                continue
            actions = rng.uniform(-1, 1, (lanes, 2))
            a, b = ours.step(actions), theirs.step(actions)
            for x, y in zip(a[:4], b[:4], strict=True):
                np.testing.assert_array_equal(x, y)
                assert x.dtype == y.dtype
            assert_same_infos(a[4], b[4], lanes)
            ended = a[2] | a[3]
            continue
        several = [None if rng.random() < 0.5 else int(rng.integers(1000)) for _ in range(lanes)]
        arguments = {"seed": (None, int(rng.integers(1000)), several)[rng.integers(3)]}
        mask = rng.random(lanes) < 0.4
        if rng.random() < 0.7 and mask.any() and not (mode == "Disabled" and (ended & ~mask).any()):
            a = ours.reset(**arguments, options={"reset_mask": mask.copy()})
            b = theirs.reset(**arguments, options={"reset_mask": mask.copy()})
            ended &= ~mask
        else:
            a, b = ours.reset(**arguments), theirs.reset(**arguments)
            ended[:] = False
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1] == b[1] == {}


@pytest.mark.parametrize("mode", MODES)
def test_lanes_that_are_not_masked_do_not_notice(mode):
    """Their observations, rewards, flags and truth are those of a batch in which nothing was reset."""
    env, twin = pair(20, mode)[0], pair(20, mode)[0]
    env.reset(seed=0)
    twin.reset(seed=0)
    mask = np.arange(20) % 3 == 0
    for k in range(12):
        actions = np.full((20, 2), 0.01 * k)
        a, b = env.step(actions), twin.step(actions)
        for x, y in zip(a[:4], b[:4], strict=True):
            np.testing.assert_array_equal(x[~mask], y[~mask])
        if k % 4 == 3:
            shown, _ = env.reset(options={"reset_mask": mask})
            np.testing.assert_array_equal(shown[~mask], b[0][~mask])
            for name, value in vars(env.truth).items():
                np.testing.assert_array_equal(value[~mask], getattr(twin.truth, name)[~mask], err_msg=name)
    assert not np.array_equal(a[0][mask], b[0][mask])


def test_a_lane_that_waits_for_its_reset_goes_on_waiting_when_others_are_reset():
    """NEXT_STEP: an ended lane outside the mask restarts at the next step; one inside the mask does not do so twice."""
    env = TwoLinkArmVectorEnv(2, duration=0.02)
    env.reset(seed=0)
    env.step(np.zeros((2, 2)))
    assert env.step(np.zeros((2, 2)))[3].all()
    env.reset(options={"reset_mask": np.array([True, False])})
    _, rewards, _, truncated, _ = env.step(np.zeros((2, 2)))
    assert rewards[0] > 0.0
    assert rewards[1] == 0.0
    assert not truncated.any()
    np.testing.assert_allclose(env.truth.time, [0.01, 0.0])


@pytest.mark.parametrize("lanes", [1, 16, 33])
def test_truth_of_a_lane_is_that_of_the_single_environment(lanes):
    options = {**OPTIONS, "limits": {"position": 100.0, "velocity": 1e4}}
    env = TwoLinkArmVectorEnv(lanes, **options)
    env.reset(seed=5)
    singles = [TwoLinkArmEnv(**options) for _ in range(lanes)]
    for lane, single in enumerate(singles):
        single.reset(seed=5 + lane)
    for k in range(8):
        action = np.array([0.02 * k, -0.01])
        env.step(np.tile(action, (lanes, 1)))
        for single in singles:
            single.step(action)
    for lane, single in enumerate(singles):
        for name, value in vars(single.truth).items():
            # Leakage is computed by NumPy, whose last bit may depend on the array's length; all else is the kernel's.
            rtol = 1e-12 if name == "leakage" else 0.0
            np.testing.assert_allclose(getattr(env.truth, name)[lane], value, rtol=rtol, atol=0.0, err_msg=name)


@pytest.mark.parametrize("mode", MODES)
def test_what_is_returned_is_never_written_to_again(mode):
    env = TwoLinkArmVectorEnv(3, autoreset_mode=mode, duration=0.05)
    kept = [(env.reset(seed=0)[0], np.zeros(3), np.zeros(3), np.zeros(3))]
    copies = [[x.copy() for x in kept[0]]]
    finals, before = [], []
    for _ in range(20):
        *arrays, infos = env.step(np.full((3, 2), 0.1))
        kept.append(arrays)
        copies.append([x.copy() for x in arrays])
        finals += [x for x in infos.get("final_obs", ()) if x is not None]
        before += [x.copy() for x in infos.get("final_obs", ()) if x is not None]
        if mode == "Disabled" and arrays[3].any():
            env.reset()
    truth = env.truth
    position = truth.position.copy()
    env.reset(seed=9)
    env.step(np.full((3, 2), 0.3))
    for arrays, old in zip(kept, copies, strict=True):
        for x, y in zip(arrays, old, strict=True):
            np.testing.assert_array_equal(x, y)
    for x, y in zip(finals, before, strict=True):
        np.testing.assert_array_equal(x, y)
    np.testing.assert_array_equal(truth.position, position)
    assert len(finals) == (12 if mode == "SameStep" else 0)


def test_observations_of_successive_steps_are_different_arrays():
    env = TwoLinkArmVectorEnv(3)
    first = env.reset(seed=0)[0]
    before = first.copy()
    second, rewards, *_ = env.step(np.full((3, 2), 0.1))
    third, others, *_ = env.step(np.full((3, 2), 0.1))
    assert not np.shares_memory(first, second)
    assert not np.shares_memory(second, third)
    assert not np.shares_memory(rewards, others)
    np.testing.assert_array_equal(first, before)


@pytest.mark.parametrize("duplicate", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy])
def test_a_copied_batch_knows_its_own_truth_and_heeds_its_seeds(duplicate):
    env = TwoLinkArmVectorEnv(20, **OPTIONS)
    env.reset(seed=0)
    other = duplicate(env)
    for _ in range(3):
        env.step(np.full((20, 2), 0.1))
        other.step(np.full((20, 2), 0.1))
    np.testing.assert_array_equal(other.truth.position, env.truth.position)
    np.testing.assert_array_equal(other.reset(seed=40)[0], env.reset(seed=40)[0])
    np.testing.assert_array_equal(other.reset()[0], env.reset()[0])


def test_copies_go_their_own_ways():
    env = TwoLinkArmVectorEnv(3)
    env.reset(seed=0)
    other = copy.deepcopy(env)
    other.step(np.ones((3, 2)))
    twin = TwoLinkArmVectorEnv(3)
    twin.reset(seed=0)
    np.testing.assert_array_equal(env.step(np.zeros((3, 2)))[0], twin.step(np.zeros((3, 2)))[0])


def test_make_vec_takes_the_same_options_as_make():
    options = {"scenario": "noise-1", "action": "acceleration", "preview": 2, "reward": {"tracking": "l1"}}
    envs = gym.make_vec("fbl_gym/TwoLinkArm-v0", 3, vectorization_mode="vector_entry_point", **options)
    assert isinstance(envs.unwrapped, TwoLinkArmVectorEnv)
    single = gym.make("fbl_gym/TwoLinkArm-v0", **options)
    assert envs.unwrapped.interface == single.unwrapped.interface
    assert envs.single_observation_space == single.observation_space
    assert envs.single_action_space == single.action_space
    assert envs.observation_space.shape == (3, single.observation_space.shape[0])
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    actions = np.array([[1.0, 2.0]] * 3)
    np.testing.assert_array_equal(envs.reset(seed=6)[0][0], single.reset(seed=6)[0])
    a, b = envs.step(actions), single.step(actions[0])
    np.testing.assert_array_equal(a[0][0], b[0])
    assert a[1][0] == b[1]


def test_both_names_make_a_batch():
    envs = gym.make_vec("fbl_gym:fbl_gym/TwoLinkArm-v0", 2, vectorization_mode="vector_entry_point")
    assert envs.num_envs == 2


@pytest.mark.parametrize("mode", [*AutoresetMode, *MODES, "NEXT_STEP", "SAME_STEP", "DISABLED"])
def test_every_way_to_name_a_mode(mode):
    envs = gym.make_vec("fbl_gym/TwoLinkArm-v0", 2, vectorization_mode="vector_entry_point", autoreset_mode=mode)
    found = envs.metadata["autoreset_mode"]
    assert isinstance(found, AutoresetMode)
    assert mode in (found, found.value, found.name)
    assert "autoreset_mode" not in TwoLinkArmEnv.metadata


@pytest.mark.parametrize("mode", MODES)
def test_max_episode_steps_ends_each_episode(mode):
    """If it is sooner than the duration; else the duration does."""
    for most, expected in ((5, 5), (50, 10)):
        env = TwoLinkArmVectorEnv(2, autoreset_mode=mode, max_episode_steps=most, duration=0.1)
        env.reset(seed=0)
        flags = [env.step(np.zeros((2, 2)))[3] for _ in range(expected)]
        assert np.array(flags).all(axis=1).tolist() == [False] * (expected - 1) + [True]


def test_the_first_bad_lane_is_named_and_the_batch_goes_on():
    env, twin = TwoLinkArmVectorEnv(37, **OPTIONS), TwoLinkArmVectorEnv(37, **OPTIONS)
    env.reset(seed=0)
    twin.reset(seed=0)
    for k in range(45):
        actions = np.random.default_rng(k).uniform(-1, 1, (37, 2))
        for lane, value in ((36, np.nan), (20, np.inf), (k % 37, -np.inf)):
            bad = actions.copy()
            bad[lane, k % 2] = value
            bad[36, 0] = np.nan
            with pytest.raises(ValueError, match=f"finite, got .*in lane {lane}$"):
                env.step(bad)
        a, b = env.step(actions), twin.step(actions)
        for x, y in zip(a[:4], b[:4], strict=True):
            np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("seed", [2.5, np.float64(2.0), "ab", True, -1, [1, 2.5], [1, "2"], {}, [1]])
def test_a_bad_seed_is_named_and_nothing_is_lost(seed):
    env, twin = TwoLinkArmVectorEnv(2), TwoLinkArmVectorEnv(2)
    env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(ValueError, match="seed must be"):
        env.reset(seed=seed)
    np.testing.assert_array_equal(env.step(np.zeros((2, 2)))[0], twin.step(np.zeros((2, 2)))[0])
    np.testing.assert_array_equal(env.reset()[0], twin.reset()[0])


def test_a_bad_mask_or_option_loses_nothing():
    env, twin = TwoLinkArmVectorEnv(2), TwoLinkArmVectorEnv(2)
    env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(ValueError, match=r"reset_mask must be a boolean array of shape \(2,\)"):
        env.reset(seed=5, options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(ValueError, match="unknown reset option 'reset_masc'; did you mean 'reset_mask'"):
        env.reset(options={"reset_masc": np.array([True, False])})
    np.testing.assert_array_equal(env.reset()[0], twin.reset()[0])


@pytest.mark.parametrize("num_envs", [0, -1, 2.5, True, "2", None])
def test_a_bad_number_of_lanes_is_named(num_envs):
    with pytest.raises(ValueError, match="num_envs must be a whole number not below 1, got"):
        TwoLinkArmVectorEnv(num_envs)


def test_seeds_may_be_numpy_numbers():
    env = TwoLinkArmVectorEnv(2)
    first, _ = env.reset(seed=np.int64(3))
    np.testing.assert_array_equal(first, env.reset(seed=np.array([3, 4]))[0])
    np.testing.assert_array_equal(first, env.reset(seed=(3, 4))[0])


def test_lanes_without_a_seed_differ():
    env = TwoLinkArmVectorEnv(16)
    assert len(np.unique(env.reset()[0][:, 0])) == 16


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_threads_change_nothing(mode):
    """Not one bit, through several episodes; more threads than blocks are no error."""
    envs = [
        TwoLinkArmVectorEnv(75, "everything-3", autoreset_mode=mode, duration=0.2, threads=threads)
        for threads in (1, 2, 3, 64)
    ]
    rng = np.random.default_rng(0)
    first, *others = [env.reset(seed=5)[0] for env in envs]
    for other in others:
        assert np.array_equal(first, other)
    for _ in range(45):
        actions = rng.uniform(-1, 1, (75, 2))
        one, *many = [env.step(actions) for env in envs]
        for other in many:
            assert all(np.array_equal(a, b) for a, b in zip(one[:4], other[:4], strict=True))
            assert ("final_obs" in one[4]) == ("final_obs" in other[4])


def test_no_lane_moves_where_one_of_several_threads_would_refuse():
    env = TwoLinkArmVectorEnv(64, autoreset_mode="Disabled", duration=0.05, threads=4)
    env.reset(seed=0)
    before = env.truth.position
    actions = np.zeros((64, 2))
    actions[63, 1] = np.nan
    with pytest.raises(ValueError, match="in lane 63"):
        env.step(actions)
    assert np.array_equal(env.truth.position, before)
    for _ in range(5):
        env.step(np.zeros((64, 2)))
    env.reset(options={"reset_mask": np.arange(64) != 40})
    before = env.truth.position
    with pytest.raises(ResetNeeded, match="lane 40"):
        env.step(np.zeros((64, 2)))
    assert np.array_equal(env.truth.position, before)


@pytest.mark.parametrize("threads", [0, -1, 1.5, "two"])
def test_a_number_of_threads_is_whole_and_positive(threads):
    with pytest.raises(ValueError, match="threads must be"):
        TwoLinkArmVectorEnv(4, threads=threads)


def test_a_hundred_thousand_arms_take_little_memory():
    """Their state, and what a step returns, within 256 MiB."""
    env = TwoLinkArmVectorEnv(100_000, "everything-3")
    observations, _ = env.reset(seed=0)
    assert np.isfinite(observations).all()
    assert env._batch._state.nbytes + observations.nbytes < 2**28
    alone = TwoLinkArmEnv("everything-3")
    assert np.array_equal(observations[99_999], alone.reset(seed=99_999)[0])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_has_threads_of_its_own():
    env = TwoLinkArmVectorEnv(64, threads=2)
    env.reset(seed=0)
    env.step(np.zeros((64, 2)))
    with multiprocessing.get_context("fork").Pool(1) as pool:
        found = pool.apply_async(_positions_of_a_step).get(60)
    env.reset(seed=0)
    env.step(np.zeros((64, 2)))
    assert np.array_equal(found, env.truth.position)


def _positions_of_a_step():
    env = TwoLinkArmVectorEnv(64, threads=2)
    env.reset(seed=0)
    env.step(np.zeros((64, 2)))
    return env.truth.position


@pytest.mark.parametrize("lanes", [1, 16, 17])
def test_what_a_step_returns_is_the_callers(lanes):
    """The next step writes elsewhere."""
    env = TwoLinkArmVectorEnv(lanes)
    env.reset(seed=0)
    kept = env.step(np.full((lanes, 2), 0.5))[:4]
    copies = [part.copy() for part in kept]
    for _ in range(3):
        env.step(np.full((lanes, 2), -1.0))
    assert all(np.array_equal(a, b) for a, b in zip(kept, copies, strict=True))
    assert not any(np.shares_memory(part, env._batch._state) for part in kept)


def test_actions_of_any_layout_are_taken_without_another_compilation():
    """Read-only, with gaps, backwards, in Fortran's order, of other types: all move the arms alike."""
    spread = np.zeros((8, 4))
    spread[:, ::2] = 0.25
    actions = np.full((8, 2), 0.25)
    frozen = actions.copy()
    frozen.flags.writeable = False
    found = []
    for given in (
        actions,
        frozen,
        spread[:, ::2],
        actions[::-1],
        np.asfortranarray(actions),
        actions.astype("f4"),
        actions.tolist(),
    ):
        env = TwoLinkArmVectorEnv(8)
        env.reset(seed=0)
        found.append(env.step(given)[0])
    env.reset(options={"reset_mask": np.ones(16, dtype=bool)[::2]})
    assert all(np.array_equal(found[0], other) for other in found)
    assert len(doors.step.signatures) == len(doors.reset.signatures) == 1
