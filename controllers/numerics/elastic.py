"""The compiled model of an arm whose joints may be elastic, for `laws/lqg_elastic.py`.

A state x [n x 6 or 10] is position and velocity of the links, those of motors behind springs, and
a torque d on the motors that stays. The springs [3 x 2] are stiffness [N m/rad], damping
[N m s/rad] and inertia of the rotor [kg m^2] of each joint; [0 x 2]: joints are rigid.
"""

import math

import numpy as np

from fbl_gym.kernel.arm.prediction import find_accelerations, find_torques
from fbl_gym.kernel.maths.fastmath import cached_njit, fma

#: Differences of second order over five samples.
RATES = np.gradient(np.eye(5), axis=0, edge_order=2)


@cached_njit
def move(arm, springs, durations, lag, fastest, commands, x, due):
    """Move states and the torque of the drives through commands, by leapfrog steps.

    Args:
        arm: lumped parameters and rotors of the links [1 x 7].
        springs: see the module.
        durations: of the commands, the oldest first [m] s; one may be 0.
        lag: time constant with which the torque follows a command [s]; 0: at once.
        fastest: the fastest natural frequency [rad/s].
        commands: the newest first [n x m x 2] N m.
        x: the states, which this replaces.
        due: torque of the drives [n x 2] N m, which this replaces.
    """
    n, elastic = len(x), len(springs) > 0
    q, v, torque, load, a = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2))
    q[:], v[:] = x[:, :2], x[:, 2:4]
    for k in range(len(durations)):
        h = durations[k]
        if h == 0.0:
            continue
        keep = math.exp(-h / lag) if lag > 0.0 else 0.0
        share = lag * (1.0 - keep) / h
        steps = max(1, math.ceil(max(3.0 * h * fastest, h / 0.005) - 1e-9))
        h /= steps
        for lane in range(n):
            for j in range(2):
                command = commands[lane, len(durations) - 1 - k, j]
                gap = due[lane, j] - command
                torque[lane, j] = command + share * gap + x[lane, x.shape[1] - 2 + j]
                due[lane, j] = command + keep * gap
        for _ in range(steps):
            for lane in range(n):
                for j in range(2):
                    q[lane, j] += 0.5 * h * v[lane, j]
                    load[lane, j] = torque[lane, j]
                    if elastic:
                        m, w = x[lane, 4 + j] + 0.5 * h * x[lane, 6 + j], x[lane, 6 + j]
                        load[lane, j] = springs[0, j] * (m - q[lane, j]) + springs[1, j] * (w - v[lane, j])
                        w += h * (torque[lane, j] - load[lane, j]) / springs[2, j]
                        x[lane, 4 + j], x[lane, 6 + j] = m + 0.5 * h * w, w
            find_accelerations(arm, q, v, load, a)
            for lane in range(n):
                for j in range(2):
                    v[lane, j] += h * a[lane, j]
                    q[lane, j] += 0.5 * h * v[lane, j]
    x[:, :2], x[:, 2:4] = q, v


@cached_njit
def follow(arm, springs, motion, h, lead, wanted, command):
    """Write the state with the drives' torque in place of d, and the command, along a motion.

    Args:
        arm: lumped parameters and rotors of the links [1 x 7].
        springs: see the module.
        motion: position, velocity, acceleration of the links at five times, h apart [n x 5 x 6].
        h: [s].
        lead: time by which the torque follows the command [s].
        wanted: takes the state at the third time [n x 6 or 10].
        command: takes the command then [n x 2] N m.
    """
    n = len(motion)
    q, v, a = np.empty((n, 5, 2)), np.empty((n, 5, 2)), np.empty((n, 5, 2))
    q[:], v[:], a[:] = motion[:, -5:, :2], motion[:, -5:, 2:4], motion[:, -5:, 4:]
    load = np.empty((n, 5, 2))
    find_torques(arm, q.reshape(-1, 2), v.reshape(-1, 2), a.reshape(-1, 2), load.reshape(-1, 2))
    wanted[:, :2], wanted[:, 2:4] = q[:, 2], v[:, 2]
    if len(springs) > 0:
        change = rate(load, h)
        wanted[:, 4:6] = q[:, 2] + load[:, 2] / springs[0] - springs[1] * change[:, 2] / springs[0] ** 2
        wanted[:, 6:8] = v[:, 2] + change[:, 2] / springs[0]
        load += springs[2] * (a + rate(change, h) / springs[0])
    wanted[:, -2:] = load[:, 2]
    command[:] = load[:, 2] + lead * rate(load, h)[:, 2]


@cached_njit
def rate(x, h):
    """Return the derivative over time of samples [n x 5 x 2] that lie h [s] apart."""
    rates = np.zeros(x.shape)
    for lane in range(len(x)):
        for i in range(5):
            for j in range(2):
                for k in range(5):
                    rates[lane, i, j] = fma(RATES[i, k], x[lane, k, j], rates[lane, i, j])
                rates[lane, i, j] /= h
    return rates


@cached_njit
def brake(error, near):
    """Replace a position's error e beyond `near` [n x 1 x 2] by sqrt(near (2 e - near)), in place.

    The error is that of a state [n x 6 or 10]: of links, and of motors behind springs.
    """
    for lane in range(len(error)):
        for j in range(2):
            e, close = error[lane, j], near[lane, 0, j]
            far = close if abs(e) < close else abs(e)
            excess = np.sign(e) * (far - np.sqrt(close * (2.0 * far - close)))
            for body in range(j, error.shape[1] - 2, 4):
                error[lane, body] -= excess
