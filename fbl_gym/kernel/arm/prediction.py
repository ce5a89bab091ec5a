"""The model of the laws: its dynamics at an instant, and its motion under torques on their way.

The motion is the kernel's own physics without friction, so a model that is the real arm predicts
its motion to the last digits. The dynamics has the bits of `arm.py`, whose terms and whose C
library's sine and cosine it takes.
"""

from math import cos, sin

from fbl_gym.kernel.arm import physics
from fbl_gym.kernel.maths.fastmath import cached_njit, clip, exp, inline_njit


@inline_njit
def _terms(arm, q, v):
    """Return the entries of M, and C v + G, of lumped parameters and rotors [7]."""
    m11, m12, m22 = physics.inertia_terms(arm[0], arm[1], arm[2], arm[5], arm[6], cos(q[1]))
    c1, c2 = physics.coriolis_terms(arm[2], sin(q[1]), v[0], v[1])
    g1, g2 = physics.gravity_terms(arm[3], arm[4], cos(q[0]), cos(q[0] + q[1]))
    return m11, m12, m22, c1, c2, g1, g2


@cached_njit
def find_torques(arms, q, v, a, out):
    """Write `arm.inverse_dynamics` of rows [n x 2], for one arm [1 x 7] or an arm each [n x 7]."""
    for i in range(len(q)):
        m11, m12, m22, c1, c2, g1, g2 = _terms(arms[i % len(arms)], q[i], v[i])
        out[i, 0], out[i, 1] = m11 * a[i, 0] + m12 * a[i, 1] + c1 + g1, m12 * a[i, 0] + m22 * a[i, 1] + c2 + g2


@cached_njit
def find_accelerations(arms, q, v, torque, out):
    """Write `arm.forward_dynamics` of each row, as `find_torques`."""
    for i in range(len(q)):
        m11, m12, m22, c1, c2, g1, g2 = _terms(arms[i % len(arms)], q[i], v[i])
        out[i, 0], out[i, 1] = physics.solve_terms(m11, m12, m22, torque[i, 0] - c1 - g1, torque[i, 1] - c2 - g2)


@cached_njit
def find_momenta(arm, q, v, momentum, drift):
    """Write M v, and C'v - G with the skew form of C, of rows [n x 2]; the arm is [7]."""
    for i in range(len(q)):
        m11, m12, m22, _, _, g1, g2 = _terms(arm, q[i], v[i])
        v1, v2, h = v[i, 0], v[i, 1], arm[2] * sin(q[i, 1])
        momentum[i, 0], momentum[i, 1] = m11 * v1 + m12 * v2, m12 * v1 + m22 * v2
        drift[i, 0], drift[i, 1] = -h * v2 * v1 + h * v1 * v2 - g1, -h * (v1 + v2) * v1 - g2


@cached_njit
def follow(commands, torque, spans, dt, out):
    """Write the torque after an interval, and its mean over it [2 x n x 2].

    Args:
        commands: the newest first [n x m x 2] N m; those that act come last.
        torque: at the start [n x 2] N m.
        spans: duration [s] of the older command, share of the gap to it that is left, and this
            share's integral [s]; then those of the newer one [2 x 3].
        dt: duration of both [s].
        out: takes them.
    """
    for lane in range(len(torque)):
        for joint in range(2):
            now, total = torque[lane, joint], 0.0
            for i in range(2):
                wanted = commands[lane, commands.shape[1] - 1 - i, joint]
                gap = now - wanted
                total = total + spans[i, 0] * wanted + spans[i, 2] * gap
                now = wanted + spans[i, 1] * gap
            out[0, lane, joint], out[1, lane, joint] = now, total / dt


@inline_njit
def _stage(q, v, load, constants):
    """Return the acceleration at one stage of a step."""
    lumped, rotor, (push1, push2) = constants
    a1, a2 = physics.solve_terms(*physics.load_on_joints(lumped, rotor, q, v, load))
    return a1 + push1, a2 + push2


_runge_kutta = physics.make_runge_kutta(_stage, physics.moved, physics.weighted)


@inline_njit
def _toward(command, torque, keep):
    """Return the torque of which a share `keep` of the gap to the command is left."""
    return command[0] + keep * (torque[0] - command[0]), command[1] + keep * (torque[1] - command[1])


@cached_njit
def predict(arm, push, durations, commands, lag, fastest, motion):
    """Move each lane through some commands, one Runge-Kutta step each.

    Args:
        arm: lumped parameters and rotors [7].
        push: acceleration that is added to the model's [n x 2] rad/s^2.
        durations: of the steps [m] s.
        commands: [m x n x 2] N m.
        lag: time constant with which the torque follows a command [s]; 0: at once.
        fastest: limit of the velocity [rad/s].
        motion: position, velocity and torque [3 x n x 2], which this replaces.
    """
    lumped, rotor = (arm[0], arm[1], arm[2], arm[3], arm[4]), (arm[5], arm[6])
    for k in range(len(durations)):
        h = durations[k]
        start, half, end = (1.0, exp(-0.5 * h / lag), exp(-h / lag)) if lag > 0.0 else (0.0, 0.0, 0.0)
        for lane in range(motion.shape[1]):
            q, v = (motion[0, lane, 0], motion[0, lane, 1]), (motion[1, lane, 0], motion[1, lane, 1])
            torque = motion[2, lane, 0], motion[2, lane, 1]
            command = commands[k, lane, 0], commands[k, lane, 1]
            last = _toward(command, torque, end)
            q, v = _runge_kutta(
                h, q, v, _toward(command, torque, start), _toward(command, torque, half), last,
                (lumped, rotor, (push[lane, 0], push[lane, 1])),
            )  # fmt: skip
            motion[0, lane, 0], motion[0, lane, 1] = q
            motion[1, lane, 0], motion[1, lane, 1] = clip(v[0], fastest), clip(v[1], fastest)
            motion[2, lane, 0], motion[2, lane, 1] = last
