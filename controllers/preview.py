"""The reference that an observation previews, at any time."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fbl_gym.interface import Interface
from fbl_gym.kernel.maths.fastmath import cached_njit
from fbl_gym.model.arm import Array


class Places(NamedTuple):
    """Times among the samples of a motion; a row for all lanes [1 x k], or one for each [n x k]."""

    last: NDArray[np.int64]  # sample before each time
    since: Array  # time since the last sample [s]


def reference_at(interface: Interface, observation: Array, times: Array) -> Array:
    """Return the reference's position, velocity and acceleration [n x k x 6] at k times.

    It comes from the preview as far as that reaches, with the acceleration linear between two
    samples. Before the first and after the last one, the acceleration is held.

    Args:
        interface: of the policy.
        observation: [n x size].
        times: from now on [k] or [n x k] s.
    """
    return sampled_at(known_reference(interface, observation), interface.control_dt, times)


def known_reference(interface: Interface, observation: Array) -> Array:
    """Return the reference of an observation, now and at the previewed samples [n x k x 6]."""
    return observation.take(interface.layout.reference, axis=-1).reshape(len(observation), -1, 6)


def past_reference(interface: Interface, observation: Array) -> Array:
    """Return the reference of two samples before now [n x 2 x 6], its acceleration held."""
    return reference_at(interface, observation, -interface.control_dt * np.array([2.0, 1.0]))


def sampled_at(known: Array, dt: float, times: Array) -> Array:
    """Return a motion [n x k x 6] at times [k] or [n x k] s from its samples, dt apart."""
    return between(known, places(dt, known.shape[1], times), dt)


def places(dt: float, samples: int, times: Array) -> Places:
    """Return the places of times [k] or [n x k] s among samples that lie dt apart."""
    times = np.atleast_2d(times)
    last = np.clip((times / dt + 1e-9).astype(int), 0, samples - 1)
    return Places(last, times - last * dt)


def between(known: Array, at: Places, dt: float) -> Array:
    """Return position, velocity and acceleration [n x k x 6] at places among samples [n x m x 6].

    The acceleration is linear between two samples, which lie dt apart.
    """
    motion = np.empty((len(known), at.since.shape[1], 6))
    _interpolate(known, *at, dt, motion)
    return motion


@cached_njit
def _interpolate(known: Array, last: Array, since: Array, dt: float, motion: Array) -> None:
    for lane in range(len(motion)):
        row = min(lane, len(since) - 1)
        for i in range(since.shape[1]):
            t, k = since[row, i], last[row, i]
            now, then = known[lane, k], known[lane, min(k + 1, known.shape[1] - 1)]
            for joint in range(2):
                r, r_dot, r_ddot = now[joint], now[joint + 2], now[joint + 4]
                jerk = (then[joint + 4] - r_ddot) / dt if t > 0.0 else 0.0
                motion[lane, i, joint] = r + t * r_dot + t * t * (r_ddot / 2.0 + t * jerk / 6.0)
                motion[lane, i, joint + 2] = r_dot + t * r_ddot + 0.5 * (t * t) * jerk
                motion[lane, i, joint + 4] = r_ddot + t * jerk
