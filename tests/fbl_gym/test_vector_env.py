"""The vector environment fulfils Gymnasium's rules, and its errors change no episode; `test_lanes.py` tests the motion."""

import functools
import itertools

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.kernel.step import api
from tests.fbl_gym.episodes import EVENTFUL, ID, TRACKING, started_batch
from tests.fbl_gym.test_lanes import MODES


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
    options |= {"limits": {"velocity": 3.0}} | ({"history": 1} if name == TRACKING else {})
    make = functools.partial(gym.make_vec, name, vectorization_mode="vector_entry_point", **options)
    together, parts, ends = make(8, scenario=[*SCENARIOS]), (slice(3), slice(3, 6), slice(6, 8)), 0
    past = max(env.interface.layout["previous_actions"].stop for env in together.envs) - 10
    alone = [make(n, scenario=each, past_actions=past // 2) for n, each in zip((3, 3, 2), SCENARIOS, strict=True)]
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
    env, twin = (TwoLinkArmVectorEnv(2, ["nominal", "noise-1"]) for _ in range(2))
    env.reset(seed=0), twin.reset(seed=0)
    with pytest.raises(ValueError, match="actions must be finite, got"):
        env.step([[0.0, 0.0], [np.nan, 0.0]])
    np.testing.assert_array_equal(env.step(np.zeros((2, 2)))[0], twin.step(np.zeros((2, 2)))[0])
    same = env.reset(options={"position": (-1.0, 0.5)})[0]
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


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_the_first_reset_is_of_every_lane(mode):
    env, twin = TwoLinkArmVectorEnv(2, autoreset_mode=mode), TwoLinkArmVectorEnv(2, autoreset_mode=mode)
    with pytest.raises(ResetNeeded, match="the first reset must be of every lane"):
        env.reset(seed=3, options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(env.reset(seed=0)[0], twin.reset(seed=0)[0])


def test_without_autoreset_a_lane_that_ended_must_be_reset():
    env = started_batch(2, autoreset_mode="Disabled", duration=0.02)
    for _ in range(2):
        env.step(np.zeros((2, 2)))
    with pytest.raises(ResetNeeded, match="lane 0 has ended"):
        env.step(np.zeros((2, 2)))
