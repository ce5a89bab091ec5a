"""Every registered policy keeps the contract of `fbl-gym check-policy`, is frozen, and holds plain data."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

import controllers
from benchmarks.policies.spec import resolve
from benchmarks.rl.adapter import AdapterSettings
from benchmarks.rl.network import Actor
from benchmarks.run.contract import broken, check
from fbl_gym import Interface, TwoLinkArmEnv, scenarios

NAMES = controllers.names()


@pytest.mark.parametrize("name", NAMES)
def test_a_policy_keeps_every_promise(name):
    assert [f"{result.promise}: {result.detail}" for result in check(name) if not result.kept] == []


@pytest.mark.parametrize("name", NAMES)
def test_a_policy_is_frozen(name):
    policy = controllers.make(name, TwoLinkArmEnv())
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(policy, dataclasses.fields(policy)[0].name, None)


@pytest.mark.parametrize("name", [name for name in NAMES if controllers.access(name) != "privileged"])
def test_a_policy_without_privileged_access_holds_plain_data(name):
    """Its interface and its gains: nothing leads to an environment."""
    policy = controllers.make(name, TwoLinkArmEnv("mixed-error-3"))
    for field in dataclasses.fields(policy):
        plain = Interface | AdapterSettings | Actor | float | int | str | tuple | None
        assert isinstance(getattr(policy, field.name), plain), field.name
    assert type(controllers.make(name, policy.interface)) is type(policy)


@pytest.mark.parametrize("name", NAMES)
def test_sb3_evaluates_a_policy(name):
    evaluation = pytest.importorskip("stable_baselines3.common.evaluation")
    monitor = pytest.importorskip("stable_baselines3.common.monitor")
    env = monitor.Monitor(gym.make("fbl_gym/TwoLinkArm-v0", duration=1.0))
    reward, spread = evaluation.evaluate_policy(controllers.make(name, env), env, n_eval_episodes=2)
    assert 0.0 <= reward <= 100.0
    assert spread >= 0.0


def test_a_torque_at_a_limit_that_float32_rounds_down_lies_in_the_box():
    limit = 0.7
    assert float(np.float32(limit)) < limit
    scenario = scenarios.get("nominal").replace(actuator={"torque_limit": limit}, duration=0.5)
    assert broken(resolve("pd-gravity"), scenario) == ""
