"""Slotine and Li's law against its Lyapunov function; its estimates converge, stay physical and pause."""

import numpy as np

import controllers
from fbl_gym import TwoLinkArmVectorEnv, scenarios
from fbl_gym.arm import inertia_matrix
from tests.controllers.passive_loop import EXCITING, closed_loop, wrong


def test_slotine_lis_lyapunov_function_decreases():
    """V = s'Ms/2 + (p^ - p)'Gamma^-1 (p^ - p)/2 never rises along the loop, and falls by the integral of s'Ks."""
    policy, p, (estimate, s, q, _) = closed_loop("slotine-li", wrong())
    kinetic = 0.5 * np.einsum("tni,tnij,tnj->tn", s, inertia_matrix(p, q), s)
    v = kinetic + 0.5 * (((estimate - p) ** 2) / policy.rates).sum(axis=-1)
    assert np.diff(v, axis=0).max() < 2e-3 * v[0].max()
    gain = policy.damping * inertia_matrix(policy.interface.nominal, q)
    lost = 5e-4 * np.einsum("tni,tnij,tnj->tn", s, gain, s).sum(axis=0)
    np.testing.assert_allclose(v[0] - v[-1], lost, rtol=0.05)


def test_composite_estimates_converge_under_excitation():
    """Along an exciting motion the prediction error brings the estimates to the truth; the tracking error alone is slower."""
    scenario = wrong().replace(duration=20.0, control_dt=1e-2, physics_dt=1e-3, initial_error=0.0)
    ends = {}
    for name in ("slotine-li", "slotine-li-composite"):
        _, p, (estimate, *_) = closed_loop(name, scenario, composite=30.0 if "composite" in name else 0.0)
        ends[name] = np.median(np.abs(estimate[-1] / p - 1))
    assert ends["slotine-li-composite"] < 0.01
    assert ends["slotine-li-composite"] < 0.5 * ends["slotine-li"]


def test_estimates_stay_physical():
    policy = controllers.make("slotine-li", TwoLinkArmVectorEnv(1))
    nominal = policy.interface.nominal.lumped
    wild = policy.project(np.array([[-1.0, 1e9, 1e9, np.inf, 0.0]]))
    assert np.all((wild >= nominal / policy.reach) & (wild <= nominal * policy.reach))
    assert wild[0, 0] * wild[0, 1] > wild[0, 2] ** 2


def test_estimates_are_held_while_the_torque_saturates():
    scenario = scenarios.get("nominal").replace(
        actuator={"torque_limit": (1.0, 1.0)}, parameter_error=1.5, duration=0.2, reference=EXCITING
    )
    _, _, (estimate, *_) = closed_loop("slotine-li", scenario)
    np.testing.assert_array_equal(estimate[-1], estimate[0])
