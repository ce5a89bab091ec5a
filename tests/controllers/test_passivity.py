"""Slotine and Li's law and Spong's: regressors against the arm's own functions, Lyapunov functions along the closed loop."""

import numpy as np
import pytest

import controllers
from controllers.passivity import drift_regressor, momentum_regressor, slotine_li_regressor
from fbl_gym import TwoLinkArmVectorEnv, scenarios
from fbl_gym.arm import coriolis_matrix, gravity_torque, inertia_matrix, regressor

EXCITING = {"kind": "fourier", "centre": (-np.pi / 2, 0.0), "frequency": 0.2}


def random(n=100, k=4, seed=0):
    return np.random.default_rng(seed).uniform(-3, 3, (k, n, 2))


def test_the_regressor_is_the_skew_forms():
    """Y p = M a_r + C v_r + G with the C for which dM/dt - 2 C is skew, at random states."""
    q, v, v_r, a_r = random()
    p = np.array([17.0, 3.5, 4.0, 240.0, 70.0])
    expected = np.einsum("nij,nj->ni", inertia_matrix(p, q), a_r) + gravity_torque(p, q)
    expected += np.einsum("nij,nj->ni", coriolis_matrix(p, q, v, skew=True), v_r)
    np.testing.assert_allclose(slotine_li_regressor(q, v, v_r, a_r) @ p, expected, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(slotine_li_regressor(q, v, v, a_r), regressor(q, v, a_r), rtol=1e-12, atol=1e-12)


def test_the_momentum_form_needs_no_acceleration():
    """M v and G - C'v; and d/dt (M v) + (G - C'v) = M a + C v + G, by differences."""
    q, v, a, _ = random()
    p = np.array([17.0, 3.5, 4.0, 240.0, 70.0])
    np.testing.assert_allclose(momentum_regressor(q, v) @ p, np.einsum("nij,nj->ni", inertia_matrix(p, q), v))
    skew = np.einsum("nji,nj->ni", coriolis_matrix(p, q, v, skew=True), v)
    np.testing.assert_allclose(drift_regressor(q, v) @ p, gravity_torque(p, q) - skew, rtol=1e-12, atol=1e-9)
    h = 1e-6
    later, earlier = momentum_regressor(q + h * v, v + h * a), momentum_regressor(q - h * v, v - h * a)
    rate = (later - earlier) / (2 * h)
    np.testing.assert_allclose(rate + drift_regressor(q, v), regressor(q, v, a), rtol=1e-6, atol=1e-6)


def closed_loop(name, scenario, lanes=8, **gains):
    """Estimates or None, s, q and the true parameters, sample by sample."""
    env = TwoLinkArmVectorEnv(lanes, scenario, action="torque")
    policy, state = controllers.make(name, env, **gains), None
    observation, _ = env.reset(seed=0)
    log = []
    for _ in range(scenario.steps - 1):
        before = state[0].copy() if state else np.broadcast_to(policy.interface.nominal.lumped, (lanes, 5))
        q, v = policy.read(observation, "position", "velocity")
        r, dr = policy.read(observation, "reference_position", "reference_velocity")
        s = dr - v + np.array(policy.slope) * (r - q)
        action, state = policy.predict(observation, state)
        log.append((before, s, q, r - q))
        observation = env.step(action)[0]
    return policy, env.truth.lumped, [np.array(x) for x in zip(*log, strict=True)]


def wrong(radius=0.5, **changes):
    return scenarios.get("nominal").replace(
        parameter_error={"radius": radius}, actuator=None, control_dt=5e-4, physics_dt=5e-4, duration=2.0,
        initial_error=(0.1, -0.1), reference=EXCITING, **changes,
    )  # fmt: skip


def test_slotine_lis_lyapunov_function_falls():
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


def test_estimates_stay_an_arms():
    policy = controllers.make("slotine-li", TwoLinkArmVectorEnv(1))
    nominal = policy.interface.nominal.lumped
    wild = policy.project(np.array([[-1.0, 1e9, 1e9, np.inf, 0.0]]))
    assert np.all((wild >= nominal / policy.reach) & (wild <= nominal * policy.reach))
    assert wild[0, 0] * wild[0, 1] > wild[0, 2] ** 2


def test_nothing_is_learned_where_the_torque_saturates():
    scenario = scenarios.get("nominal").replace(
        actuator={"torque_limit": (1.0, 1.0)}, parameter_error=1.5, duration=0.2, reference=EXCITING
    )
    _, _, (estimate, *_) = closed_loop("slotine-li", scenario)
    np.testing.assert_array_equal(estimate[-1], estimate[0])


def test_spongs_lyapunov_function_falls_outside_the_layer():
    """V = s'Ms/2 falls by more than its damping where every parameter is within its bound, down to a set that shrinks with
    epsilon."""
    left = {}
    for epsilon in (0.1, 10.0):
        policy, p, (_, s, q, _) = closed_loop("spong-robust", wrong(0.25), bound=1.0, epsilon=epsilon)
        nominal = policy.interface.nominal.lumped
        assert np.all(np.abs(p / nominal - 1) < policy.bound)
        v = 0.5 * np.einsum("tni,tnij,tnj->tn", s, inertia_matrix(p, q), s)
        # Each of the five parameters adds at most bound * epsilon p1 / 4 to V'; beyond that, V must fall.
        layer = 5 * policy.bound * epsilon * nominal[0] / 4
        gain = policy.damping * inertia_matrix(nominal, q)
        outside = np.einsum("tni,tnij,tnj->tn", s, gain, s)[:-1] > 1.5 * layer
        assert outside.any()
        assert np.diff(v, axis=0)[outside].max() < 0.0
        left[epsilon] = np.median(v[-1000:])
    assert left[0.1] < 0.3 * left[10.0]


@pytest.mark.parametrize(
    ("name", "gains", "message"),
    [
        ("slotine-li", {"reach": 1.0}, "reach must be"),
        ("slotine-li", {"damping": -1.0}, "damping must be"),
        ("slotine-li-composite", {"composite": -1.0}, "composite must be"),
        ("spong-robust", {"epsilon": 0.0}, "epsilon must be"),
        ("spong-robust", {"slope": 0.0}, "slope must be"),
    ],
)
def test_bad_gains_are_named(name, gains, message):
    with pytest.raises(ValueError, match=message):
        controllers.make(name, TwoLinkArmVectorEnv(1), **gains)
