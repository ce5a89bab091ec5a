"""Super-twisting against Moreno and Osorio's Lyapunov function, and what its boundary layer trades."""

import numpy as np
import pytest

import controllers
from benchmarks.rollout import rollout
from fbl_gym import TwoLinkArmEnv, scenarios


def test_moreno_and_osorios_lyapunov_function_falls():
    """x1' = -k1 |x1|^1/2 sign x1 + x2, x2' = -k2 sign x1 + f with |f| < L, for k1 = 1.5 L^1/2 and k2 = 1.1 L: with
    zeta = (|x1|^1/2 sign x1, x2) a quadratic form of zeta falls along every path, so x1 is reached in finite time."""
    bound = 10.0
    k1, k2, dt = 1.5 * np.sqrt(bound), 1.1 * bound, 1e-5
    from scipy.linalg import solve_continuous_lyapunov

    # Without perturbation zeta' = |x1|^-1/2 A zeta with A = [[-k1/2, 1/2], [-k2, 0]].
    a = np.array([[-k1 / 2, 0.5], [-k2, 0.0]])
    p = solve_continuous_lyapunov(a.T, -np.eye(2))
    assert np.all(np.linalg.eigvalsh(p) > 0)
    x1, x2 = 1.0, 0.0
    values = []
    for _ in range(200_000):
        zeta = np.array([np.sqrt(abs(x1)) * np.sign(x1), x2])
        values.append(zeta @ p @ zeta)
        if abs(x1) < 1e-4 and abs(x2) < 1e-2:
            break
        x1, x2 = x1 + dt * (-k1 * np.sqrt(abs(x1)) * np.sign(x1) + x2), x2 - dt * k2 * np.sign(x1)
    assert values[-1] < 1e-3 * values[0]
    # Crossings of x1 = 0 are where the sampled path may step over the kink.
    rises = np.diff(values)
    assert np.sum(rises > 1e-4 * values[0]) == 0


def test_it_beats_a_perturbation_that_computed_torque_yields_to():
    """A sinusoidal load whose rate stays below L: what is left at 1 kHz without boundary layer, against the same surface."""
    scenario = scenarios.get("nominal").replace(
        disturbance={"kind": "sine", "amplitude": (60.0, 20.0), "frequency": 0.5, "phase": 0.0}, control_dt=1e-3
    )
    sliding = rollout("sliding-mode", scenario, [0], {"layer": 0.0, "bound": 300.0})
    computed = rollout("computed-torque", scenario, [0], {"frequency": 15.0})
    left, yielded = (np.abs(t.reference - t.position)[2000:].max() for t in (sliding, computed))
    assert left < 2e-3
    assert yielded > 10 * left


def test_the_boundary_layer_calms_the_torque():
    scenario = scenarios.get("noise-1")
    variation = {}
    for layer in (0.0, 0.1):
        trace = rollout("sliding-mode", scenario, range(4), {"layer": layer})
        variation[layer] = np.abs(np.diff(trace.torque, axis=0)).sum()
    assert variation[0.1] < 0.5 * variation[0.0]


@pytest.mark.parametrize(("gain", "value"), [("slope", 0.0), ("bound", -1.0), ("layer", -0.1)])
def test_bad_gains_are_named(gain, value):
    with pytest.raises(ValueError, match=f"{gain} must be"):
        controllers.make("sliding-mode", TwoLinkArmEnv(), **{gain: value})
