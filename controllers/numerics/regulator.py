"""Optimal regulators of the arm at rest, for five angles of the second joint."""

import numpy as np
from scipy.linalg import expm

from fbl_gym.kernel.maths.fastmath import cached_njit
from fbl_gym.model.arm import Array

#: Cosines of the second joint's angle for which gains are computed.
COSINES = np.linspace(-1.0, 1.0, 5)

#: The joints' angles there [5 x 2] rad.
ANGLES = np.stack([np.zeros_like(COSINES), np.arccos(COSINES)], axis=-1)


def design(slope: Array, lag: Array, dt: float, bandwidth: float, damping: float, inertia: Array) -> Array:
    """Return the gain K [... x 2 x (s + 2)] on the error of a state and of the drives' torque.

    Args:
        slope: derivative of the state's rate by state and torque [... x s x (s + 2)].
        lag: of the drives [...] s; at least 1 ms is used.
        dt: control interval [s].
        bandwidth: bandwidth^2 is the weight of the links' position [rad/s].
        damping: weight of their velocity over 2 bandwidth.
        inertia: the command over this is weighted with 1 [... x 2] kg m^2.
    """
    size = slope.shape[-1]
    a = np.zeros((*slope.shape[:-2], size + 2, size + 2))
    a[..., : size - 2, :size] = slope
    drive = np.concatenate([-np.eye(2), np.eye(2)], axis=1)
    a[..., size - 2 : size, size - 2 :] = drive / np.maximum(lag, 1e-3)[..., None, None]
    exact = expm(a * dt)
    q = np.zeros(size)
    q[0:2], q[2:4] = bandwidth**4, (2.0 * damping * bandwidth) ** 2
    return regulator(exact[..., :size, :size], exact[..., :size, size:], np.diag(q), inertia)


def regulator(f: Array, g: Array, q: Array, scale: Array) -> Array:
    """Return the gain K [... x m x n] of the optimal regulators u = -K x of x+ = f x + g u.

    The cost is the sum of x'qx + |u / scale|^2, scale [... x m]. The Riccati equation is solved by
    doubling: each turn takes twice as many samples into account (Chu, Fan, Lin and Wang,
    "Structure-preserving algorithms for periodic discrete-time algebraic Riccati equations", Int.
    J. Control 77(8), 2004).
    """
    weighted = g * scale[..., None, :]
    a, b, p = f, weighted @ np.swapaxes(weighted, -1, -2), np.broadcast_to(q, f.shape)
    for _ in range(10):
        left = np.linalg.solve(np.eye(f.shape[-1]) + b @ p, np.concatenate([a, np.broadcast_to(b, a.shape)], axis=-1))
        wa, wb = np.split(left, 2, axis=-1)
        turned = np.swapaxes(a, -1, -2)
        a, b, p = a @ wa, b + a @ wb @ turned, p + turned @ p @ wa
    to = np.swapaxes(weighted, -1, -2) @ p
    return scale[..., None] * np.linalg.solve(np.eye(g.shape[-1]) + to @ weighted, to @ f)


def at_angle(gains: Array, angle: Array) -> Array:
    """Return gains [n x a x b] at an angle of the second joint [n] rad.

    Those at `COSINES` are [n x 5 x a x b], or [5 x a x b] for all lanes.
    """
    blended = np.empty((len(angle), *gains.shape[-2:]))
    _blend(gains.reshape(-1, *gains.shape[-3:]), np.cos(angle), blended)
    return blended


@cached_njit
def _blend(gains: Array, cosine: Array, blended: Array) -> None:
    for lane in range(len(blended)):
        table = gains[min(lane, len(gains) - 1)]
        index = (cosine[lane] + 1.0) / (COSINES[1] - COSINES[0])
        low = int(index) if index < len(COSINES) - 2 else len(COSINES) - 2  # of NaN, too
        share = index - low
        for i in range(blended.shape[1]):
            for j in range(blended.shape[2]):
                blended[lane, i, j] = (1.0 - share) * table[low, i, j] + share * table[low + 1, i, j]
