"""Joints that stick, against what mechanics says of them."""

import itertools
import math

import numpy as np
import pytest
from numba import njit
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, lsq_linear

from fbl_gym import ArmParameters, TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.arm import forward_dynamics, gravity_torque, inertia_matrix, inverse_dynamics
from fbl_gym.friction import dry_friction, resist

FLAT = ArmParameters(gravity=0.0)
STILL = {"kind": "minimum-jerk", "points": ((0.4, 0.7),)}
DRY = {"coulomb": (20.0, 8.0), "stiction": (10.0, 4.0), "v_s": 1e-3}
BREAKAWAY = np.array([30.0, 12.0])


def flat(**options):
    """An arm without gravity, at rest, under torques: a static load is just what one applies."""
    return TwoLinkArmEnv(arm=FLAT, action="torque", actuator=None, reference=STILL, friction=DRY, **options)


@njit
def solve(m, g, b, out):
    for i in range(len(m)):
        out[i] = resist(m[i, 0], m[i, 1], m[i, 2], g[i, 0], g[i, 1], b[i, 0], b[i, 1])


def test_nine_cases_solve_the_convex_problem():
    """Against SciPy's bounded least squares: the friction f in the box that leaves the least energy in M^-1/2 (g - f)."""
    rng = np.random.default_rng(0)
    n = 3000
    root = rng.normal(size=(n, 2, 2)) + 2 * np.eye(2)
    matrix = root @ root.transpose(0, 2, 1)
    m = np.stack([matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 1]], axis=1)
    g, b = rng.normal(size=(n, 2)) * 3, rng.uniform(0, 3, (n, 2))
    b[:100, 0], b[100:200, 1], g[200:300, 0] = 0.0, 0.0, b[200:300, 0]
    out = np.empty((n, 4))
    solve(m, g, b, out)
    cases = set()
    for i in range(n):
        w, f = out[i, :2], out[i, 2:]
        cases.add((np.sign(w[0]), np.sign(w[1])))
        np.testing.assert_allclose(matrix[i] @ w + f, g[i], atol=1e-9)
        whiten = np.linalg.inv(np.linalg.cholesky(matrix[i]))
        best = lsq_linear(whiten, whiten @ g[i], (-b[i] - 1e-12, b[i] + 1e-12), method="bvls", tol=1e-14).x
        np.testing.assert_allclose(f, best, atol=1e-6)
        # Complementarity: a joint that moves has its full friction, against the motion.
        for joint in (0, 1):
            assert abs(f[joint]) <= b[i, joint] + 1e-9
            if w[joint] != 0:
                assert f[joint] == pytest.approx(np.sign(w[joint]) * b[i, joint], abs=1e-9)
    assert len(cases) == 9


def problems(n, seed=0):
    """Random arms and postures, frictions over four decades, loads of about their size: m [n x 3], g and b [n x 2]."""
    rng = np.random.default_rng(seed)
    (m1, m2), (L1, L2) = rng.uniform(0.1, 30, (2, n)), 10 ** rng.uniform(-1, 1, (2, n))
    c2 = np.cos(rng.uniform(-np.pi, np.pi, n))
    m12 = m2 * L2**2 + m2 * L1 * L2 * c2
    m = np.stack([m1 * L1**2 + m2 * L1**2 + m2 * L1 * L2 * c2 + m12, m12, m2 * L2**2], axis=1)
    b = 10 ** rng.uniform(-2, 2, (n, 2))
    return m, 3 * b * rng.normal(size=(n, 2)), b


def cases_that_fit(m, g, b):
    """Each of the nine cases tried by itself: the velocity it gives [9 x n x 2], and whether that bears it out [9 x n]."""
    (m11, m12, m22), (g1, g2) = m.T, g.T
    velocities, fits = [], []
    for s1, s2 in itertools.product((-1, 0, 1), repeat=2):
        r1, r2 = g1 - s1 * b[:, 0], g2 - s2 * b[:, 1]
        if s1 and s2:
            determinant = m11 * m22 - m12**2
            w = np.stack([(m22 * r1 - m12 * r2) / determinant, (m11 * r2 - m12 * r1) / determinant], axis=1)
        else:
            w = np.stack([s1 * s1 * r1 / m11, s2 * s2 * r2 / m22], axis=1)
        f = np.stack([g1 - m11 * w[:, 0] - m12 * w[:, 1], g2 - m12 * w[:, 0] - m22 * w[:, 1]], axis=1)
        agrees = [w[:, i] * s > 0 if s else np.abs(f[:, i]) <= b[:, i] for i, s in enumerate((s1, s2))]
        velocities.append(w)
        fits.append(agrees[0] & agrees[1])
    return np.array(velocities), np.array(fits)


def test_just_one_of_the_nine_cases_fits_and_it_is_the_one():
    m, g, b = problems(50_000)
    velocities, fits = cases_that_fit(m, g, b)
    assert np.all(fits.sum(axis=0) == 1)
    assert np.all(fits.sum(axis=1) > 100)  # and every case comes up
    out = np.empty((len(m), 4))
    solve(m, g, b, out)
    right = velocities[fits.argmax(axis=0), np.arange(len(m))]
    assert np.array_equal(out[:, :2] == 0.0, right == 0.0)
    np.testing.assert_allclose(out[:, :2], right, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("joint", [0, 1])
def test_at_the_boundary_between_cases_nothing_jumps(joint):
    """The solution of a strictly convex problem depends continuously on its load.

    So a joint whose load is within a few roundings of what friction holds is at rest, to rounding, and the other slides
    or rests as if it were alone.
    """
    m, g, b = problems(50_000, seed=1)
    rng = np.random.default_rng(2)
    other = 1 - joint
    slide = np.sign(g[:, other]) * np.maximum(np.abs(g[:, other]) - b[:, other], 0.0) / m[:, 2 * other]
    edge = rng.choice([-1.0, 1.0], len(m)) * b[:, joint] + m[:, 1] * slide
    g[:, joint] = edge * (1 + rng.integers(-4, 5, len(m)) * 2.0**-53)
    out = np.empty((len(m), 4))
    solve(m, g, b, out)
    size = (np.abs(g) + b).sum(axis=1)
    spread = m[:, 0] * m[:, 2] / (m[:, 0] * m[:, 2] - m[:, 1] ** 2)
    tolerance = 1e-12 * spread[:, None] * size[:, None] / np.minimum(m[:, 0], m[:, 2])[:, None]
    right = np.zeros((len(m), 2))
    right[:, other] = slide
    wrong = np.any(np.abs(out[:, :2] - right) > tolerance, axis=1)
    assert not wrong.any(), (
        f"{wrong.sum()} of {len(m)}, such as {m[wrong][0]}, {g[wrong][0]}, {b[wrong][0]}: {out[wrong][0]}"
    )


def test_a_load_one_rounding_above_breakaway_hardly_moves():
    """30 and 12 N m hold the arm; a few parts in 1e16 more may not make it jump."""
    env = flat(control_dt=1e-3, physics_dt=1e-3)
    for i, j in itertools.product(range(1, 6), repeat=2):
        for s1, s2 in itertools.product((-1, 1), repeat=2):
            env.reset(seed=0)
            env.step((s1 * 30.0 * (1 + i * 2.0**-52), s2 * 12.0 * (1 + j * 2.0**-52)))
            assert np.abs(env.truth.velocity).max() < 1e-12, (s1, s2, i, j, env.truth.velocity)


@pytest.mark.parametrize("h", [1e-4, 1e-3, 1e-2, 5e-2])
@pytest.mark.parametrize("load", [(0.999, 0.999), (-0.999, 0.5), (0.0, -0.999), (0.7, -0.999)])
def test_below_breakaway_not_one_bit_moves(h, load):
    env = flat(control_dt=h, physics_dt=h, duration=200 * h)
    env.reset(seed=0)
    before = env.truth.position
    for _ in range(200):
        env.step(np.array(load) * BREAKAWAY)
        truth = env.truth
        assert np.array_equal(truth.position, before)
        assert np.array_equal(truth.velocity, [0.0, 0.0])
        assert np.array_equal(truth.acceleration, [0.0, 0.0])
        np.testing.assert_allclose(truth.friction_torque, np.array(load) * BREAKAWAY, rtol=1e-12)


@pytest.mark.parametrize("h", [1e-4, 1e-3, 1e-2, 5e-2])
@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_just_above_breakaway_it_moves(h, joint, direction):
    """A load a ten-thousandth above breakaway releases the joint, its way, at any step size."""
    env = flat(control_dt=h, physics_dt=h, duration=200 * h)
    env.reset(seed=0)
    before = env.truth.position
    load = np.zeros(2)
    load[joint] = direction * 1.0001 * BREAKAWAY[joint]
    env.step(load)
    assert direction * (env.truth.position - before)[joint] > 0.0
    assert direction * env.truth.velocity[joint] > 0.0


def test_a_hanging_load_holds_with_gravity():
    """With gravity the static load is the torque less G(q); within breakaway the arm stays put for 10 s."""
    env = TwoLinkArmEnv(action="torque", reference=STILL, friction=DRY)
    env.reset(seed=0)
    before = env.truth.position
    load = gravity_torque(env.nominal, before) + np.array([25.0, -11.0])
    for _ in range(999):
        env.step(load)
    assert np.array_equal(env.truth.position, before)
    np.testing.assert_allclose(env.truth.friction_torque, (25.0, -11.0), rtol=1e-10)


@pytest.mark.parametrize("slider", [0, 1])
def test_one_joint_slides_while_the_other_sticks(slider):
    """The stuck one does not move by one bit; the slider moves as if the other were welded: its own M_ii alone."""
    env = flat(duration=2.0)
    env.reset(seed=0)
    before, load = env.truth.position, np.zeros(2)
    load[slider] = BREAKAWAY[slider] * 1.15
    for _ in range(5):
        env.step(load)
        truth = env.truth
        assert truth.position[1 - slider] == before[1 - slider]
        assert truth.velocity[1 - slider] == 0.0
        assert truth.velocity[slider] > 0.0
        coulomb = truth.friction_torque[slider]
        own = inertia_matrix(FLAT, truth.position)[slider, slider]
        assert truth.acceleration[slider] == pytest.approx((load[slider] - coulomb) / own, rel=1e-9)


def test_friction_never_drives():
    """Random torques on many arms: friction takes power at every sample, and keeps within its bound."""
    env = TwoLinkArmVectorEnv(64, "stiction-3", action="torque")
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    stuck = 0
    for _ in range(500):
        env.step(rng.normal(size=(64, 2)) * (200.0, 60.0))
        truth = env.truth
        assert np.all(truth.friction_torque * truth.velocity >= 0.0)
        assert np.all(np.abs(truth.friction_torque) <= np.array([120.0, 40.0]) * (1 + 1e-12))
        stuck += (truth.velocity == 0.0).sum()
    assert stuck > 100


def test_a_thrown_arm_comes_to_rest_and_stays():
    env = flat(duration=5.0)
    env.reset(seed=0)
    for _ in range(20):
        env.step((80.0, 30.0))
    for _ in range(400):
        env.step((0.0, 0.0))
    rest = env.truth.position
    assert np.array_equal(env.truth.velocity, [0.0, 0.0])
    env.step((10.0, 3.0))
    assert np.array_equal(env.truth.position, rest)


def stick_slip(h):
    """A push and pull through breakaway and back, long enough to stick and slip several times."""
    push = {"kind": "sine", "amplitude": (40.0, 16.0), "frequency": (0.5, 0.4), "phase": (0.0, 1.5)}
    env = flat(disturbance=push, control_dt=0.02, physics_dt=h, duration=4.0)
    env.reset(seed=0)
    path = []
    for _ in range(200):
        env.step((0.0, 0.0))
        path.append(env.truth.position)
    return np.array(path)


def test_the_solution_converges_as_the_step_shrinks():
    """First order over a 500-fold range, on the whole: just when a joint lets go or stops makes single ratios uneven."""
    fine = stick_slip(2e-2 / 8192)
    steps = 0.02 / 5 / 2.0 ** np.arange(10)
    errors = [np.abs(stick_slip(h) - fine).max() for h in steps]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 0.8 < order < 1.2, (order, errors)
    assert errors[-1] < 3e-5
    assert np.ptp(fine, axis=0).min() > 0.05
    moves = {tuple(row) for row in (np.diff(fine, axis=0) != 0.0).tolist()}
    assert len(moves) == 4  # both stick, both slip, and each while the other does not


@pytest.mark.parametrize("v_s", [(1e-3, 2e-3), (0.5, 0.9)])
def test_the_literal_law_is_the_printed_formula(v_s):
    """Moving, equation (43) agrees with the exact solution to 1e-8; at the larger v_s all of its curve matters."""

    def printed(v):
        """f_i1 v + (f_i2 + f_s exp(-v^2 / v_s)) sign(v)."""
        return np.array([3.0, 1.0]) * v + (
            np.array([20.0, 8.0]) + (10.0, 4.0) * np.exp(-(v**2) / np.array(v_s))
        ) * np.sign(v)

    env = TwoLinkArmEnv(
        arm=FLAT, action="torque", actuator=None, reference={"kind": "sine", "amplitude": 1.0, "phase": (0.0, math.pi)},
        friction={**DRY, "viscous": (3.0, 1.0), "v_s": v_s, "law": "literal"}, physics_dt=5e-4,
    )  # fmt: skip
    env.reset(seed=0)
    torque = np.array([40.0, -40.0])
    state = np.concatenate([env.truth.position, env.truth.velocity])
    np.testing.assert_allclose(env.truth.friction_torque, printed(state[2:]), rtol=1e-12)

    def slope(_, x):
        return np.concatenate([x[2:], forward_dynamics(FLAT, x[:2], x[2:], torque - printed(x[2:]))])

    solved = solve_ivp(slope, (0.0, 1.0), state, method="DOP853", rtol=1e-12, atol=1e-13, dense_output=True)
    assert solved.y[2].min() > 0.1  # joint 1 turns one way throughout, joint 2 the other
    assert solved.y[3].max() < -0.1
    for k in range(1, 101):
        env.step(torque)
        truth, right = env.truth, solved.sol(0.01 * k)
        np.testing.assert_allclose(np.concatenate([truth.position, truth.velocity]), right, rtol=0, atol=1e-8)
        np.testing.assert_allclose(truth.friction_torque, printed(truth.velocity), rtol=1e-12)


def test_the_literal_law_has_no_friction_at_rest():
    """sign(0) = 0: the arm starts under any load at all with the acceleration of an arm without friction."""
    env = TwoLinkArmEnv(
        arm=FLAT, action="torque", actuator=None, reference=STILL, friction={**DRY, "law": "literal"},
        disturbance={"kind": "array", "torque": ((-6.0, 2.0),)},
    )  # fmt: skip
    env.reset(seed=0)
    free = forward_dynamics(FLAT, (0.4, 0.7), (0.0, 0.0), (6.0, -2.0))
    np.testing.assert_allclose(env.truth.acceleration, free, rtol=1e-12)
    assert env.truth.friction_torque.tolist() == [0.0, 0.0]


def test_under_the_literal_law_nothing_sticks():
    """The same load below breakaway moves the arm under the printed formula, and not under the exact rule."""
    moved = {}
    for law in ("literal", "exact"):
        env = TwoLinkArmEnv(arm=FLAT, action="torque", actuator=None, reference=STILL, friction={**DRY, "law": law})
        env.reset(seed=0)
        start = env.truth.position
        for _ in range(500):
            env.step(0.9 * BREAKAWAY)
        moved[law] = np.abs(env.truth.position - start).max()
    assert moved["exact"] == 0.0
    assert moved["literal"] > 1e-4


def test_the_friction_curve():
    assert dry_friction(0.0, 3.0, 2.0, 1e-3) == 5.0
    assert dry_friction(0.1, 3.0, 2.0, 1e-2) == pytest.approx(3.0 + 2.0 * np.exp(-1.0))
    assert dry_friction(-0.1, 3.0, 2.0, 1e-2) == dry_friction(0.1, 3.0, 2.0, 1e-2)


def test_friction_balances_equation_1():
    """M a + C v + G + F + tau_d = tau at every sample of a rough motion, whether joints slide, stick, or one does each."""
    env = TwoLinkArmVectorEnv(
        64, "stiction-2", action="torque", disturbance={"kind": "sine", "amplitude": (30.0, 10.0)}
    )
    env.reset(seed=0)
    rng, seen = np.random.default_rng(0), set()
    for _ in range(300):
        env.step(rng.normal(size=(64, 2)) * (100.0, 30.0))
        truth = env.truth
        motion = inverse_dynamics(truth.lumped, truth.position, truth.velocity, truth.acceleration)
        np.testing.assert_allclose(truth.friction_torque, truth.applied_torque - truth.disturbance - motion, atol=1e-9)
        held = (truth.velocity == 0.0) & (truth.acceleration == 0.0)
        seen |= {tuple(lane) for lane in held.tolist()}
    assert len(seen) == 4


# One joint at a time has solutions of its own: here friction that nothing overcomes locks joint 2.

LOCKED = {"coulomb": (20.0, 1e5), "stiction": (10.0, 0.0), "v_s": 1e-3}
ALONE = float(inertia_matrix(FLAT, (0.4, 0.7))[0, 0])


@pytest.mark.parametrize("h", [1e-4, 1e-3, 1e-2, 5e-2])
def test_a_coasting_joint_stops_where_mechanics_says(h):
    """Under Coulomb friction alone it stops after v^2 I / (2 f). The step in which it stops adds at most f h^2 / (8 I)."""
    coasting = {"kind": "sine", "centre": (0.4, 0.7), "amplitude": (0.5, 0.0), "frequency": 1 / math.pi}
    friction = {"coulomb": (20.0, 1e5)}
    env = TwoLinkArmEnv(
        arm=FLAT, action="torque", actuator=None, reference=coasting, friction=friction, control_dt=h, physics_dt=h
    )
    env.reset(seed=0)
    assert env.truth.velocity.tolist() == [1.0, 0.0]
    while env.truth.velocity[0] != 0.0:
        env.step((0.0, 0.0))
        assert env.truth.position[1] == 0.7
    stop, late = 0.4 + ALONE / (2 * 20.0), 20.0 * h**2 / (8 * ALONE)
    assert abs(env.truth.time - ALONE / 20.0) <= h * (1 + 1e-9)
    assert -1e-11 <= env.truth.position[0] - stop <= late + 1e-11
    rest = env.truth.position
    for _ in range(20):
        env.step((19.0, 0.0))
    assert np.array_equal(env.truth.position, rest)


@pytest.mark.parametrize("phase", [0.0, 0.5])
def test_a_joint_without_dry_friction_is_never_held(phase):
    """Whatever the other joint's friction: its motion is the smooth one, also where it starts at rest under no load."""
    push = {"kind": "sine", "amplitude": (45.0, 0.0), "frequency": 1.0, "phase": (phase, 0.0)}
    env = TwoLinkArmEnv(
        arm=FLAT, action="torque", actuator=None, reference=STILL, friction={"coulomb": (0.0, 1e5)}, disturbance=push
    )
    env.reset(seed=0)
    for _ in range(100):
        env.step((0.0, 0.0))
    w, t, a = 2 * math.pi, 1.0, -45.0 / ALONE
    velocity = a * (math.cos(phase) - math.cos(w * t + phase)) / w
    way = a * (math.cos(phase) * t - (math.sin(w * t + phase) - math.sin(phase)) / w) / w
    assert env.truth.velocity[0] == pytest.approx(velocity, abs=1e-9)
    assert env.truth.position[0] == pytest.approx(0.4 + way, abs=1e-9)


def slip_by_events(times):
    """The position of joint 1 alone under -45 sin(pi t) N m, from rest: phases that stick and slip, each solved by itself."""

    def load(t):
        return -45.0 * math.sin(math.pi * t)

    def slope(t, x, way):
        return x[1], (load(t) - way * (20.0 + 10.0 * math.exp(-(x[1] ** 2) / 1e-3))) / ALONE

    def stops(t, x, way):
        return way * x[1] if t > start + 1e-6 else 1.0

    stops.terminal = True
    path, t, q, last = np.full(len(times), np.nan), 0.0, 0.4, times[-1]
    while t < last:
        grid = np.linspace(t, last, 20_001)
        above = np.abs(45.0 * np.sin(np.pi * grid)) > 30.000000001
        start = last
        if above.any():
            i = int(above.argmax())
            start = brentq(lambda s: abs(load(s)) - 30.000000001, grid[i - 1], grid[i], xtol=1e-14) if i else t
        path[(times >= t) & (times <= start)] = q
        if start >= last:
            break
        way = math.copysign(1.0, load(start + 1e-9))
        phase = solve_ivp(
            slope,
            (start, last),
            (q, 0.0),
            "DOP853",
            args=(way,),
            rtol=1e-11,
            atol=1e-13,
            events=stops,
            dense_output=True,
        )
        t, q = phase.t[-1], phase.y[0, -1]
        inside = (times > start) & (times <= t)
        path[inside] = phase.sol(times[inside])[0]
    return path


def test_stick_and_slip_are_those_of_an_event_driven_solution():
    """Release, slip, stop and hold, four times over: the error is first order in the step, and small."""
    push = {"kind": "sine", "amplitude": (45.0, 0.0), "frequency": 0.5, "phase": 0.0}
    times = 0.02 * np.arange(201)
    right, errors = slip_by_events(times), []
    assert np.abs(np.diff(right)).max() > 0.005
    for h in (1e-3, 2.5e-4, 6.25e-5):
        env = TwoLinkArmEnv(
            arm=FLAT, action="torque", actuator=None, reference=STILL, friction=LOCKED, disturbance=push,
            control_dt=0.02, physics_dt=h,
        )  # fmt: skip
        env.reset(seed=0)
        path = [env.truth.position]
        for _ in times[1:]:
            env.step((0.0, 0.0))
            path.append(env.truth.position)
        assert np.all(np.array(path)[:, 1] == 0.7)
        errors.append(np.abs(np.array(path)[:, 0] - right).max())
    ratios = np.divide(errors[:-1], errors[1:])
    assert np.all((ratios > 3.5) & (ratios < 4.5)), errors
    assert errors[2] < 2e-5


@pytest.mark.parametrize("h", [1e-4, 1e-3, 1e-2, 5e-2])
def test_a_changing_load_below_breakaway_moves_nothing(h):
    """Torques that swing to 99 % of breakaway and back, of either sign."""
    push = {"kind": "sine", "amplitude": tuple(0.99 * BREAKAWAY), "frequency": (1.0, 1.7), "phase": (0.0, 1.0)}
    env = flat(disturbance=push, control_dt=max(h, 1e-2), physics_dt=h, duration=2.0)
    env.reset(seed=0)
    before = env.truth.position
    largest = np.zeros(2)
    for _ in range(round(2.0 / env.control_dt)):
        env.step((0.0, 0.0))
        largest = np.maximum(largest, np.abs(env.truth.friction_torque))
        np.testing.assert_allclose(env.truth.friction_torque, -env.truth.disturbance, rtol=1e-12)
    assert np.array_equal(env.truth.position, before)
    assert np.all(largest > 0.9 * BREAKAWAY)
