"""Slotine and Li's law against its Lyapunov function; its estimates converge, stay in their box and pause."""

import numpy as np

from fbl_gym import scenarios
from fbl_gym.model.arm import inertia_matrix
from tests.controllers.passive_loop import EXCITING, closed_loop, wrong

VISCOUS = (60.0, 15.0)


def test_slotine_lis_lyapunov_function_decreases():
    """V = s'Ms/2 + (p^ - p)'Gamma^-1 (p^ - p)/2 never rises along the loop, and falls by the integral of s'(K + B)s.

    B is the real viscous friction, which the law estimates too. Estimates of Coulomb friction reach the edge of their box.
    """
    policy, lumped, (estimate, s, q, _) = closed_loop("slotine-li", wrong(friction={"viscous": VISCOUS}), friction=50.0)
    p = np.concatenate([lumped, np.broadcast_to((*VISCOUS, 0.0, 0.0), (len(lumped), 4))], axis=-1)
    assert np.any(estimate[:, :, 7:] == 0.0)
    assert np.all(estimate[-1, :, 5:7] > 0.0)
    kinetic = 0.5 * np.einsum("tni,tnij,tnj->tn", s, inertia_matrix(lumped, q), s)
    v = kinetic + 0.5 * (((estimate - p) ** 2) / policy.rates).sum(axis=-1)
    assert np.diff(v, axis=0).max() < 2e-3 * v[0].max()
    gain = policy.damping * inertia_matrix(policy.interface.nominal, q) + np.diag(VISCOUS)
    lost = 5e-4 * np.einsum("tni,tnij,tnj->tn", s, gain, s).sum(axis=0)
    assert np.all(v[0] - v[-1] > 0.95 * lost)
    np.testing.assert_allclose(np.median((v[0] - v[-1]) / lost), 1.0, rtol=0.1)


def test_friction_is_estimated_and_taken_off_the_error():
    """With an exact model, the estimates come close to the real friction, and the error is a fraction of that without them."""
    friction = {"viscous": (40.0, 10.0), "coulomb": (20.0, 5.0)}
    scenario = wrong(0.0, friction=friction).replace(duration=20.0, control_dt=1e-2, physics_dt=1e-3, initial_error=0.0)
    left = {}
    for rate in (0.0, 20.0):
        _, _, (estimate, _, _, error) = closed_loop("slotine-li", scenario, friction=rate)
        left[rate] = np.abs(error[-500:]).mean()
    real = np.concatenate([friction["viscous"], friction["coulomb"]])
    np.testing.assert_allclose(np.median(estimate[-1, :, 5:] / real, axis=0), 1.0, atol=0.2)
    assert left[20.0] < 0.1 * left[0.0]


def test_composite_estimates_converge_under_excitation():
    """Along an exciting motion the prediction error brings the estimates to the truth; the tracking error alone is slower."""
    scenario = wrong().replace(duration=20.0, control_dt=1e-2, physics_dt=1e-3, initial_error=0.0)
    ends = {}
    for name, gains in (("slotine-li", {}), ("slotine-li-composite", {"composite": 30.0})):
        _, p, (estimate, *_) = closed_loop(name, scenario, friction=0.0, **gains)
        ends[name] = np.median(np.abs(estimate[-1, :, :5] / p - 1))
    assert ends["slotine-li-composite"] < 0.01
    assert ends["slotine-li-composite"] < 0.5 * ends["slotine-li"]


def test_estimates_are_held_while_the_torque_saturates():
    scenario = scenarios.get("nominal").replace(
        actuator={"torque_limit": (1.0, 1.0)}, parameter_error=1.5, duration=0.2, reference=EXCITING
    )
    _, _, (estimate, *_) = closed_loop("slotine-li", scenario)
    np.testing.assert_array_equal(estimate[-1], estimate[0])
