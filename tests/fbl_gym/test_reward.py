"""The reward: equation and slope."""

import numpy as np
import pytest

from tests.fbl_gym.episodes import started


@pytest.mark.parametrize("form", ["log", "l1"])
@pytest.mark.parametrize("actuator", [{}, {"delay": 0.05, "lag": 0.1}], ids=str)
def test_the_reward_is_the_documented_equation(form, actuator):
    """Effort and chatter are of the command, not of the applied torque."""
    weights = {"weight_tracking": 2.0, "weight_effort": 0.3, "weight_chatter": 0.7}
    reward = {"tracking": form, "worst": 1.5, "resolution": 2e-3, **weights}
    env = started(reward=reward, noise={"position": 0.1}, actuator=actuator)
    rng, before = np.random.default_rng(0), env.truth.applied_torque / env.interface.torque_limit
    for k in range(60):
        u = rng.uniform(-0.2, 0.2, 2) * (1 if k % 10 else 7)  # now and then beyond its box
        reward, u = env.step(u)[1], np.clip(u, -1.0, 1.0)
        error = np.abs(env.truth.reference - env.truth.position).sum()
        t = np.log(1 + error / 2e-3) / np.log(1 + 1.5 / 2e-3) if form == "log" else error / 1.5
        e, c = np.abs(u).mean(), np.abs(u - before).mean() / 2
        assert reward == pytest.approx(1 - (2.0 * min(t, 1.0) + 0.3 * e + 0.7 * c) / 3.0, abs=1e-12)
        assert 0.0 <= reward <= 1.0
        before = u


def test_without_torque_limits_only_tracking_counts():
    env = started(actuator=None, action="torque", reward={"tracking": "l1", "worst": 3.0})
    for k in range(30):
        reward, truth = env.step((500.0 * (-1) ** k, 0.0))[1], env.truth
        error = np.abs(truth.reference - truth.position).sum()
        assert reward == pytest.approx(1 - min(error / 3.0, 1.0) / 1.12, abs=1e-12)


@pytest.mark.parametrize("form", ["log", "l1"])
def test_reward_has_a_slope_at_zero_error(form):
    """It is one at perfect tracking without effort or chatter, here of an arm that floats beside its reference."""
    still = {"reference": {"kind": "minimum-jerk", "points": [(0.0, 0.0)]}, "arm": {"gravity": 0.0}}
    errors = (0.0, 1e-6, 1e-4, 1e-2)
    envs = (started(reward={"tracking": form}, initial_error=(error, 0.0), **still) for error in errors)
    rewards = [env.step((0.0, 0.0))[1] for env in envs]
    assert rewards[0] == 1.0
    assert np.all(np.diff(rewards) / np.diff(errors) < -0.1)
