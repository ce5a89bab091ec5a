"""Elastic joints and links that bend, against an ODE solver and the rigid arm; sticking, backlash, encoders, events.

`test_mujoco.py` has MuJoCo's.
"""

import re

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import root

from fbl_gym import TABLE_1, ArmParameters, TwoLinkArmEnv
from fbl_gym.model.arm import forward_dynamics, inertia_matrix, inverse_dynamics
from fbl_gym.model.chain import HINGE, chain_dynamics, segment_terms
from fbl_gym.options import ElasticJoint, FlexibleLink
from fbl_gym.options.link import fastest_rate, straight_chain
from tests.fbl_gym.episodes import started, truths_of

K, D, B = np.array([4000.0, 1500.0]), np.array([6.0, 2.0]), np.array([0.6, 0.3])
JOINT = {"stiffness": tuple(K), "damping": tuple(D), "rotor_inertia": tuple(B)}
HELD = {"kind": "sine", "amplitude": 0.0, "centre": (-1.2, 0.4)}
OPTIONS = {"action": "torque", "actuator": None, "reference": HELD, "limits": {"position": 1e3, "velocity": 1e4}}


def torque(k):
    return np.array([-60.0, -20.0]) + np.array([90.0, 30.0]) * np.sin([0.21 * k, 0.3 * k])


def run(steps, **options):
    """Return the truths of a run under `torque`."""
    return truths_of(started(**{**OPTIONS, "joint": JOINT, **options}), map(torque, range(steps)))


def state(truth):
    return np.concatenate([truth.position, truth.motor_position, truth.velocity, truth.motor_velocity])


def slope(x, tau, arm=TABLE_1, load=0.0, viscous=0.0, gap=0.0):
    """Return the rate of a state, with half the backlash `gap`."""
    q, th, v, w = x.reshape(4, 2)
    stretch = th - q
    touching = np.abs(stretch) >= gap
    spring = K * (stretch - np.clip(stretch, -gap, gap)) + np.where(touching, D * (w - v), 0.0)
    spring = np.where((gap > 0.0) & (spring * stretch < 0.0), 0.0, spring)  # teeth push and never pull
    return np.concatenate([v, w, forward_dynamics(arm, q, v, spring - load), (tau - spring - viscous * w) / B])


def solve(start, steps, slope=slope, disturbance=lambda t: 0.0, tolerance=1e-12, **options):
    """Return the states of the solver at the control steps."""
    path = [start]
    for k in range(steps):
        rate = lambda t, x, k=k: slope(x, torque(k), load=disturbance(t), **options)
        done = solve_ivp(rate, (0.01 * k, 0.01 * k + 0.01), path[-1], method="DOP853", rtol=tolerance, atol=tolerance)
        path.append(done.y[:, -1])
    return np.array(path)


LOADED = {
    "physics_dt": 2.5e-4, "friction": {"viscous": 3.0},
    "disturbance": {"kind": "sine", "amplitude": (20.0, 8.0), "frequency": (1.5, 2.5), "phase": (0.3, 1.0)},
}  # fmt: skip


def loads(t):
    """Return the disturbance of `LOADED`."""
    return np.array([20.0, 8.0]) * np.sin(2 * np.pi * np.array([1.5, 2.5]) * t + (0.3, 1.0))


def test_a_motion_agrees_with_the_solver():
    """Two seconds with damping, viscous friction and a disturbance on the links, to 1e-7 in all eight states."""
    truths = run(200, **LOADED)
    ours = np.array([state(truth) for truth in truths])
    theirs = solve(ours[0], 200, disturbance=loads, viscous=3.0)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-7)
    for k in (0, 50, 200):
        rate = slope(ours[k], truths[k].applied_torque, load=loads(0.01 * k), viscous=3.0)
        np.testing.assert_allclose(truths[k].acceleration, rate[4:6], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(truths[k].friction_torque, 3.0 * truths[k].motor_velocity, rtol=1e-12)


def test_the_error_falls_with_the_fourth_power_of_the_step():
    start = state(run(0)[0])
    exact = solve(start, 20)
    errors = [np.abs(state(run(20, physics_dt=h)[-1]) - exact[-1]).max() for h in (1e-3, 5e-4)]
    assert 13 < errors[0] / errors[1] < 19


def test_backlash_agrees_with_the_solver():
    """The links swing through the gap several times; each contact costs the step some accuracy."""
    truths = run(100, physics_dt=1e-4, joint={**JOINT, "backlash": 0.02})
    np.testing.assert_array_equal(truths[0].backlash, 0.02)
    ours = np.array([state(truth) for truth in truths])
    theirs = solve(ours[0], 100, gap=0.01, tolerance=1e-10)
    np.testing.assert_allclose(ours[:, :4], theirs[:, :4], rtol=0, atol=6e-5)
    sides = np.sign(np.round((ours[:, 2:4] - ours[:, :2]) / 0.009999))
    assert np.all(np.ptp(sides, axis=0) == 2)  # both joints touch both sides


@pytest.mark.parametrize("damping", [0.0, 5.0, 15.0, 200.0])
def test_teeth_push_and_never_pull(damping):
    """Over many contacts, the joints' torque is that of the printed law, also where the damper exceeds the spring."""
    k, gap = 2000.0, 0.01
    joint = {"stiffness": k, "damping": damping, "backlash": 2 * gap, "rotor_inertia": 1.0}
    env = started(action="torque", actuator=None, arm={"gravity": 0.0}, joint=joint, duration=2.0, physics_dt=2.5e-4)
    cut = 0
    for truth in truths_of(env, [np.array([150.0, 60.0]) * np.sin(0.09 * i) for i in range(200)])[1:]:
        x, rate = truth.motor_position - truth.position, truth.motor_velocity - truth.velocity
        law = np.where(np.abs(x) >= gap, k * np.sign(x) * (np.abs(x) - gap) + damping * rate, 0.0)
        cut += np.count_nonzero(law * x < 0.0)
        torque = inverse_dynamics(truth.lumped, truth.position, truth.velocity, truth.acceleration)
        np.testing.assert_allclose(torque, np.where(law * x < 0.0, 0.0, law), atol=1e-9)
    assert (cut > 0) == (damping > 0.0)


def test_a_motor_sticks_while_its_link_swings():
    """Below breakaway the motor does not move by one bit; above, it slides. The link swings on its spring."""
    friction = {"coulomb": 5.0, "stiction": 5.0}
    options = OPTIONS | {"arm": {"gravity": 0.0}, "joint": {**JOINT, "damping": 0.0}, "control_dt": 1e-3}
    env = started(**options, friction=friction)
    first, *truths = truths_of(env, [(9.99, -9.99)] * 100)
    assert not np.any([[truth.motor_position - first.motor_position, truth.motor_velocity] for truth in truths])
    np.testing.assert_allclose([truth.friction_torque for truth in truths], [(9.99, -9.99)] * 100)
    env.step((10.01, -10.01))
    assert np.abs(env.truth.motor_velocity).min() > 0.0
    # With the drives off, links that start in motion swing, and the motors hold against the springs.
    moving = {"kind": "sine", "amplitude": 0.01, "frequency": 0.5, "centre": (-1.2, 0.4), "phase": 0.0}
    env = started(**options | {"reference": moving}, friction={"coulomb": 200.0})
    truths, names = truths_of(env, [(0.0, 0.0)] * 1001)[1:], ("position", "motor_position", "friction_torque")
    link, motor, torque = (np.array([getattr(truth, name) for truth in truths]) for name in names)
    np.testing.assert_allclose(torque, -K * (motor - link), atol=1e-12)
    assert np.ptp(motor, axis=0).max() == 0.0
    assert np.ptp(link, axis=0).min() > 1e-4


@pytest.mark.parametrize("side", ["motor", "link"])
def test_the_encoder_reads_its_side(side):
    env = TwoLinkArmEnv(**OPTIONS, joint={**JOINT, "encoder": side})
    observation, _ = env.reset(seed=0)
    for k in range(30):
        truth = env.truth
        q, v = (truth.motor_position, truth.motor_velocity) if side == "motor" else (truth.position, truth.velocity)
        np.testing.assert_array_equal(observation[:6], [*q, *v, *truth.acceleration])
        observation = env.step(torque(k))[0]
    assert np.abs(truth.motor_position - truth.position).min() > 1e-5


def test_an_arm_starts_on_its_reference_with_the_spring_under_the_holding_torque():
    (truth,) = run(0, joint={**JOINT, "backlash": 0.02})
    np.testing.assert_array_equal(truth.position, truth.reference)
    stretch = truth.motor_position - truth.position
    np.testing.assert_allclose(K * (stretch - 0.01 * np.sign(stretch)), truth.applied_torque, rtol=1e-9)
    np.testing.assert_allclose(truth.acceleration, 0.0, atol=1e-9)


def test_the_fastest_rate_is_the_textbooks():
    """A single joint on a heavy link has the rate sqrt(K (1/B + 1/M)); a strong damper has D (1/B + 1/M)."""
    arm = ArmParameters.from_links((50.0, 0.001), (1.0, 1.0), (1.0, 1.0), (0.0, 0.0))
    both = 1 / 0.5 + 1 / inertia_matrix(arm, (0.0, 0.0))[0, 0]
    soft, damped = ElasticJoint((800.0, 1e-6)), ElasticJoint((1e-3, 1e-6), damping=(100.0, 0.0))
    for joint, rate in ((soft, np.sqrt(800.0 * both)), (damped, 100.0 * both)):
        assert fastest_rate(arm, arm, (0.5, 1e3), (0.0, 0.0), joint, None) == pytest.approx(rate, rel=1e-3)


def test_a_frequency_is_that_of_a_joint_alone():
    """A knock on the second joint, with motors and first link held by their inertia."""
    arm = ArmParameters(m1=1e6, gravity=0.0)
    joint = {"frequency": (3.0, {"uniform": [8.0, 12.0]}), "rotor_inertia": 1e6}
    options = {"arm": arm, "reference": HELD, "actuator": {"torque_limit": 1e9}, "control_dt": 1e-3}
    options["events"] = [{"kind": "knock", "time": 0.0, "impulse": (0.0, 0.1)}]
    env = started(joint=joint, **options)
    inertia, (low, high) = inertia_matrix(arm, (0.0, 0.0)).diagonal(), np.array(env.interface.stiffness)
    np.testing.assert_allclose(low, inertia * (2 * np.pi * np.array([3.0, 8.0])) ** 2, rtol=1e-12)
    np.testing.assert_allclose(high, inertia * (2 * np.pi * np.array([3.0, 12.0])) ** 2, rtol=1e-12)
    assert np.all((low <= env.truth.stiffness) & (env.truth.stiffness <= high))
    rate = np.sqrt(env.truth.stiffness[1] / inertia[1])
    swing = np.array([truth.position[1] - 0.4 for truth in truths_of(env, np.zeros((300, 2)))])
    np.testing.assert_allclose(swing, 0.1 / inertia[1] / rate * np.sin(rate * 1e-3 * np.arange(301)), atol=1e-4)


def test_stribeck_friction_acts_on_the_motors():
    """A sliding motor has the friction of the formula; the step holds it as for rigid joints."""
    truths = run(40, friction={"coulomb": 4.0, "stiction": 3.0, "v_s": 0.25})[1:]
    w, torque = (np.array([getattr(x, name) for x in truths]) for name in ("motor_velocity", "friction_torque"))
    law = (4.0 + 3.0 * np.exp(-((w / 0.5) ** 2))) * np.sign(w)
    np.testing.assert_allclose(torque[w != 0.0], law[w != 0.0], rtol=1e-12)


# Links that bend.


ARM = ArmParameters(inertia=(0.08, 0.07), rotor=(0.5, 0.2))
LINK = {"frequency": (5.0, 8.0), "damping": (0.05, 0.03)}
SUMS = np.tril(np.ones((4, 4)))  # absolute angles from q1, b1, q2, b2


def bent_state(truth, joint=False):
    motors = (truth.motor_position, truth.motor_velocity) if joint else ()
    return np.concatenate([truth.position, truth.bend, truth.velocity, truth.bend_velocity, *motors])


def chain(q, b, v, u, payload=0.0):
    """Return inertia and load of q1, b1, q2, b2, by the Lagrangian of the segments' absolute angles."""
    arm, reach = ARM, ARM.L2
    j, f = segment_terms(arm.m1, arm.m2, arm.L1, arm.L2, arm.centre, arm.inertia, payload, reach, 0.0)
    lengths = [HINGE * arm.L1, (1 - HINGE) * arm.L1, HINGE * arm.L2, 0.0]
    angle, rate = (SUMS @ np.ravel([x, y], order="F") for x, y in ((q, b), (v, u)))
    product = np.array([[lengths[min(k, i)] * f[max(k, i)] for i in range(4)] for k in range(4)])
    turn = angle[:, None] - angle
    inertia = np.where(np.eye(4) > 0, j, product * np.cos(turn))
    load = (product * np.sin(turn)) @ rate**2 + 9.81 * np.array(f) * np.cos(angle)
    return SUMS.T @ inertia @ SUMS, -SUMS.T @ load


def bent_slope(x, tau, load, viscous, joint):
    """Return the rate of a state."""
    q, b, v, u = x[:8].reshape(4, 2)
    inertia, forces = chain(q, b, v, u)
    beyond, rate = np.diag(straight_chain(ARM, 0.0)[0])[2:], 2 * np.pi * np.array(LINK["frequency"])
    forces[1::2] -= beyond * (rate**2 * b + 2 * np.array(LINK["damping"]) * rate * u)
    motors = []
    if joint:
        th, w = x[8:].reshape(2, 2)
        spring = K * (th - q) + D * (w - v)
        motors = [w, (tau - spring - viscous * w) / B]
        forces[::2] += spring - load
    else:
        inertia[[0, 2], [0, 2]] += ARM.rotor
        forces[::2] += tau - load - viscous * v
    a = np.linalg.solve(inertia, forces)
    return np.concatenate([v, u, a[::2], a[1::2], *motors])


@pytest.mark.parametrize("joint", [None, JOINT], ids=["rigid joints", "elastic joints"])
def test_a_motion_of_links_that_bend_agrees_with_the_solver(joint):
    """A second with damping, viscous friction and a disturbance on the links."""
    truths = run(100, arm=ARM, link=LINK, joint=joint, **LOADED)
    ours = np.array([bent_state(truth, joint) for truth in truths])
    theirs = solve(ours[0], 100, bent_slope, loads, viscous=3.0, joint=joint)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=2e-7)
    rate = bent_slope(theirs[-1], truths[-1].applied_torque, loads(1.0), 3.0, joint)
    np.testing.assert_allclose(truths[-1].acceleration, rate[4:6], rtol=1e-5)
    turns = truths[-1].motor_velocity if joint else truths[-1].velocity
    np.testing.assert_allclose(truths[-1].friction_torque, 3.0 * turns, rtol=1e-12)
    assert np.ptp([truth.bend for truth in truths], axis=0).min() > 0.005


def test_straight_links_have_the_inertia_of_the_arm():
    for q2 in (0.0, 1.0, 3.0):
        mine, load = straight_chain(ARM, q2)
        np.testing.assert_allclose(mine[:2, :2], inertia_matrix(ARM.lumped, (0.0, q2)), rtol=1e-12)
        theirs, torque = chain((0, q2), (0, 0), (0, 0), (0, 0))
        np.testing.assert_allclose(mine, theirs[np.ix_([0, 2, 1, 3], [0, 2, 1, 3])], rtol=1e-12)
        np.testing.assert_allclose(load, torque[[0, 2, 1, 3]], atol=1e-12)


def test_a_joint_sticks_while_its_link_swings():
    """Below breakaway a joint does not move by one bit, whatever its link does; above, it slides."""
    options = {"control_dt": 1e-3, "friction": {"coulomb": 400.0}, "initial_velocity": 0.5}
    env = started(**{**OPTIONS, "arm": ARM, "link": LINK, **options})
    truths = truths_of(env, [(0.0, 0.0)] * 600)[200:]
    assert not np.any([[truth.position - truths[0].position, truth.velocity] for truth in truths])
    assert np.ptp([truth.bend for truth in truths], axis=0).min() > 1e-4
    env.step((900.0, 900.0))
    assert np.abs(env.truth.velocity).min() > 0.0


@pytest.mark.parametrize("joint", [None, JOINT], ids=["rigid joints", "elastic joints"])
def test_blows_and_grasps_keep_the_momentum_of_the_whole_chain(joint):
    """A blow on the joints changes their momentum alone, and a payload that is picked up changes none."""
    events = ({"kind": "knock", "time": 0.01, "impulse": (5.0, -2.0)}, {"kind": "pick-up", "time": 0.02, "mass": 4.0})
    options = {"arm": {**vars(ARM), "gravity": 0.0}, "control_dt": 1e-5, "physics_dt": 1e-5, "duration": 0.03}
    env = started(**{**OPTIONS, "link": LINK, "joint": joint, "events": events, **options})
    truths = truths_of(env, [(20.0, 5.0)] * 2010)

    def momentum(truth):
        motion = truth.position, truth.bend, truth.velocity, truth.bend_velocity
        inertia, _ = chain(*motion, float(truth.payload))
        rotors = (0.0, 0.0) if joint else ARM.rotor
        return inertia @ np.ravel(motion[2:], order="F") + np.ravel([rotors * truth.velocity, (0, 0)], order="F")

    for k, change in ((1000, (5.0, 0.0, -2.0, 0.0)), (2000, (0.0,) * 4)):
        before, after = momentum(truths[k]), momentum(truths[k + 1])
        drift = before - momentum(truths[k - 1])
        np.testing.assert_allclose(after - before - drift, change, atol=2e-3)
    assert np.abs(truths[2001].velocity - truths[2000].velocity).max() > 0.01


@pytest.mark.parametrize(("frequency", "payload", "mass", "speed"), [
    ((0.76, 1.14), 0.0, 1.0, 0.0), ((0.76, 1.14), 0.0, 1.0, 2.0), (1.3, 0.0, 1.0, 1.0), (5.0, 0.0, 1.0, 3.0),
    (20.0, 3.0, 1.3, 3.0), (1.2, 8.0, 1.0, 0.0), (1.2, 30.0, 2.0, 1.0),  # hinges buckle in the last two
])  # fmt: skip
def test_an_arm_starts_in_a_stable_balance_of_its_bent_links(frequency, payload, mass, speed):
    """In all poses, upright too: no torque is left on the hinges, and a small bend raises one against it."""
    arm, rate = ArmParameters(), 2 * np.pi * np.array(frequency)
    k, masses = np.diag(straight_chain(arm, 0.0)[0])[2:] * rate**2, (mass * arm.m1, mass * arm.m2)
    segments = segment_terms(*masses, arm.L1, arm.L2, arm.centre, arm.inertia, payload, arm.L2, 0.0)
    error = {"ratio": {"m1": mass, "m2": mass}, "payload": payload}
    for q in [(np.pi / 2, 0.0), (-np.pi / 2, 0.0), *np.random.default_rng(0).uniform(-np.pi, np.pi, (40, 2))]:
        start = {"reference": {**HELD, "centre": tuple(q)}, "initial_velocity": speed}
        truth = started(link={"frequency": frequency}, parameter_error=error, **start).truth
        motion = lambda b, truth=truth: (truth.position, b, truth.velocity, np.zeros(2))
        left = lambda b: chain_dynamics(segments, (arm.L1, arm.L2), arm.gravity, *motion(b))[1][2:] - k * b
        np.testing.assert_array_equal(truth.bend_velocity, 0.0)
        assert np.abs(root(left, truth.bend, tol=1e-13).x - truth.bend).max() < 1e-9
        stiffness = np.array([left(truth.bend - x) - left(truth.bend + x) for x in 1e-5 * np.eye(2)])
        assert np.linalg.eigvals(stiffness / k).real.min() > 0.0


def test_joints_that_turn_too_fast_for_a_balance_start_in_that_at_rest():
    arm, q = {**vars(ArmParameters()), "gravity": 0.0}, {"reference": {**HELD, "centre": (0.5, 1.0)}}
    fast, slow = (started(arm=arm, link=1e-3, initial_velocity=v, **q).truth for v in (20.0, 0.0))
    np.testing.assert_array_equal((fast.bend, slow.bend), 0.0)


def test_encoders_read_the_joints_of_links_that_bend():
    env = started(**{**OPTIONS, "link": {"frequency": {"uniform": [10.0, 20.0]}}})
    observation = env.step((5.0, 0.0))[0]
    np.testing.assert_array_equal(observation[env.layout["position"]], env.truth.position)
    assert np.all((env.truth.bend_rate > 20 * np.pi) & (env.truth.bend_rate < 40 * np.pi))


def test_links_too_soft_for_their_weight_are_refused():
    """At the least frequency, a horizontal arm bends by half a radian; without gravity, any is enough."""
    for low in ((1e-300, 30.0), (30.0, {"uniform": [0.01, 20.0]})):
        with pytest.raises(ValueError, match=r"link.frequency must be at least .* got .* Hz") as error:
            TwoLinkArmEnv(arm=ARM, link={"frequency": low})
    least = [float(x) for x in re.findall(r"([0-9.]+) (?:and|Hz)", str(error.value))[:2]]
    env = started(arm=ARM, link=1.01 * max(least), reference={**HELD, "centre": (0.0, 0.0)})
    assert 0.3 < np.abs(env.truth.bend).max() < 0.6
    TwoLinkArmEnv(arm={**vars(ARM), "gravity": 0.0}, link=1e-3)


def test_the_fastest_rate_is_that_of_a_hinge_where_all_else_is_held():
    arm = ArmParameters.from_links((5.0, 1e-6), (1.0, 1.0), (1.0, 1.0), (0.0, 0.0))
    rate = fastest_rate(arm, arm, (1e6, 1e6), (0.0, 0.0), None, FlexibleLink((30.0, 1.0), damping=0.0))
    assert rate == pytest.approx(60 * np.pi, rel=1e-3)
    assert fastest_rate(TABLE_1, TABLE_1, (0.0, 0.0), (0.0, 0.0), None, FlexibleLink(15.0)) > 30 * np.pi
