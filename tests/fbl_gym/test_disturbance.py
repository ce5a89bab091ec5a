"""The option `disturbance`: its torques reach the plant at their times, and only there."""

import numpy as np
from scipy import stats

from fbl_gym import TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import play, run, same, started_batch


def test_a_piecewise_constant_disturbance_has_levels_of_its_period_and_amplitude():
    *_, truths = play(200, disturbance={"kind": "piecewise-constant", "amplitude": (20.0, 5.0), "period": 0.2})
    *_, others = play(200)
    assert same(truths, others, "reference", "applied_torque", "lumped")
    assert not same(truths[5:], others[5:], "position")
    disturbance = np.array([truth.disturbance for truth in truths])
    change = np.any(np.diff(disturbance, axis=0) != 0, axis=(1, 2))
    # Sample k belongs to the step that ends there: the level of [0.2 i, 0.2 (i + 1)) begins at 20 i + 1.
    assert set(np.flatnonzero(change)) == {20 * i for i in range(1, 10)}
    for joint, amplitude in ((0, 20.0), (1, 5.0)):
        assert 0.9 * amplitude < np.abs(disturbance[..., joint]).max() <= amplitude


def test_levels_of_a_disturbance_are_new_in_each_lane_and_episode():
    env = TwoLinkArmVectorEnv(512, disturbance={"kind": "piecewise-constant", "amplitude": 1.0, "period": 0.01})
    truths = [truth for seed in (0, None) for truth in run(env, 3, seed=seed)[1][1:]]
    levels = np.concatenate([truth.disturbance.T for truth in truths])
    assert len(levels) == 12
    assert np.abs(np.corrcoef(levels) - np.eye(12)).max() < 0.2
    assert stats.kstest(np.concatenate(levels), stats.uniform(-1, 2).cdf).pvalue > 1e-3


def test_the_phases_of_a_sine_disturbance_are_uniform():
    env = started_batch(4096, disturbance={"kind": "sine", "amplitude": (3.0, 5.0)})
    for joint, amplitude in ((0, 3.0), (1, 5.0)):
        values = env.truth.disturbance[:, joint] / amplitude
        assert stats.kstest(values, stats.arcsine(-1, 2).cdf).pvalue > 1e-3
    assert abs(np.corrcoef(env.truth.disturbance.T)[0, 1]) < 0.06
