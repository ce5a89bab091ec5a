"""The batch: each lane bit for bit the single environment, Gymnasium's rules, and errors that change no episode."""

import functools
import itertools

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.kernel.step import api
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


# Gymnasium's rules, and errors.


@pytest.mark.parametrize("scenario", ["everything-3", "servo-elastic-2"])
def test_true_signals_are_those_of_the_truth(scenario):
    env = started_batch(17, scenario)
    env.step(np.full((17, 2), 0.1))
    signals, truth = env.true_signals(), vars(env.truth)
    truth["command"] = truth["commands"][:, 0]
    assert set(signals) == {"position", "velocity", "reference", "command", "applied_torque", "disturbance", "payload"}
    for name, values in signals.items():
        np.testing.assert_array_equal(values, truth[name])


@pytest.mark.parametrize("mode", MODES)
def test_returned_arrays_are_never_changed_later(mode):
    env = TwoLinkArmVectorEnv(3, autoreset_mode=mode, duration=0.05)
    returned, finals = [env.reset(seed=0)[0]], []
    for _ in range(20):
        *arrays, infos = env.step(np.full((3, 2), 0.1))
        returned += arrays
        finals += [observation for observation in infos.get("final_obs", ()) if observation is not None]
        if mode == "Disabled" and arrays[3].any():
            env.reset()
    assert len(finals) == (12 if mode == "SameStep" else 0)
    returned += [*finals, env.truth.position]
    copies = [array.copy() for array in returned]
    env.reset(seed=9)
    env.step(np.full((3, 2), 0.3))
    for array, copied in zip(returned, copies, strict=True):
        np.testing.assert_array_equal(array, copied)
    assert not any(np.shares_memory(a, b) for a, b in itertools.combinations(returned, 2))


def test_make_vec_takes_the_same_options_as_make():
    options = {"scenario": "noise-1", "action": "acceleration", "preview": 2, "reward": {"tracking": "l1"}}
    envs = gym.make_vec(ID, 3, vectorization_mode="vector_entry_point", **options)
    assert isinstance(envs.unwrapped, TwoLinkArmVectorEnv)
    single = gym.make(ID, **options)
    for name in ("interface", "single_observation_space", "single_action_space"):
        assert getattr(envs.unwrapped, name) == getattr(single.unwrapped, name.removeprefix("single_"))
    assert envs.observation_space.shape == (3, *single.observation_space.shape)
    np.testing.assert_array_equal(envs.reset(seed=6)[0][0], single.reset(seed=6)[0])


@pytest.mark.parametrize("mode", [*AutoresetMode, *MODES, None])
def test_a_mode_is_given_as_gymnasium_takes_it(mode):
    given = {"autoreset_mode": mode} if mode else {}
    envs = gym.make_vec(ID, 2, vectorization_mode="vector_entry_point", **given)
    assert envs.metadata["autoreset_mode"] is AutoresetMode(mode or "NextStep")
    assert "autoreset_mode" not in TwoLinkArmEnv.metadata


@pytest.mark.parametrize("mode", MODES)
def test_an_episode_ends_at_the_smaller_of_max_episode_steps_and_duration(mode):
    for most, expected in ((5, 5), (50, 10)):
        env = started_batch(2, autoreset_mode=mode, max_episode_steps=most, duration=0.1)
        flags = [env.step(np.zeros((2, 2)))[3] for _ in range(expected)]
        assert np.array(flags).all(axis=1).tolist() == [False] * (expected - 1) + [True]


SINE = ["nominal", {"base": "noise-1", "reference": "sine"}]
SCENARIOS = ("servo-practice-nominal", "servo-practice-delay-3", "servo-practice-everything-1")


def flat(infos):
    """The arrays of infos by their keys, those of `final_info` too."""
    final = {f"final {key}": value for key, value in infos.get("final_info", {}).items()}
    return {key: value for key, value in infos.items() if key != "final_info"} | final


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("name", [ID, TRACKING])
def test_several_scenarios_have_the_bits_that_each_has_alone(name, mode):
    """Their spaces, steps, infos and resets of some lanes; all observe as many previous actions as the longest delay."""
    options = {"duration": 0.1, "autoreset_mode": mode, "context": True, "constraints": {"velocity": 1.0}}
    options |= {"limits": {"velocity": 3.0}, "render_mode": "rgb_array"} | ({"history": 1} if name == TRACKING else {})
    make = functools.partial(gym.make_vec, name, vectorization_mode="vector_entry_point", **options)
    together, parts, ends = make(8, scenario=[*SCENARIOS]), (slice(3), slice(3, 6), slice(6, 8)), 0
    past = max(env.interface.layout["previous_actions"].stop for env in together.envs) - 10
    alone = [make(n, scenario=each, past_actions=past // 2) for n, each in zip((3, 3, 2), SCENARIOS, strict=True)]
    assert together.render_mode == "rgb_array"
    assert together.observation_space == gym.vector.utils.batch_space(alone[1].single_observation_space, 8)
    lanes = [*zip(alone, parts, strict=True)]
    for seed in (3, [*range(7), None]):
        pairs = [(together.reset(seed=seed), [env.reset(seed=seed if seed == 3 else seed[p]) for env, p in lanes])]
        for actions in np.random.default_rng(0).uniform(-1, 1, (25, 8, 2)):
            pairs.append((together.step(actions), [env.step(actions[p]) for env, p in lanes]))
        for ours, theirs in pairs:
            for signal, each in zip(ours[:-1], zip(*theirs, strict=True), strict=False):
                np.testing.assert_array_equal(signal, np.concatenate(each))
            for part, (*_, infos) in zip(parts, theirs, strict=True):
                for key, values in flat(infos).items():
                    np.testing.assert_equal([*flat(ours[-1])[key][part]], [*values])
            ends += 0 if len(ours) == 2 else (ours[2] | ours[3]).sum()
    assert ends > 16
    mask = np.arange(8) < 5
    again, _ = together.reset(options={"reset_mask": mask})
    theirs = [alone[i].reset(options={"reset_mask": mask[parts[i]]})[0] for i in (0, 1)]
    np.testing.assert_array_equal(again, np.concatenate([*theirs, ours[0][6:]]))


def test_scenarios_that_do_not_fit_together_are_refused():
    shapes = r"scenarios must have the same observation_space.*shapes \(12,\) and \(8,\)"
    for arguments, message in (
        ((8, ["nominal", {"sensors": ("position",)}]), shapes),
        ((1, ["nominal", "noise-1"]), "num_envs must be .* not below 2"),
        ((1, []), "scenario must be a list of one or more"),
    ):
        with pytest.raises(ValueError, match=message):
            TwoLinkArmVectorEnv(*arguments)
    options = {"duration": 0.03, "autoreset_mode": "Disabled"}
    env, twin = (TwoLinkArmVectorEnv(2, SINE, **options) for _ in range(2))
    first, _ = env.reset(seed=0)
    seen = first.copy()
    first *= 0.0  # which changes nothing later
    both, last = np.ones(2, dtype=bool), np.array([False, True])
    np.testing.assert_array_equal(env.reset(seed=0, options={"reset_mask": last})[0][0], seen[0])
    twin.reset(seed=0)
    for call, message in (
        (lambda: env.step([[0.0, 0.0], [np.nan, 0.0]]), "actions must be finite, got"),
        (lambda: env.reset(seed=[1, 2, 3]), "seed must have one entry for each of 2 lanes, got 3"),
        (lambda: env.reset(seed=[1, -1]), "seed must be a whole number not below 0, got -1"),
        (lambda: env.reset(options={"reset_mask": ~both}), "reset_mask must have at least one True"),
        (lambda: env.reset(options={"reference": (-1.0, 0.5)}), "reference must be left out: .* reference is sine"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
    for _ in range(3):
        np.testing.assert_array_equal(env.step(np.zeros((2, 2)))[0], twin.step(np.zeros((2, 2)))[0])
    env.reset(options={"reset_mask": ~last})
    with pytest.raises(ResetNeeded, match="lane 1 has ended"):
        env.step(np.zeros((2, 2)))
    same = env.reset(options={"position": (-1.0, 0.5), "reset_mask": None})[0]
    np.testing.assert_array_equal(same[0, :2], [-1.0, 0.5])


def test_actions_of_any_memory_layout_and_type_move_the_arms_alike():
    """None of them needs another compilation."""
    actions, spread = np.full((8, 2), 0.25), np.full((8, 4), 0.25)
    frozen = actions.copy()
    frozen.flags.writeable = False
    layouts = frozen, spread[:, ::2], actions[::-1], np.asfortranarray(actions), actions.astype("f4"), actions.tolist()
    expected = started_batch(8).step(actions)[0]
    for given in layouts:
        env = started_batch(8)
        np.testing.assert_array_equal(env.step(given)[0], expected)
    env.reset(options={"reset_mask": np.ones(16, dtype=bool)[::2]})
    assert len(api.STEPS[0].signatures) == 1


@pytest.mark.parametrize(("arguments", "message"), [
    *[({"num_envs": n}, "num_envs must be .* not below 1 and .*, got") for n in (0, -1, 2.5, True, "2", None)],
    ({"num_envs": 2, "autoreset_mode": "Nextstep"}, "unknown autoreset_mode 'Nextstep'; did you mean 'NextStep'"),
    ({"num_envs": 2, "max_episode_steps": 0}, "max_episode_steps must be"),
])  # fmt: skip
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        TwoLinkArmVectorEnv(**arguments)
    with pytest.raises(TypeError, match="unexpected keyword argument 'nois'; did you mean 'noise'"):
        TwoLinkArmVectorEnv(2, nois=3)


def test_the_first_bad_lane_is_named_and_the_episode_continues():
    env, twin = started_batch(37, **EVENTFUL), started_batch(37, **EVENTFUL)
    for k in range(45):
        actions = np.random.default_rng(k).uniform(-1, 1, (37, 2))
        for lane, value in ((36, np.nan), (20, np.inf), (k % 37, -np.inf)):
            bad = actions.copy()
            bad[lane, k % 2] = value
            bad[36, 0] = np.nan
            with pytest.raises(ValueError, match=f"finite, got .*in lane {lane}$"):
                env.step(bad)
        with pytest.raises(ValueError, match=r"shape \(37, 2\), got shape \(2, 37\)"):
            env.step(actions.T)
        np.testing.assert_equal(env.step(actions), twin.step(actions))


SEEDS = [2.5, np.float64(2.0), np.array(5), "5", True, -1, 2**64 - 1, {}, [1], [0, -1], [1, 2.5], [1, "2"]]
MASKS = [[True, False], np.array([1, 0]), np.array([True]), np.zeros(2, bool), np.ones(3, bool)]


@pytest.mark.parametrize(("arguments", "message"), [
    *[({"seed": seed}, "seed must be") for seed in SEEDS],
    *[({"seed": 5, "options": {"reset_mask": mask}}, "reset_mask must") for mask in MASKS],
    ({"options": {"reset_masc": np.ones(2, bool)}}, "unknown reset option 'reset_masc'; did you mean 'reset_mask'"),
], ids=str)  # fmt: skip
def test_a_bad_reset_is_named_and_changes_no_episode(arguments, message):
    env, twin = started_batch(2), started_batch(2)
    with pytest.raises(ValueError, match=message):
        env.reset(**arguments)
    np.testing.assert_array_equal(env.step(np.zeros((2, 2)))[0], twin.step(np.zeros((2, 2)))[0])
    np.testing.assert_array_equal(env.reset()[0], twin.reset()[0])


@pytest.mark.parametrize("scenario", [None, ["nominal", "noise-1"]])
@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_the_first_reset_is_of_every_lane(mode, scenario):
    env, twin = (TwoLinkArmVectorEnv(2, scenario, autoreset_mode=mode) for _ in range(2))
    with pytest.raises(ResetNeeded, match="the first reset must be of every lane"):
        env.reset(seed=3, options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(env.reset(seed=0)[0], twin.reset(seed=0)[0])


def test_without_autoreset_a_lane_that_ended_must_be_reset():
    env = started_batch(2, autoreset_mode="Disabled", duration=0.02)
    for _ in range(2):
        env.step(np.zeros((2, 2)))
    with pytest.raises(ResetNeeded, match="lane 0 has ended"):
        env.step(np.zeros((2, 2)))
