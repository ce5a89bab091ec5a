"""PID with gravity compensation against its linear error equation."""

import numpy as np
from scipy.linalg import expm

from benchmarks.run.rollout import rollout
from fbl_gym import TABLE_1
from fbl_gym.model.arm import inertia_matrix
from tests.controllers.closed_loop import nominal

REST = np.array([-np.pi / 2, 0.4])
RESTING = {"kind": "minimum-jerk", "points": (tuple(REST),)}


def test_small_motions_obey_the_linearised_loop():
    """M e'' + Kd e' + Kp e + Ki int(e) = 0 about a rest, gravity being compensated: compared with the matrix exponential."""
    w, damping, share, start = 10.0, 0.8, 0.3, np.array([1e-3, -1e-3])
    scenario = nominal(reference=RESTING, initial_error=tuple(-start), control_dt=1e-3, duration=1.0)
    trace = rollout("pid-gravity", scenario, [0], {"frequency": w, "damping": damping, "integral": share})
    inertia, scale = inertia_matrix(TABLE_1, REST), np.diag(np.diagonal(inertia_matrix(TABLE_1, (0.0, 0.0))))
    kp, kd, ki = w**2 * scale, 2 * damping * w * scale, share * w**3 * scale
    inverse, eye, zero = np.linalg.inv(inertia), np.eye(2), np.zeros((2, 2))
    # x = (int e, e, e')
    a = np.block([[zero, eye, zero], [zero, zero, eye], [-inverse @ ki, -inverse @ kp, -inverse @ kd]])
    expected = np.array([(expm(a * t) @ np.concatenate([[0, 0], start, [0, 0]]))[2:4] for t in trace.time[::50]])
    error = (trace.reference - trace.position)[::50, 0]
    assert np.abs(error - expected).max() < 0.03 * np.abs(start).max()


def test_pd_with_gravity_compensation_leaves_the_load_over_its_stiffness():
    """At rest PD leaves e = d / Kp of a constant load, to the gravity compensation's own stiffness."""
    load = np.array([40.0, 10.0])
    scenario = nominal(reference=RESTING, disturbance={"kind": "array", "torque": (tuple(load),)}, duration=10.0)
    w = 10.0
    kp = w**2 * np.diagonal(inertia_matrix(TABLE_1, (0.0, 0.0)))
    pd = rollout("pd-gravity", scenario, [0], {"frequency": w})
    np.testing.assert_allclose((pd.reference - pd.position)[-1, 0], load / kp, rtol=1e-3)


def test_the_integral_does_not_wind_up():
    scenario = nominal(
        reference=RESTING, actuator={"torque_limit": (250, 100)}, initial_error=(1.2, 0.0), duration=10.0
    )
    trace = rollout("pid-gravity", scenario, [0])
    assert np.abs((trace.reference - trace.position)[-1, 0]).max() < 1e-2
