"""Motions of the environment against a high-accuracy ODE solver, and against the laws of mechanics.

The solver integrates Pinocchio's model of the arm with DOP853 at a relative tolerance of 1e-12. It restarts at every
instant at which something jumps: a new command, a delayed one, a payload, a level of the disturbance.
"""

import dataclasses
import functools
import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import ode

from fbl_gym import SECTION_2_2, TABLE_1, ArmParameters, TwoLinkArmEnv
from fbl_gym.options import Actuator, Limits, SineReference
from tests.fbl_gym.test_arm import pin, pinocchio_model

# The independent model.


@functools.cache
def pinocchio(arm, payload=0.0):
    """Return model and data of an arm with a point mass at its tip."""
    model = pinocchio_model(arm)
    model.appendBodyToJoint(2, pin.Inertia(payload, np.array([arm.L2, 0.0, 0.0]), np.zeros((3, 3))), pin.SE3.Identity())
    return model, model.createData()


@dataclasses.dataclass(frozen=True)
class World:
    """A real arm and its loads. `sliding` is a constant friction torque; `jumps` are instants of new levels."""

    arm: ArmParameters
    viscous: tuple[float, float] = (0.0, 0.0)
    sliding: tuple[float, float] = (0.0, 0.0)
    disturbance: Callable[[float], tuple[float, float]] = lambda _: (0.0, 0.0)
    jumps: tuple[float, ...] = ()
    lag: float = 0.0
    delay: float = 0.0
    payload: tuple[float, float, float] = (0.0, math.inf, math.inf)  # mass, pick-up, drop

    def model(self, t):
        """Return Pinocchio's model and data of the arm at t."""
        mass, on, off = self.payload
        return pinocchio(self.arm, mass if on <= t < off else 0.0)

    def acceleration(self, model, t, state, applied):
        """Return the acceleration [2] under the applied torques, by Pinocchio's articulated-body algorithm."""
        q, v = state[:2], state[2:]
        torque = applied - np.array(self.disturbance(t)) - np.array(self.viscous) * v - np.array(self.sliding)
        return pin.aba(*model, q, v, torque)

    def run(self, policy, start, held, steps, dt):
        """Return positions and velocities at the control instants [steps + 1 x 4], and the last applied torque.

        policy: (t, q1, q2, v1, v2) -> torque. held: the torque before the first command.
        """
        x, path, commands = np.array([*start, *held]), [np.array(start)], []
        for k in range(steps):
            commands.append(policy(k * dt, *x[:4]))
            t, end = k * dt, (k + 1) * dt
            jumps = [j * dt + self.delay for j in range(k + 1)][-math.ceil(self.delay / dt) - 2 :]
            inner = [s for s in (*jumps, *self.jumps, *self.payload[1:]) if t + 1e-9 < s < end - 1e-9]
            for a, b in zip([t, *sorted(inner)], [*sorted(inner), end], strict=True):
                if abs(a - self.payload[1]) < 1e-9 and a > 0.0:
                    x[2:4] = self.grasp(a, x[:4])
                arrived = math.floor((a - self.delay) / dt + 1e-6)
                command = np.array(commands[arrived] if arrived >= 0 else held)
                if self.lag == 0.0:
                    x[4:] = command
                x = self._solve(x, a, b, command)
            path.append(x[:4].copy())
        return np.array(path), x[4:]

    def grasp(self, t, state):
        """Return the velocities after a grasp at t: arm and payload share the momentum."""
        upper = [np.triu(pin.crba(*self.model(t + s), state[:2])) for s in (-1e-6, 1e-6)]
        before, after = (m + np.triu(m, 1).T for m in upper)
        return np.linalg.solve(after, before @ state[2:])

    def _solve(self, x, a, b, command):
        model, rate = self.model(0.5 * (a + b)), 1.0 / self.lag if self.lag else 0.0
        inside = min(b, a + (b - a) * (1 - 1e-12))  # the level before b, not the one from b on

        def slope(t, y):
            return *y[2:4], *self.acceleration(model, min(t, inside), y[:4], y[4:]), *(rate * (command - y[4:]))

        solver = ode(slope).set_integrator("dop853", rtol=1e-12, atol=1e-13, first_step=(b - a) / 4)
        end = solver.set_initial_value(x, a).integrate(b)
        assert solver.successful()
        return end


# The controlled motion: PD and the nominal arm's gravity, along a known path.


def hang(arm, q1, q2):
    """Return the torque that holds the arm still."""
    return pin.computeGeneralizedGravity(*pinocchio(arm), np.array([q1, q2])).copy()


def follow(arm, path, kp, kd):
    """Return a PD policy with gravity compensation. `path` maps t to reference positions and velocities."""

    def policy(t, q1, q2, v1, v2):
        (r1, r2), (w1, w2) = path(t)
        g1, g2 = hang(arm, q1, q2)
        return g1 + kp[0] * (r1 - q1) + kd[0] * (w1 - v1), g2 + kp[1] * (r2 - q2) + kd[1] * (w2 - v2)

    return policy


def sway(reference):
    """Return the path of a SineReference without phase, from its definition."""
    w = 2 * math.pi * reference.frequency

    def path(t):
        amplitude = np.array(reference.amplitude)
        return reference.centre + amplitude * math.sin(w * t), w * amplitude * math.cos(w * t)

    return path


FAR = Limits(position=1000.0, velocity=1000.0)  # let it turn


def run_env(policy, steps, dt, **options):
    """Return the environment's positions and velocities [steps + 1 x 4], and its truth at the end."""
    env = TwoLinkArmEnv(action="torque", control_dt=dt, duration=steps * dt, limits=FAR, **options)
    path = [env.reset(seed=0)[0][:4]]
    for k in range(steps):
        observation, _, *ends, _ = env.step(policy(k * dt, *path[-1]))
        assert ends == [False, k == steps - 1]
        path.append(observation[:4])
    truth = env.truth
    np.testing.assert_array_equal(path[-1], np.r_[truth.position, truth.velocity])
    np.testing.assert_array_equal(truth.motor_position, truth.position)  # a rigid arm's motor is its link
    return np.array(path), truth


SWAY = SineReference(centre=(-1.2, 0.4), amplitude=(0.6, 0.8), frequency=0.4)
SLOW_SWAY = SineReference(centre=(-1.2, 0.4), amplitude=(0.6, 0.8), frequency=0.05)
LEVELS = ((60.0, -20.0), (-90.0, 15.0), (30.0, 30.0))


def sine(t):
    return 80 * math.sin(2 * math.pi * 1.3 * t + 0.4), 30 * math.sin(2 * math.pi * 0.7 * t - 1.0)


def levels(t):
    """Return the torque of LEVELS: each lasts 1.237 s, the last one for ever."""
    return LEVELS[min(int(t / 1.237), 2)]


def pulse(t):
    """Return a torque that acts for 0.103 s in every 2.5 s, from 0.5 s on."""
    return (150.0, -60.0) if t >= 0.5 and (t - 0.5) % 2.5 < 0.103 else (0.0, 0.0)


PULSES = tuple(0.5 + 2.5 * i + width for i in range(4) for width in (0.0, 0.103))
OTHER = ArmParameters(m1=30.0, m2=12.0, L1=0.84, L2=0.45)
RATIO = (1.5, 0.8, 1.2, 0.9)
PAYLOAD = {"mass": 10.0, "pick_up": 2.503, "drop": 7.0}
SINE = {"kind": "sine", "amplitude": (80.0, 30.0), "frequency": (1.3, 0.7), "phase": (0.4, -1.0)}
PULSE = {"kind": "pulses", "amplitude": (150.0, -60.0), "period": 2.5, "width": 0.103, "start": 0.5}
TABLE = {"kind": "array", "torque": LEVELS, "dt": 1.237}
VISCOUS = {"viscous": (20.0, 6.0)}


def drive(**lateness):
    """Return options of a drive without a limit."""
    return {"actuator": Actuator(None, **lateness)}


# Options of the environment, and the equivalent model.
CASES = {
    "ideal": ({}, World(TABLE_1)),
    "rods": ({"arm": TABLE_1.as_rods()}, World(TABLE_1.as_rods())),
    "section-2-2": ({"arm": SECTION_2_2, "reference": SLOW_SWAY}, World(SECTION_2_2)),
    "other parameters": ({"parameter_error": {"ratio": RATIO}}, World(OTHER)),
    "viscous friction": ({"friction": VISCOUS}, World(TABLE_1, **VISCOUS)),
    "sine disturbance": ({"disturbance": SINE}, World(TABLE_1, disturbance=sine)),
    "levels": ({"disturbance": TABLE}, World(TABLE_1, disturbance=levels, jumps=(1.237, 2.474))),
    "pulses": ({"disturbance": PULSE}, World(TABLE_1, disturbance=pulse, jumps=PULSES)),
    "lag": (drive(lag=0.03), World(TABLE_1, lag=0.03)),
    "delay": (drive(delay=0.033), World(TABLE_1, delay=0.033)),
    "whole delay": (drive(delay=0.02), World(TABLE_1, delay=0.02)),
    "lag and short delay": (drive(delay=0.007, lag=0.02), World(TABLE_1, delay=0.007, lag=0.02)),
    "payload": ({"parameter_error": {"payload": PAYLOAD}}, World(TABLE_1, payload=(10.0, 2.503, 7.0))),
    "all at once": (
        {"parameter_error": {"ratio": RATIO, "payload": PAYLOAD}, "friction": VISCOUS, "disturbance": SINE}
        | drive(delay=0.007, lag=0.02),
        World(OTHER, (20.0, 6.0), disturbance=sine, lag=0.02, delay=0.007, payload=(10.0, 2.503, 7.0)),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_controlled_motion_agrees_with_the_solver(case):
    """Ten seconds in closed loop, each side with its own feedback, agree to 1e-8 rad and 1e-8 rad/s throughout."""
    options, world = CASES[case]
    options = {"reference": SWAY, "actuator": None, "arm": TABLE_1} | options
    arm, dt = options["arm"], 0.02
    gains = ((300.0, 60.0), (90.0, 18.0)) if arm != SECTION_2_2 else ((3000.0, 300.0), (3000.0, 300.0))
    policy = follow(arm, sway(options["reference"]), *gains)
    ours, truth = run_env(policy, 500, dt, physics_dt=0.001, **options)
    theirs, applied = world.run(policy, ours[0], hang(arm, *ours[0, :2]), 500, dt)
    assert np.ptp(theirs[:, :2], axis=0).min() > 0.5  # it does move
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-8)
    np.testing.assert_allclose(truth.applied_torque, applied, rtol=0, atol=1e-6)


# Without control.


def test_sliding_under_coulomb_friction_agrees_with_the_solver():
    """Ten seconds in closed loop with both joints turning one way, joint 2 the other way than joint 1."""
    start = SineReference(centre=(-2.0, 3.0), amplitude=1.0, frequency=0.16, phase=(0.0, math.pi))

    def path(t):
        position = -2 + t + 0.2 * math.sin(2 * t), 3 - t + 0.3 * math.sin(1.5 * t)
        return position, (1 + 0.4 * math.cos(2 * t), -1 + 0.45 * math.cos(1.5 * t))

    policy = follow(TABLE_1, path, (400.0, 150.0), (250.0, 50.0))
    friction = {"viscous": (5.0, 2.0), "coulomb": (30.0, 10.0)}
    ours, truth = run_env(policy, 1000, 0.01, physics_dt=0.001, friction=friction, reference=start, actuator=None)
    world = World(TABLE_1, viscous=(5.0, 2.0), sliding=(30.0, -10.0))
    theirs, _ = world.run(policy, ours[0], hang(TABLE_1, *ours[0, :2]), 1000, 0.01)
    assert theirs[:, 2].min() > 0.05
    assert theirs[:, 3].max() < -0.05
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-8)
    printed = np.array([5.0, 2.0]) * truth.velocity + np.array([30.0, -10.0])
    np.testing.assert_allclose(truth.friction_torque, printed, rtol=1e-12)


ORDER_CASES = {
    **{name: CASES[name] for name in ("ideal", "viscous friction", "sine disturbance")},
    "lag": (drive(lag=0.1), World(TABLE_1, lag=0.1)),
}


@pytest.mark.parametrize("case", ORDER_CASES)
def test_halving_the_step_divides_the_error_by_sixteen(case):
    """The integrator is of fourth order, also for loads that change within a step."""
    options, world = ORDER_CASES[case]
    options = {"reference": SWAY, "actuator": None} | options

    def policy(t, *_):
        return (120.0, 30.0) if t < 0.5 else (-60.0, 50.0)

    errors = []
    for h in (0.02, 0.01, 0.005):
        ours, _ = run_env(policy, 50, 0.02, physics_dt=h, **options)
        theirs, _ = world.run(policy, ours[0], hang(TABLE_1, *ours[0, :2]), 50, 0.02)
        errors.append(np.linalg.norm(ours[-1] - theirs[-1]))
    ratios = np.divide(errors[:-1], errors[1:])
    assert np.all((ratios > 14) & (ratios < 18)), (errors, ratios)


@pytest.mark.parametrize("case", CASES)
def test_the_acceleration_sensor_reads_newtons_law(case):
    """At the start and at the end of each step, under the present torque, disturbance, friction and payload."""
    options, world = CASES[case]
    options = {"reference": SWAY, "actuator": None} | options
    env = TwoLinkArmEnv(action="torque", control_dt=0.02, physics_dt=0.001, limits=FAR, **options)
    rng = np.random.default_rng(0)
    observation, _ = env.reset(seed=0)
    for k in range(200):
        # A value that jumps at this instant is still the old one.
        truth, t = env.truth, max(0.02 * k - 1e-9, 0.0)
        state = np.concatenate([truth.position, truth.velocity])
        expected = world.acceleration(world.model(t), t, state, truth.applied_torque)
        np.testing.assert_allclose(truth.acceleration, expected, rtol=1e-6, atol=1e-6)
        np.testing.assert_array_equal(observation[env.layout["acceleration"]], truth.acceleration)
        np.testing.assert_allclose(truth.disturbance, world.disturbance(t), rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(truth.friction_torque, np.array(world.viscous) * truth.velocity, rtol=1e-12)
        observation, *_ = env.step(rng.uniform(-1, 1, 2) * (200.0, 60.0))
