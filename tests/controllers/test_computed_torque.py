"""Computed torque against its error equation and the stability limit of its sampled loop."""

import numpy as np
import pytest

from benchmarks.run.rollout import rollout
from fbl_gym import ArmParameters, scenarios

STILL = {"kind": "minimum-jerk", "points": ((-np.pi / 2, 0.4),)}


def test_the_error_obeys_its_linear_equation():
    """e'' + 2 w e' + w^2 e = 0 with an exact model: e = E (1 + w t) exp(-w t) from rest."""
    w = 8.0
    scenario = scenarios.get("nominal").replace(
        reference=STILL, initial_error=(0.05, -0.05), control_dt=1e-3, actuator=None, duration=1.5
    )
    trace = rollout("computed-torque", scenario, [0], {"frequency": w})
    error = (trace.reference - trace.position)[:, 0]
    expected = error[0] * (1 + w * trace.time[:, None]) * np.exp(-w * trace.time[:, None])
    assert np.abs(error - expected).max() < 5e-3 * np.abs(error[0]).max()


@pytest.mark.parametrize(("share", "grows"), [(0.95, False), (1.05, True)])
def test_the_sampled_loop_has_its_stability_limit(share, grows):
    """q+ = q + v dt + u dt^2 / 2, v+ = v + u dt with u = -k (w^2 q + 2 w v), k the model's inertia over the real one: the
    characteristic polynomial at z = -1 is 4 (1 - k w dt), so k < 1 / (w dt)."""
    w, dt = 20.0, 0.01
    ratio = share / (w * dt)
    scenario = scenarios.get("nominal").replace(
        arm=ArmParameters(gravity=0.0), reference=STILL, initial_error=(1e-4, -1e-4), actuator=None, duration=4.0,
        parameter_error={"ratio": (1 / ratio, 1 / ratio, 1.0, 1.0)}, control_dt=dt,
    )  # fmt: skip
    trace = rollout("computed-torque", scenario, [0], {"frequency": w})
    early, late = (np.abs(trace.reference - trace.position)[rows].max() for rows in (slice(0, 10), slice(90, 100)))
    assert (late > 2 * early) if grows else (late < 0.5 * early)
