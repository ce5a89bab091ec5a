"""Archives of stable-baselines3 as policies."""

import importlib
import json
import sys
import zipfile

import gymnasium
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor

from benchmarks.policies import external
from benchmarks.policies.name import PolicyName
from benchmarks.policies.spec import resolve
from benchmarks.rl.sb3 import load_zip
from fbl_gym import TwoLinkArmEnv, TwoLinkArmTrackingEnv, TwoLinkArmVectorEnv


def test_an_archive_is_loaded_only_with_trust(tmp_path):
    env = TwoLinkArmEnv()
    model = PPO("MlpPolicy", env, device="cpu")
    model.save(tmp_path / "model.zip")
    with pytest.raises(ValueError, match="runs the code in it"):
        load_zip(tmp_path / "model.zip", env.interface)
    policy = load_zip(tmp_path / "model.zip", env.interface, trust=True)
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(
        policy.predict(observation, deterministic=True)[0], model.predict(observation, deterministic=True)[0]
    )
    with pytest.raises(ValueError, match="observation_space must be"):
        load_zip(tmp_path / "model.zip", TwoLinkArmEnv(preview=1).interface, trust=True)


def save_model(folder, env, algorithm="PPO", module="stable_baselines3", **settings):
    """Save a model that has not learned."""
    policy = settings.pop("policy", "MlpPolicy")
    model = getattr(importlib.import_module(module), algorithm)(policy, env, device="cpu", seed=0, **settings)
    model.save(folder / "model.zip")
    return model, folder / "model.zip"


@pytest.mark.parametrize(
    ("env", "message"),
    [
        (
            lambda: gymnasium.wrappers.RescaleObservation(TwoLinkArmEnv(), np.float64(-1), np.float64(1)),
            "observation_space .* -25.1327 to 25.1327, .* got .* of -1 to 1: train it with .*TwoLinkArmTracking-v0",
        ),
        (
            lambda: TwoLinkArmEnv(action="torque"),
            'got .* of -2000 to 2000, -800 to 800: train it with action="normalized"',
        ),
        (lambda: TwoLinkArmTrackingEnv(action="torque"), "got .* of -2000 to 2000, -800 to 800: train it with action="),
        (lambda: TwoLinkArmEnv(action="acceleration"), 'got .* of -100 to 100: train it with action="normalized"'),
    ],
)
def test_an_archive_of_other_observations_or_actions_is_refused(env, message, tmp_path):
    """Although their shapes are those of the environment."""
    _, path = save_model(tmp_path, env())
    with pytest.raises(ValueError, match=message):
        load_zip(path, TwoLinkArmEnv().interface, trust=True)


@pytest.mark.filterwarnings("ignore:.*precision lowered by casting")
def test_a_zip_of_single_precision_or_monitored_by_sb3_acts_as_it_was_save_model(tmp_path):
    plain = gymnasium.make("fbl_gym/TwoLinkArm-v0")
    observation, _ = plain.reset(seed=0)
    for env in (Monitor(plain), gymnasium.wrappers.DtypeObservation(plain, np.float32)):
        model, path = save_model(tmp_path, env)
        np.testing.assert_array_equal(
            load_zip(path, plain.unwrapped.interface, trust=True).predict(observation, deterministic=True)[0],
            model.predict(observation, deterministic=True)[0],
        )


@pytest.mark.parametrize(
    ("algorithm", "settings"),
    [
        ("A2C", {}),
        ("SAC", {"buffer_size": 10}),
        ("TD3", {"buffer_size": 10}),
        ("DDPG", {"buffer_size": 10}),
        ("TQC", {"module": "sb3_contrib", "buffer_size": 10}),
        ("CrossQ", {"module": "sb3_contrib", "buffer_size": 10}),
        ("TRPO", {"module": "sb3_contrib"}),
        ("ARS", {"module": "sb3_contrib"}),
        ("RecurrentPPO", {"module": "sb3_contrib", "policy": "MlpLstmPolicy"}),
    ],
)
def test_an_archive_of_any_algorithm_acts_as_it_was_saved(algorithm, settings, tmp_path):
    if settings.get("module"):
        pytest.importorskip("sb3_contrib")
    env = TwoLinkArmEnv()
    model, path = save_model(tmp_path, env, algorithm, **settings)
    external.trust(PolicyName.parse(str(path)))
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(
        resolve(str(path)).make(env).predict(observation, deterministic=True)[0],
        model.predict(observation, deterministic=True)[0],
    )


@pytest.mark.parametrize(
    ("algorithm", "options"),
    [("PPO", {}), ("PPO", {"past_actions": 0}), ("RecurrentPPO", {"scenario": "servo-delay-2"})],
)
def test_an_archive_of_the_tracking_environment_acts_on_the_arm_as_it_was_saved(algorithm, options, tmp_path):
    module, policy = ("stable_baselines3", "MlpPolicy")
    if algorithm == "RecurrentPPO":
        pytest.importorskip("sb3_contrib")
        module, policy = ("sb3_contrib", "MlpLstmPolicy")
    tracking = TwoLinkArmTrackingEnv(**options)
    model, path = save_model(tmp_path, tracking, algorithm, module, policy=policy)
    lanes = TwoLinkArmVectorEnv(2, options.get("scenario"), autoreset_mode="SameStep")
    archive = load_zip(path, lanes.interface, trust=True)
    a, b = tracking.reset(seed=1)[0], lanes.reset(seed=0)[0]
    mine = theirs = starts = None
    for _ in range(20):
        action, mine = model.predict(a, mine, None if starts is None else starts[1:], deterministic=True)
        actions, theirs = archive.predict(b, theirs, starts, deterministic=True)
        np.testing.assert_allclose(actions[1], action, atol=2e-3)  # the first action is from measured positions
        a, b = tracking.step(action)[0], lanes.step(actions)[0]
        starts = np.zeros(2, dtype=bool)
    restarted = archive.predict(b, theirs, np.array([True, False]), deterministic=True)[1][0]
    np.testing.assert_array_equal(restarted[1, :2], archive.predict(b, theirs, deterministic=True)[1][0][1, :2])


def test_an_archive_of_the_tracking_environment_acts_on_any_arm(tmp_path):
    _, path = save_model(tmp_path, TwoLinkArmTrackingEnv())
    external.trust(PolicyName.parse(str(path)))
    for scenario in ("everything-2", "servo-everything-2"):
        env = TwoLinkArmEnv(scenario)
        action, _ = resolve(str(path)).make(env).predict(env.reset(seed=0)[0])
        assert env.action_space.contains(action)
    with pytest.raises(ValueError, match="observation_space must be"):
        load_zip(path, TwoLinkArmEnv(sensors=("position",)).interface, trust=True)


def test_an_archive_of_an_unknown_algorithm_is_refused(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "sbx", None)  # as if it were not installed
    path = tmp_path / "model.zip"
    for data, message in (
        (
            {"policy_class": {"__module__": "mine.policies"}},
            "must be of stable-baselines3, .* got a network of mine.policies",
        ),
        ({"policy_class": {"__module__": "sbx.sac.policies"}}, "needs sbx, which is not .*: pip install sbx-rl"),
        ({"policy_class": {"__module__": "sb3_contrib.none.policies"}}, "needs none of sb3_contrib, which has no such"),
        ({}, "must be an archive that stable-baselines3's save wrote"),
    ):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("data", json.dumps(data))
        with pytest.raises(ValueError, match=message):
            load_zip(path, TwoLinkArmEnv().interface, trust=True)
    path.write_bytes(b"PK")
    with pytest.raises(ValueError, match="must be an archive that stable-baselines3's save wrote"):
        load_zip(path, TwoLinkArmEnv().interface, trust=True)
