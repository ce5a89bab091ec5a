"""Joints that stick, slide and slip, against mechanics, closed forms and solutions between events."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from fbl_gym.model.arm import gravity_torque, inertia_matrix, inverse_dynamics
from tests.fbl_gym.episodes import BREAKAWAY, DRY, FLAT, STILL, flat, started, started_batch, truths_of


def path_of(**options):
    """Return positions [201 x 2] over four seconds without a command."""
    truths = truths_of(flat(control_dt=0.02, **options), [(0.0, 0.0)] * 200)
    return np.array([truth.position for truth in truths])


# A single joint has solutions in closed form; here a large friction locks joint 2.

LOCKED = {"coulomb": (20.0, 1e5), "stiction": (10.0, 0.0), "v_s": 1e-3}
ALONE = float(inertia_matrix(FLAT, (0.4, 0.7))[0, 0])


@pytest.mark.parametrize("h", [4e-4, 2e-3, 1e-2, 5e-2])
def test_a_coasting_joint_stops_after_v2_i_over_2f(h):
    """Under Coulomb friction alone it stops after v^2 I / (2 f), late by f h^2 / (8 I) at most."""
    coasting = {"kind": "sine", "centre": (0.4, 0.7), "amplitude": (0.5, 0.0), "frequency": 1 / math.pi}
    env = flat(reference=coasting, friction={"coulomb": (20.0, 1e5)}, control_dt=h, physics_dt=h)
    truth = env.truth
    assert truth.velocity.tolist() == [1.0, 0.0]
    while truth.velocity[0] != 0.0:
        env.step((0.0, 0.0))
        truth = env.truth
        assert truth.position[1] == 0.7
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
        path = path_of(friction=LOCKED, disturbance=disturbance, physics_dt=h)
        assert np.all(path[:, 1] == 0.7)
        errors.append(np.abs(path[:, 0] - right).max())
    ratios = np.divide(errors[:-1], errors[1:])
    assert np.all((ratios > 3.5) & (ratios < 4.5)), errors
    assert errors[2] < 2e-5


@pytest.mark.parametrize("h", [1e-4, 1e-3, 1e-2, 5e-2])
@pytest.mark.parametrize("load", [(0.999, 0.999), (-0.999, 0.5), (0.0, -0.999), (0.7, -0.999)])
def test_below_breakaway_not_one_bit_moves(h, load):
    env = flat(control_dt=h, physics_dt=h)
    before = env.truth.position
    for _ in range(200):
        env.step(np.array(load) * BREAKAWAY)
        truth = env.truth
        assert np.array_equal(truth.position, before)
        assert np.array_equal(truth.velocity, [0.0, 0.0])
        assert np.array_equal(truth.acceleration, [0.0, 0.0])
        np.testing.assert_allclose(truth.friction_torque, np.array(load) * BREAKAWAY, rtol=1e-12)


@pytest.mark.parametrize("h", [1e-4, 1e-3, 1e-2, 5e-2])
def test_a_changing_load_below_breakaway_moves_nothing(h):
    """Torques that swing to 99 % of breakaway and back, of either sign."""
    disturbance = {"kind": "sine", "amplitude": tuple(0.99 * BREAKAWAY), "frequency": (1.0, 1.7), "phase": (0.0, 1.0)}
    env = flat(disturbance=disturbance, control_dt=max(h, 1e-2), physics_dt=h)
    before = env.truth.position
    largest = np.zeros(2)
    for _ in range(round(2.0 / env.interface.control_dt)):
        env.step((0.0, 0.0))
        largest = np.maximum(largest, np.abs(env.truth.friction_torque))
        np.testing.assert_allclose(env.truth.friction_torque, -env.truth.disturbance, rtol=1e-12)
    assert np.array_equal(env.truth.position, before)
    assert np.all(largest > 0.9 * BREAKAWAY)


@pytest.mark.parametrize("h", [1e-4, 1e-3, 1e-2, 5e-2])
@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_a_load_just_above_breakaway_moves_a_joint(h, joint, direction):
    """A load 1e-4 above breakaway moves the joint in its direction, at any step size."""
    env = flat(control_dt=h, physics_dt=h)
    before = env.truth.position
    load = np.zeros(2)
    load[joint] = direction * 1.0001 * BREAKAWAY[joint]
    env.step(load)
    assert direction * (env.truth.position - before)[joint] > 0.0
    assert direction * env.truth.velocity[joint] > 0.0


def test_friction_holds_a_load_with_gravity():
    """With gravity the static load is the torque less G(q); within breakaway the arm does not move for 10 s."""
    env = started(action="torque", reference=STILL, friction=DRY)
    before = env.truth.position
    load = gravity_torque(env.interface.nominal, before) + np.array([25.0, -11.0])
    truths_of(env, [load] * 999)
    assert np.array_equal(env.truth.position, before)
    np.testing.assert_allclose(env.truth.friction_torque, (25.0, -11.0), rtol=1e-10)


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
