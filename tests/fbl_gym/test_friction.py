"""Friction: each law against mechanics, closed forms and solvers; joints that stick, slide and slip."""

import math

import numpy as np
import pytest
from numba import njit
from scipy.integrate import solve_ivp
from scipy.optimize import lsq_linear

from fbl_gym.kernel.arm.friction import resist
from fbl_gym.model.arm import forward_dynamics, inertia_matrix, inverse_dynamics
from tests.fbl_gym.episodes import BREAKAWAY, DRY, FLAT, flat, started_batch, truths_of, watch


@njit
def solved(m, g, b):
    out = np.empty((len(m), 4))
    for i in range(len(m)):
        out[i] = resist(m[i, 0], m[i, 1], m[i, 2], g[i, 0], g[i, 1], b[i, 0], b[i, 1])
    return out


def test_nine_cases_solve_the_convex_problem():
    """SciPy's bounded least squares gives the friction f in the box with the least energy in M^-1/2 (g - f)."""
    rng = np.random.default_rng(0)
    n = 200
    root = rng.normal(size=(n, 2, 2)) + 2 * np.eye(2)
    matrix = root @ root.transpose(0, 2, 1)
    m = np.stack([matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 1]], axis=1)
    g, b = rng.normal(size=(n, 2)) * 3, rng.uniform(0, 3, (n, 2))
    b[:20, 0], b[20:40, 1], g[40:60, 0] = 0.0, 0.0, b[40:60, 0]
    w, f = np.split(solved(m, g, b), 2, axis=1)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", matrix, w) + f, g, atol=1e-9)
    for i in range(n):
        whiten = np.linalg.inv(np.linalg.cholesky(matrix[i]))
        best = lsq_linear(whiten, whiten @ g[i], (-b[i] - 1e-12, b[i] + 1e-12), method="bvls", tol=1e-14).x
        np.testing.assert_allclose(f[i], best, atol=1e-6)
    # Complementarity: a joint that moves has its full friction, against the motion.
    assert np.all(np.abs(f) <= b + 1e-9)
    np.testing.assert_allclose(f[w != 0.0], (np.sign(w) * b)[w != 0.0], atol=1e-9)
    assert len(np.unique(np.sign(w), axis=0)) == 9


def problems(n):
    """Return random inertias m [n x 3], loads g [n x 2] and friction bounds b [n x 2] over four decades."""
    rng = np.random.default_rng(1)
    (m1, m2), (L1, L2) = rng.uniform(0.1, 30, (2, n)), 10 ** rng.uniform(-1, 1, (2, n))
    c2 = np.cos(rng.uniform(-np.pi, np.pi, n))
    m12 = m2 * L2**2 + m2 * L1 * L2 * c2
    m = np.stack([m1 * L1**2 + m2 * L1**2 + m2 * L1 * L2 * c2 + m12, m12, m2 * L2**2], axis=1)
    b = 10 ** rng.uniform(-2, 2, (n, 2))
    return m, 3 * b * rng.normal(size=(n, 2)), b


@pytest.mark.parametrize("joint", [0, 1])
def test_the_solution_is_continuous_between_cases(joint):
    """The solution of a strictly convex problem depends continuously on its load.

    A joint whose load is within a few roundings of its friction bound is at rest, to rounding. The other
    slides or rests as if it were alone.
    """
    (m, g, b), rng, other = problems(50_000), np.random.default_rng(2), 1 - joint
    slide = np.sign(g[:, other]) * np.maximum(np.abs(g[:, other]) - b[:, other], 0.0) / m[:, 2 * other]
    edge = rng.choice([-1.0, 1.0], len(m)) * b[:, joint] + m[:, 1] * slide
    g[:, joint] = edge * (1 + rng.integers(-4, 5, len(m)) * 2.0**-53)
    rates = solved(m, g, b)[:, :2]
    determinant = m[:, 0] * m[:, 2] - m[:, 1] ** 2
    tolerance = 1e-12 * np.maximum(m[:, 0], m[:, 2]) / determinant * (np.abs(g) + b).sum(axis=1)
    assert np.all(np.abs(rates[:, joint]) <= tolerance)
    assert np.all(np.abs(rates[:, other] - slide) <= tolerance)


@pytest.mark.parametrize("v_s", [(1e-3, 2e-3), (0.5, 0.9)])
def test_the_literal_law_is_the_printed_formula(v_s):
    """A motion under equation (43) agrees with the solver to 1e-8; the larger v_s tests all of the curve."""

    def printed(v):
        """Return f_i1 v + (f_i2 + f_s exp(-v^2 / v_s)) sign(v)."""
        dry = np.array([20.0, 8.0]) + (10.0, 4.0) * np.exp(-(v**2) / np.array(v_s))
        return np.array([3.0, 1.0]) * v + dry * np.sign(v)

    turning = {"kind": "sine", "amplitude": 1.0, "phase": (0.0, math.pi)}
    friction = {**DRY, "viscous": (3.0, 1.0), "v_s": v_s, "law": "literal"}
    env = flat(reference=turning, friction=friction, physics_dt=5e-4)
    torque = np.array([40.0, -40.0])
    state = np.concatenate([env.truth.position, env.truth.velocity])

    def slope(_, x):
        return np.concatenate([x[2:], forward_dynamics(FLAT, x[:2], x[2:], torque - printed(x[2:]))])

    solution = solve_ivp(slope, (0.0, 1.0), state, method="DOP853", rtol=1e-12, atol=1e-13, dense_output=True)
    assert solution.y[2].min() > 0.1  # joint 1 turns one way throughout, joint 2 the other
    assert solution.y[3].max() < -0.1
    for k, truth in enumerate(truths_of(env, [torque] * 100)):
        np.testing.assert_allclose([*truth.position, *truth.velocity], solution.sol(0.01 * k), rtol=0, atol=1e-8)
        np.testing.assert_allclose(truth.friction_torque, printed(truth.velocity), rtol=1e-12)


def test_the_literal_law_has_no_friction_at_rest():
    """sign(0) = 0: under any load, the arm starts with the acceleration of an arm without friction."""
    env = flat(friction={**DRY, "law": "literal"}, disturbance={"kind": "array", "torque": ((-6.0, 2.0),)})
    free = forward_dynamics(FLAT, (0.4, 0.7), (0.0, 0.0), (6.0, -2.0))
    np.testing.assert_allclose(env.truth.acceleration, free, rtol=1e-12)
    assert env.truth.friction_torque.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("law", ["exact", "literal"])
def test_a_loaded_gear_has_friction_by_its_drives_torque(law):
    torque, applied, velocity = watch(
        "friction_torque", "applied_torque", "velocity",
        torque=(120.0, 60.0), friction={"coulomb": 3.0, "load": (0.1, 0.2), "law": law},
    )  # fmt: skip
    moving = np.abs(velocity) > 1e-9
    expected = np.sign(velocity) * (3.0 + np.array([0.1, 0.2]) * np.abs(applied))
    assert moving.mean() > 0.7
    np.testing.assert_allclose(torque[moving], expected[moving], rtol=1e-9)


def test_a_loaded_elastic_joint_moves_as_one_with_that_coulomb_friction():
    """Under a held torque, 10 % of it are 12 and 6 N m more of Coulomb friction."""
    joint = {"stiffness": 5000.0, "damping": 5.0, "rotor_inertia": 0.5}
    given = [{"coulomb": 3.0, "load": 0.1}, {"coulomb": (15.0, 9.0)}]
    ours, theirs = (watch("position", "motor_position", torque=(120.0, 60.0), joint=joint, friction=f) for f in given)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)


def test_a_loaded_gear_agrees_with_mujoco():
    """MuJoCo's dry friction is another model of sticking; sliding is the same."""
    pytest.importorskip("mujoco")
    friction = {"coulomb": 3.0, "load": (0.1, 0.2)}
    ours, theirs = (watch("position", torque=(160.0, 90.0), friction=friction, plant=x)[0] for x in (None, "mujoco"))
    (without,) = watch("position", torque=(160.0, 90.0), friction={"coulomb": 3.0})
    assert np.abs(ours - theirs).max() < 0.01 * np.abs(ours - without).max()


# A single joint has solutions in closed form; here a large friction locks joint 2.

LOCKED = {"coulomb": (20.0, 1e5), "stiction": (10.0, 0.0), "v_s": 1e-3}
ALONE = float(inertia_matrix(FLAT, (0.4, 0.7))[0, 0])


@pytest.mark.parametrize("h", [4e-4, 2e-3, 1e-2, 5e-2])
def test_a_coasting_joint_stops_after_v2_i_over_2f(h):
    """Under Coulomb friction alone it stops after v^2 I / (2 f), late by f h^2 / (8 I) at most."""
    coasting = {"kind": "sine", "centre": (0.4, 0.7), "amplitude": (0.5, 0.0), "frequency": 1 / math.pi}
    env = flat(reference=coasting, friction={"coulomb": (20.0, 1e5)}, control_dt=h, physics_dt=h)
    assert env.truth.velocity.tolist() == [1.0, 0.0]
    while env.truth.velocity[0] != 0.0:
        env.step((0.0, 0.0))
        assert env.truth.position[1] == 0.7
    stop, late = 0.4 + ALONE / (2 * 20.0), 20.0 * h**2 / (8 * ALONE)
    assert abs(env.truth.time - ALONE / 20.0) <= h * (1 + 1e-9)
    assert -1e-11 <= env.truth.position[0] - stop <= late + 1e-11
    rest, *_, later = truths_of(env, [(19.0, 0.0)] * 20)
    assert np.array_equal(later.position, rest.position)


@pytest.mark.parametrize("phase", [0.0, 0.5])
def test_a_joint_without_dry_friction_is_never_held(phase):
    """Its motion is smooth under any friction of the other joint, also from rest without a load."""
    disturbance = {"kind": "sine", "amplitude": (45.0, 0.0), "frequency": 1.0, "phase": (phase, 0.0)}
    truth = truths_of(flat(friction={"coulomb": (0.0, 1e5)}, disturbance=disturbance), [(0.0, 0.0)] * 100)[-1]
    w, t, a = 2 * math.pi, 1.0, -45.0 / ALONE
    velocity = a * (math.cos(phase) - math.cos(w * t + phase)) / w
    way = a * (math.cos(phase) * t - (math.sin(w * t + phase) - math.sin(phase)) / w) / w
    assert truth.velocity[0] == pytest.approx(velocity, abs=1e-9)
    assert truth.position[0] == pytest.approx(0.4 + way, abs=1e-9)


def slip_by_events(times):
    """Return joint 1's position under -45 sin(pi t) N m from rest, each phase of stick or slip solved alone."""
    release = math.asin(30.000000001 / 45.0) / math.pi  # after each zero of the load

    def load(t):
        return -45.0 * math.sin(math.pi * t)

    def slope(t, x, way):
        return x[1], (load(t) - way * (20.0 + 10.0 * math.exp(-(x[1] ** 2) / 1e-3))) / ALONE

    def stops(t, x, way):
        return way * x[1] if t > start + 1e-6 else 1.0

    stops.terminal = True
    path, t, q, last = np.full(len(times), np.nan), 0.0, 0.4, times[-1]
    while t < last:
        start = min(t if release < t % 1.0 < 1.0 - release else math.floor(t + release) + release, last)
        path[(times >= t) & (times <= start)] = q
        if start >= last:
            break
        way = math.copysign(1.0, load(start + 1e-9))
        phase = solve_ivp(
            slope, (start, last), (q, 0.0), "DOP853", args=(way,), rtol=1e-11, atol=1e-13, events=stops, dense_output=True
        )  # fmt: skip
        t, q = phase.t[-1], phase.y[0, -1]
        inside = (times > start) & (times <= t)
        path[inside] = phase.sol(times[inside])[0]
    return path


def test_stick_and_slip_agree_with_an_event_driven_solution():
    """Release, slip, stop and hold, four times over: the error is first order in the step, and small."""
    disturbance = {"kind": "sine", "amplitude": (45.0, 0.0), "frequency": 0.5, "phase": 0.0}
    times = 0.02 * np.arange(201)
    right, errors = slip_by_events(times), []
    assert np.abs(np.diff(right)).max() > 0.005
    for h in (1e-3, 2.5e-4, 6.25e-5):
        env = flat(friction=LOCKED, disturbance=disturbance, control_dt=0.02, physics_dt=h)
        path = np.array([truth.position for truth in truths_of(env, [(0.0, 0.0)] * 200)])
        assert np.all(path[:, 1] == 0.7)
        errors.append(np.abs(path[:, 0] - right).max())
    ratios = np.divide(errors[:-1], errors[1:])
    assert np.all((ratios > 3.5) & (ratios < 4.5)), errors
    assert errors[2] < 2e-5


@pytest.mark.parametrize("h", [1e-4, 1e-3, 1e-2, 5e-2])
@pytest.mark.parametrize("load", [(0.999, 0.999), (-0.999, 0.5), (0.0, -0.999), (0.7, -0.999), None])
def test_below_breakaway_not_one_bit_moves(h, load):
    """Under constant torques, and under ones that swing to 99 % of breakaway and back, of either sign."""
    swing = {"kind": "sine", "amplitude": tuple(0.99 * BREAKAWAY), "frequency": (1.0, 1.7), "phase": (0.0, 1.0)}
    env = flat(disturbance=None if load else swing, control_dt=max(h, 1e-2), physics_dt=h)
    before, torque, largest = env.truth.position, np.array(load or (0.0, 0.0)) * BREAKAWAY, np.zeros(2)
    for _ in range(200):
        env.step(torque)
        truth = env.truth
        assert not np.any([truth.position - before, truth.velocity, truth.acceleration])
        np.testing.assert_allclose(truth.friction_torque, torque - truth.disturbance, rtol=1e-12)
        largest = np.maximum(largest, np.abs(truth.friction_torque))
    assert load or np.all(largest > 0.9 * BREAKAWAY)


@pytest.mark.parametrize("h", [1e-4, 1e-3, 1e-2, 5e-2])
@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_a_load_just_above_breakaway_moves_a_joint(h, joint, direction):
    """A load 1e-4 above breakaway moves the joint in its direction, at any step size."""
    before, after = truths_of(flat(control_dt=h, physics_dt=h), [direction * 1.0001 * BREAKAWAY * np.eye(2)[joint]])
    assert direction * (after.position - before.position)[joint] > 0.0
    assert direction * after.velocity[joint] > 0.0


def test_friction_balances_equation_1():
    """M a + C v + G + F + tau_d = tau at every sample, with both joints sliding, both stuck, or one of each.

    Friction never adds power.
    """
    disturbance = {"kind": "sine", "amplitude": (30.0, 10.0)}
    env = started_batch(64, "stiction-2", action="torque", disturbance=disturbance)
    rng, seen = np.random.default_rng(0), set()
    for _ in range(300):
        env.step(rng.normal(size=(64, 2)) * (100.0, 30.0))
        truth = env.truth
        motion = inverse_dynamics(truth.lumped, truth.position, truth.velocity, truth.acceleration)
        np.testing.assert_allclose(truth.friction_torque, truth.applied_torque - truth.disturbance - motion, atol=1e-9)
        assert np.all(truth.friction_torque * truth.velocity >= 0.0)
        held = (truth.velocity == 0.0) & (truth.acceleration == 0.0)
        seen |= {tuple(lane) for lane in held.tolist()}
    assert len(seen) == 4
