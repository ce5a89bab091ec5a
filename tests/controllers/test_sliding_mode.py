"""Super-twisting against Moreno and Osorio's Lyapunov function, and its boundary layer."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are

import controllers
from benchmarks.run.rollout import rollout
from fbl_gym import TABLE_1, TwoLinkArmEnv, scenarios
from fbl_gym.model.arm import inertia_matrix
from tests.controllers.closed_loop import EXACT, loop, tracking

POSE = (-np.pi / 2, 0.4)


def test_moreno_and_osorios_lyapunov_function_decreases():
    """s' = -k1 |s|^1/2 sign s + x,  x' = -k2 sign s + f' on an exact model, where f = M^-1 d and |f'| stays below 0.9 L.

    With zeta = (|s|^1/2 sign s, x):  zeta' = |s|^-1/2 (A zeta + B u), |u| < 0.95 L |zeta_1|. So V = zeta'P zeta falls for a P
    with A'P + PA + PBB'P + (0.95 L)^2 C'C < 0, from Riccati's equation, and s = 0 is reached in finite time.
    """
    bound, slope, dt, frequency = 50.0, 15.0, 1e-4, 2.0
    k1, k2 = 1.5 * np.sqrt(bound), 1.1 * bound
    a, b, c = np.array([[-k1 / 2, 0.5], [-k2, 0.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    p = solve_continuous_are(a, b, (0.95 * bound) ** 2 * c.T @ c + 0.01 * np.eye(2), -np.eye(1))
    assert np.all(np.linalg.eigvalsh(p) > 0)
    load = inertia_matrix(TABLE_1, POSE) @ np.full(2, 0.9 * bound / (2 * np.pi * frequency))
    env = TwoLinkArmEnv(
        reference={"kind": "minimum-jerk", "points": (POSE,)}, initial_error=(-0.02, 0.01), actuator=None, action="torque",
        disturbance={"kind": "sine", "amplitude": tuple(load), "frequency": frequency, "phase": 0.0},
        control_dt=dt, physics_dt=dt, duration=0.3,
    )  # fmt: skip
    policy, log = controllers.make("sliding-mode", env, slope=slope, bound=bound, layer=0.0), []
    for observation, state, *_ in loop(policy, env, 2900):
        q, v, r, dr = policy.read(observation, "position", "velocity", "reference_position", "reference_velocity")
        s = dr - v + slope * (r - q)
        f = np.linalg.solve(inertia_matrix(TABLE_1, q), env.truth.disturbance)
        zeta = np.stack([np.sqrt(np.abs(s)) * np.sign(s), f - (state.integral[0] if state else 0.0)])
        log.append((np.einsum("ij,ik,kj->j", zeta, p, zeta), np.abs(s)))
    value, surface = np.swapaxes(log, 0, 1)
    # Closer than that, one sample steps over s = 0.
    assert np.diff(value, axis=0)[surface[:-1] > 1e3 * bound * dt**2].max() < 0.0
    # Levant: a sampled second-order sliding mode keeps |s| within a few L dt^2.
    assert surface[2000:].max() < 10 * bound * dt**2


STILL = {"kind": "minimum-jerk", "points": (POSE,)}


def test_no_limit_cycle_is_left_behind_a_delay():
    """The damping does not vanish at s = 0."""
    env = TwoLinkArmEnv(reference=STILL, initial_error=(-0.05, 0.02), actuator={"delay_samples": 1, "lag": 0.01})
    errors, _ = tracking(controllers.make("sliding-mode", env), env, 500)
    assert np.abs(errors[-50:]).max() < 1e-9


def test_the_boundary_layer_reduces_chatter():
    scenario = scenarios.get("noise-1")
    variation = {}
    for layer in (0.0, 0.1):
        trace = rollout("sliding-mode", scenario, range(4), {"layer": layer})
        variation[layer] = np.abs(np.diff(trace.torque, axis=0)).sum()
    assert variation[0.1] < 0.5 * variation[0.0]


def test_terminal_sliding_mode_follows_its_equation():
    """Exact model, 1 kHz, from rest: e'' = -w / p |e'|^(2-p) sign(e') - bound sat(w^2 s / bound), by scipy's solver."""
    w, power, bound, e0 = 8.0, 1.4, 5.0, 0.2
    env = TwoLinkArmEnv(**EXACT | {"reference": STILL}, initial_error=(-e0, 0.0))
    law = controllers.make("terminal-sliding-mode", env, frequency=w, power=power, bound=bound)
    errors, _ = tracking(law, env, 1000)

    def rates(_, x):
        e, rate = x
        s = e + np.sign(rate) * abs(rate) ** power / w
        return rate, -w / power * np.sign(rate) * abs(rate) ** (2 - power) - np.clip(w**2 * s, -bound, bound)

    expected = solve_ivp(rates, (0.0, 1.0), (e0, 0.0), t_eval=1e-3 * np.arange(1001), rtol=1e-8, atol=1e-10).y[0]
    assert np.abs(errors[:, 0] - expected).max() < 0.01 * e0


def test_terminal_sliding_mode_of_power_one_is_computed_torque():
    """Within the layer e'' + 2 w e' + w^2 e = 0, with the same observer."""
    scenario = scenarios.get("payload-2").replace(duration=1.0)
    terminal = rollout("terminal-sliding-mode", scenario, [0], {"frequency": 9.0, "power": 1.0, "bound": 1e6})
    computed = rollout("computed-torque-dob", scenario, [0], {"frequency": 9.0})
    np.testing.assert_allclose(terminal.position, computed.position, atol=1e-9)
