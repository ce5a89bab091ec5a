"""Laws that learn: adaptive, Spong's and the neural law by Lyapunov functions; a Gaussian process; iterative learning."""

import numpy as np
import pytest

import controllers
from benchmarks.run.rollout import rollout, rollout_trials
from controllers.laws.gaussian_process import SIGNAL
from controllers.laws.iterative_learning import CAPACITY
from controllers.laws.passivity import slotine_li_regressor
from controllers.laws.rbf_adaptive import FEATURES, NODES, RbfState, bumps, features
from fbl_gym import TABLE_1, TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios
from fbl_gym.model.arm import coriolis_matrix, gravity_torque, inertia_matrix, inverse_dynamics, regressor
from fbl_gym.scenarios.classes import CLASSES
from fbl_gym.scenarios.tiers import tier_scenario
from tests.controllers.closed_loop import EXACT, EXCITING, error_of, loop, mean_error, nominal


def closed_loop(name, scenario, lanes=8, **gains):
    """Return the law, the real lumped parameters, and by sample: the estimates or None, s, q and the error."""
    env = TwoLinkArmVectorEnv(lanes, scenario, action="torque")
    policy = controllers.make(name, env, **gains)
    log = []
    for observation, state, *_ in loop(policy, env, scenario.steps - 1):
        state = state or policy.initial(observation)
        q, v, r, dr = policy.read(observation, "position", "velocity", "reference_position", "reference_velocity")
        s = dr - v + np.array(policy.slope) * (r - q)
        log.append((state.estimate if state else None, s, q, r - q))
    return policy, env.truth.lumped, [np.array(x) for x in zip(*log, strict=True)]


def wrong(radius=0.5, **changes):
    return nominal(
        parameter_error={"radius": radius}, actuator=None, control_dt=5e-4, physics_dt=5e-4, duration=2.0,
        initial_error=(0.1, -0.1), reference=EXCITING, **changes,
    )  # fmt: skip


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
    logs = [closed_loop("slotine-li", scenario, friction=rate)[2] for rate in (0.0, 20.0)]
    without, left = (np.abs(error[-500:]).mean() for *_, error in logs)
    real = np.concatenate([friction["viscous"], friction["coulomb"]])
    np.testing.assert_allclose(np.median(logs[1][0][-1, :, 5:] / real, axis=0), 1.0, atol=0.2)
    assert left < 0.1 * without


def test_composite_estimates_converge_under_excitation():
    """Along an exciting motion the prediction error brings the estimates to the truth; the tracking error alone is slower."""
    scenario = wrong().replace(duration=20.0, control_dt=1e-2, physics_dt=1e-3, initial_error=0.0)
    ends = []
    for name, gains in (("slotine-li", {}), ("slotine-li-composite", {"composite": 30.0})):
        _, p, (estimate, *_) = closed_loop(name, scenario, friction=0.0, **gains)
        ends.append(np.median(np.abs(estimate[-1, :, :5] / p - 1)))
    assert ends[1] < min(0.01, 0.5 * ends[0])


def test_estimates_are_held_while_the_torque_saturates():
    scenario = nominal(actuator={"torque_limit": (1.0, 1.0)}, parameter_error=1.5, duration=0.2, reference=EXCITING)
    _, _, (estimate, *_) = closed_loop("slotine-li", scenario)
    np.testing.assert_array_equal(estimate[-1], estimate[0])


def test_the_lyapunov_function_falls_by_the_damping():
    """V = (s'W s + p~' Gamma^-1 p~) / 2 falls by damping s'W s on a wrong arm without friction."""
    scenario = wrong(0.3)
    gains = {"damping": 10.0, "friction": 1e-9}
    policy, real, (estimates, s, _, _) = closed_loop("computed-torque-adaptive", scenario, 4, **gains)
    missing = real - estimates[..., :5]
    value = 0.5 * ((policy.stretched * s**2).sum(-1) + (missing**2 / policy.rates[:5]).sum(-1))
    fall = policy.damping * (policy.stretched * s**2).sum(-1) * scenario.control_dt
    left = value - (value[0] - np.concatenate([np.zeros((1, 4)), np.cumsum(fall, axis=0)[:-1]]))
    assert np.abs(left).max() < 0.02 * (value[0] - value[-1]).min()
    assert (value[-1] < value[0]).all()


def test_spongs_lyapunov_function_decreases_outside_the_layer():
    """V = s'Ms/2 falls by more than its damping where every parameter is within its bound, down to a set that shrinks with
    epsilon."""
    left = {}
    for epsilon in (0.1, 10.0):
        policy, p, (_, s, q, _) = closed_loop("spong-robust", wrong(0.25), damping=20.0, bound=1.0, epsilon=epsilon)
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


def test_the_regressor_agrees_with_the_skew_form():
    """Y p = M a_r + C v_r + G with the C for which dM/dt - 2 C is skew, at random states."""
    q, v, v_r, a_r = np.random.default_rng(0).uniform(-3, 3, (4, 100, 2))
    p = np.array([17.0, 3.5, 4.0, 240.0, 70.0])
    expected = np.einsum("nij,nj->ni", inertia_matrix(p, q), a_r) + gravity_torque(p, q)
    expected += np.einsum("nij,nj->ni", coriolis_matrix(p, q, v, skew=True), v_r)
    np.testing.assert_allclose(slotine_li_regressor(q, v, v_r, a_r) @ p, expected, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(slotine_li_regressor(q, v, v, a_r), regressor(q, v, a_r), rtol=1e-12, atol=1e-12)


def test_the_networks_lyapunov_function_decreases_by_its_derivative():
    """Exact model, so W* = 0, and weights that start wrong: V falls, by the integral of k s' M s."""
    dt = 1e-3
    env = TwoLinkArmEnv(**EXACT, initial_error=(-0.2, 0.3))
    policy = controllers.make("rbf-adaptive", env, rate=150.0, forget=0.0)
    weights = np.random.default_rng(0).normal(size=(1, 2, FEATURES))
    values, loss, d = [], [0.0], inertia_matrix(TABLE_1, (0.0, np.pi / 2))
    for observation, state, *_ in loop(policy, env, 1000, state=RbfState(weights)):
        q, v = observation[0:2], observation[2:4]
        s = 10.0 * error_of(env) - v
        m, w = inertia_matrix(TABLE_1, q), state.weights[0]
        values.append(0.5 * s @ m @ s + 0.5 / 150.0 * np.trace(d @ w @ w.T))
        loss.append(loss[-1] + dt * 15.0 * s @ m @ s)
    values = np.array(values)
    assert np.diff(values).max() < 1e-4 * values[0]
    np.testing.assert_allclose(values[0] - values, loss[:-1], atol=0.03 * values[0])


def test_weights_stay_bounded_under_noise():
    """e-modification: |W_i| <= max |phi| / forget, under noise without end or excitation."""
    env = TwoLinkArmEnv()
    policy = controllers.make("rbf-adaptive", env, forget=0.2, rate=1000.0)
    rng, state, most, largest = np.random.default_rng(0), None, 0.0, 0.0
    for _ in range(2000):
        observation = np.concatenate([[0.3, -0.2], [-5.0, 4.0], np.zeros(2), [0.1, 0.4], np.zeros(2), 3.0 * np.ones(2)])
        observation[:4] += 3.0 * rng.normal(size=4)
        _, state = policy.predict(observation, state)
        largest = max(largest, np.linalg.norm(state.weights, axis=-1).max())
        most = max(most, np.linalg.norm(features(*observation[None, 6:].reshape(3, 1, 2))))
    assert 0.1 * most / 0.2 < largest <= most / 0.2


def test_the_network_learns_the_gravity_of_a_load():
    """Among drawn way-points, with a load at the tip: what the network says of an arm at rest becomes the gravity missed."""
    steps = 12_000
    env = TwoLinkArmEnv(actuator=None, action="torque", parameter_error={"payload": 7.5}, duration=0.01 * steps)
    policy = controllers.make("rbf-adaptive", env, rate=150.0, forget=0.0)
    poses = []
    for k, (*_, after) in enumerate(loop(policy, env, steps)):
        if k > 8000 and k % 20 == 0:
            poses.append(env.truth.reference)
            state = after
    q = np.array(poses)
    learned = policy.learned(np.repeat(state.weights, len(q), axis=0), features(q, np.zeros_like(q), np.zeros_like(q)))
    missed = gravity_torque(env.truth.lumped, q) - gravity_torque(env.interface.nominal, q)
    error = np.sqrt(((learned - missed) ** 2).mean(axis=0) / (missed**2).mean(axis=0))
    assert error.max() < 0.15


def test_the_basis_is_normalised_and_periodic():
    """An angle's basis has length one, no seam at a full turn, and its largest at the nearest centre."""
    x = np.linspace(-7.0, 7.0, 101)
    np.testing.assert_allclose(np.linalg.norm(bumps(x), axis=-1), 1.0)
    np.testing.assert_allclose(bumps(x), bumps(x + 2 * np.pi), atol=1e-12)
    nearest = np.round(x / (2 * np.pi / NODES)).astype(int) % NODES
    np.testing.assert_array_equal(bumps(x).argmax(axis=-1), nearest)


# The Gaussian process.


def test_the_torque_has_the_mean_of_a_gaussian_process():
    """k' (K + s^2 I)^-1 y over all samples, kernel of random cosines and time (Rasmussen and Williams 2006, (2.25))."""
    env = TwoLinkArmEnv(parameter_error={"radius": 0.3}, actuator=None, action="torque", reference=EXCITING)
    policy = controllers.make("computed-torque-gp", env, memory=0.5, noise=0.2)
    frequencies, phases = policy.spectrum
    rows, targets, before, last = [], [np.zeros(2)], None, None
    for observation, _, torque, _ in loop(policy, env, 60):
        q, v = policy.read(observation, "position", "velocity")
        reference = observation[env.layout.reference[:6]]
        rows.append(np.cos(reference @ frequencies + phases) * np.sqrt(2 / len(phases)))
        if before is not None:
            model = inverse_dynamics(env.interface.nominal, q, 0.5 * (v + last), (v - last) / 0.01)
            targets.append((before - model) / policy.weight)
        z, before, last = np.array(rows), torque, v
        time = 0.01 * np.arange(len(z))
        kernel = SIGNAL**2 * z @ z.T * np.exp(-np.abs(time[:, None] - time) / 0.5)
        mean = kernel[-1] @ np.linalg.solve(kernel + 0.2**2 * np.eye(len(z)), np.array(targets))
        wanted = policy.acceleration(observation[None], q[None], v[None])[0]
        plain = inverse_dynamics(env.interface.nominal, q, v, wanted)
        np.testing.assert_allclose(torque, plain + policy.weight * mean, rtol=1e-6, atol=1e-6)


def test_it_learns_what_the_model_misses():
    """On a wrong arm behind a delayed drive, the error falls to a fraction of that of computed torque."""
    wrong = {"parameter_error": {"radius": 0.2}, "friction": {"viscous": 10.0}}
    late = {"actuator": {"delay_samples": 1, "lag": 0.01}}
    options = {"steps": 1400, "skip": 901, "lanes": 2, "reference": EXCITING, "duration": 15.0, **wrong, **late}
    plain, learned = (mean_error(f"computed-torque{law}@frequency=10", **options) for law in ("", "-gp"))
    assert learned < 0.4 * plain


# Iterative learning: the contraction of its theory, and the state that goes on from trial to trial.


W, GAIN, BANDWIDTH, DT = 10.0, 0.6, 20.0, 0.004

# The stretched arm without gravity stays where it is linear.
STILL = nominal(
    arm={"gravity": 0.0}, actuator=None, control_dt=DT, duration=4.0,
    reference={"kind": "array", "position": [[0, 0]] * 2, "velocity": [[0, 0]] * 2, "acceleration": [[0, 0]] * 2},
)  # fmt: skip


@pytest.mark.parametrize("frequency", [3.0, 10.0, 25.0])
def test_an_error_that_repeats_shrinks_by_the_factor_of_the_theory(frequency):
    """A disturbance d of one frequency [rad/s], in the middle of the trial, where no transient is left."""
    law = controllers.make("computed-torque-ilc", TwoLinkArmEnv(STILL, action="torque"))
    size = tuple(0.05 * law.stretched)
    disturbance = {"kind": "sine", "amplitude": size, "frequency": frequency / (2 * np.pi), "phase": 0.0}
    gains = {"frequency": W, "gain": GAIN, "bandwidth": BANDWIDTH}
    traces = rollout_trials("computed-torque-ilc", STILL.replace(disturbance=disturbance), [0], 3, gains)
    middle = slice(STILL.steps // 3, -STILL.steps // 6)
    sizes = [np.abs((trace.reference - trace.position)[middle, 0]).max(axis=0) for trace in traces]
    s, q = 1j * frequency, 2.0 ** (-0.5 * (frequency / BANDWIDTH) ** 2)
    t = (2 * W * s + W**2) / (s + W) ** 2
    # u_2 = Q gain T d, u_3 = Q (u_2 + gain T (d - u_2))
    left = [1.0, abs(1 - q * GAIN * t), abs(1 - q * GAIN * t * (1 + q * (1 - GAIN * t)))]
    np.testing.assert_allclose(np.array(sizes) / sizes[0], np.outer(left, [1, 1]), atol=0.03)


def test_the_first_trial_is_computed_torque_and_later_ones_err_less_on_the_hardware():
    arm = CLASSES["servo"].arm
    scenario = tier_scenario("servo-practice-friction-3", arm).replace(duration=4.0)
    seeds = range(10_000, 10_004)
    first, *_, last = rollout_trials("computed-torque-ilc", scenario, seeds, 5)
    np.testing.assert_array_equal(first.torque, rollout("computed-torque@frequency=10", scenario, seeds).torque)
    errors = [np.abs(trace.reference - trace.position)[100:].mean(axis=(0, 2)) for trace in (first, last)]
    assert last.alive.all()
    assert (errors[1] < 0.25 * errors[0]).all()


def learned(law, observation, steps, state=None, start=None):
    """Return the state of a trial's end, of which each observation is the same."""
    for _ in range(steps):
        (_, state), start = law.predict(observation, state, start), None
    return state


@pytest.fixture
def asked():
    """A law, and the observation of two arms that are away from their references."""
    env = TwoLinkArmVectorEnv(2)
    law = controllers.make("computed-torque-ilc", env)
    observation = env.reset(seed=0)[0]
    observation[:, law.interface.layout["position"]] += 0.1
    return law, observation


def test_it_forgets_a_trial_that_ended_early_and_another_motion(asked):
    law, observation = asked
    begins, state, fresh = np.array([True, True]), learned(law, observation, 20), law.predict(observation)[0]
    assert not np.allclose(law.predict(observation, state, begins)[0], fresh)
    short = learned(law, observation, 19, state, begins)
    np.testing.assert_array_equal(law.predict(observation, short, begins)[0], fresh)
    observation[1, law.interface.layout["reference_position"]] += 0.1
    actions, alone = law.predict(observation, state, begins)[0], law.predict(observation)[0]
    np.testing.assert_array_equal(actions[1], alone[1])
    assert not np.allclose(actions[0], alone[0])


def test_the_lengths_of_other_lanes_trials_do_not_matter(asked):
    """Beyond its room, the state doubles for all lanes."""
    law, observation = asked
    both = learned(law, observation, 30)
    both = learned(law, observation, CAPACITY + 6, both, np.array([False, True]))
    alone = learned(law, observation[1], CAPACITY + 6, learned(law, observation[1], 30), np.array([True]))
    begins = np.array([False, True])
    for _ in range(3):
        actions, both = law.predict(observation, both, begins)
        action, alone = law.predict(observation[1], alone, begins[1:])
        np.testing.assert_array_equal(actions[1], action)
        begins = np.array([False, False])


def test_a_composed_law_learns_too():
    scenario = scenarios.get("servo-practice-nominal").replace(duration=2.0)
    first, second = rollout_trials("computed-torque-ilc+kalman+predictor", scenario, [10_000], 2)
    errors = [np.abs(trace.reference - trace.position)[50:].mean() for trace in (first, second)]
    assert errors[1] < 0.8 * errors[0]
