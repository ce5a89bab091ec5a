"""The Kalman filter against Riccati's equation and filterpy; the robust controller against the cascade."""

import numpy as np
import pytest
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter
from scipy.linalg import solve_continuous_are, solve_discrete_are

import controllers
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from controllers.paper.kalman import PAPER_SIGMA, JointKalman, gains
from fbl_gym import TwoLinkArmEnv, scenarios
from tests.controllers.closed_loop import tracking


def test_the_gain_at_a_fast_rate_is_the_papers_continuous_gain():
    """Q_c = diag(0, 0.1) and R_c = 0.1 in (20), (21): P = [[.141421, .1], [.1, .141421]], K = [1.41421, 1.0]."""
    a, c = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]])
    p = solve_continuous_are(a.T, c.T, np.diag([0.0, 0.1]), np.array([[0.1]]))
    np.testing.assert_allclose(p, [[0.141421, 0.1], [0.1, 0.141421]], atol=1e-6)
    k = (p @ c.T / 0.1).ravel()
    np.testing.assert_allclose(k, [1.41421, 1.0], atol=1e-5)
    # Ours, per sample, is that times dt, with an error that shrinks with dt; the continuous form has it at any dt.
    np.testing.assert_allclose(gains(1e-3, PAPER_SIGMA, PAPER_SIGMA, "continuous")[-1] / 1e-3, k, rtol=1e-3)
    assert np.abs(gains(1e-2, PAPER_SIGMA, PAPER_SIGMA)[-1] / 1e-2 - k).max() < 1.1e-2
    assert np.abs(gains(1e-3, PAPER_SIGMA, PAPER_SIGMA)[-1] / 1e-3 - k).max() < 1.1e-3


@pytest.mark.parametrize(("acceleration", "position"), [(1.0, 1.0), (0.5, 5e-3), (10.0, 1e-4)])
def test_the_converged_gain_solves_the_discrete_riccati_equation(acceleration, position):
    dt = 1e-2
    f, h = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    q, r = Q_discrete_white_noise(2, dt, acceleration**2), np.array([[position**2]])
    p = solve_discrete_are(f.T, h.T, q, r)
    k = (p @ h.T / (h @ p @ h.T + r)).ravel()
    np.testing.assert_allclose(gains(dt, acceleration, position)[-1], k, rtol=1e-5)


def started(filter_, q, v):
    """Return the state of a filter after the first observation, which ends no sample."""
    state = filter_.update(filter_.initial(q, v), q, np.zeros_like(q))
    np.testing.assert_array_equal([state.position, state.velocity], [q, v])
    return state


def test_the_batched_update_agrees_with_filterpy():
    """Random measurements through ours, all joints and lanes at once, and through filterpy one by one."""
    dt, n, steps = 0.01, 3, 200
    rng = np.random.default_rng(0)
    y, u = rng.normal(size=(steps, n, 2)), rng.normal(size=(steps, n, 2))
    ours = JointKalman(dt, 0.5, 0.02)
    state = started(ours, np.zeros((n, 2)), np.zeros((n, 2)))
    theirs = []
    for _ in range(2 * n):
        kalman = KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
        kalman.F, kalman.B, kalman.H = np.array([[1, dt], [0, 1]]), np.array([[dt**2 / 2], [dt]]), np.array([[1.0, 0]])
        kalman.Q, kalman.R = Q_discrete_white_noise(2, dt, 0.5**2), np.array([[0.02**2]])
        kalman.x, kalman.P = np.zeros((2, 1)), np.diag([0.02**2, 0.01])
        theirs.append(kalman)
    for k in range(steps):
        state = ours.update(state, y[k], u[k])
        estimate = np.stack([state.position, state.velocity], axis=-1)
        for i, kalman in enumerate(theirs):
            kalman.predict(u=np.array([[u[k].ravel()[i]]]))
            kalman.update(np.array([[y[k].ravel()[i]]]))
            np.testing.assert_allclose(estimate.reshape(-1, 2)[i], kalman.x[:, 0], rtol=1e-9, atol=1e-11)


def test_the_filter_costs_accuracy_at_a_low_rate():
    """It takes the acceleration at an interval's end for that of the whole interval. At 100 Hz this alone is an error of
    ten times the cascade's; at 1 kHz it is less than a fifth of that."""
    slow, fast, cascade = (
        measure(rollout(policy, scenarios.get("nominal").replace(duration=3.0, control_dt=dt), [0]))[0]["error_pct"]
        for policy, dt in (("robust-flm", 1e-2), ("robust-flm", 1e-3), ("cascade-flm", 1e-2))
    )
    assert slow > 5 * cascade
    assert fast < 0.25 * slow


def test_the_robust_controller_needs_no_velocity_sensor():
    env = TwoLinkArmEnv(sensors=("position", "acceleration"))
    errors, _ = tracking(controllers.make("robust-flm", env), env, 200)
    assert np.abs(errors[-1]).max() < 0.2
