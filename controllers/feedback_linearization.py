"""The feedback linearisation mapping (FLM) of the paper's figure 2, and its part in anti-windup."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fbl_gym.arm import Array, forward_dynamics, inverse_dynamics
from fbl_gym.interface import Interface


def linearize(interface: Interface, position: Array, velocity: Array, acceleration: Array) -> Array:
    """The torque that gives the nominal arm this acceleration: M a + C v + G.  All [n x 2].

    With an exact model the joints then behave as double integrators, q'' = a; what is left otherwise is the leakage of
    equation (5).
    """
    return inverse_dynamics(interface.nominal, position, velocity, acceleration)


def winds_up(
    interface: Interface, position: Array, velocity: Array, acceleration: Array, torque: Array, error: Array
) -> NDArray[np.bool_]:
    """Where an integrator must pause: the torque saturates, and the error asks for more of what is cut off.  [n x 2].

    What the limits leave of the wished acceleration is found by running the nominal model on the saturated torque, so that a
    joint also pauses when the other one's saturation, through the coupling, takes its acceleration away.

    Args:
        position, velocity: where the mapping was evaluated.
        acceleration: the acceleration wished for.
        torque: what `linearize` made of it.
        error: what the integrator would add up.
    """
    cut = interface.saturate(torque)
    left = forward_dynamics(interface.nominal, position, velocity, cut)
    saturated = np.any(cut != torque, axis=-1, keepdims=True)
    return saturated & ((acceleration - left) * error > 0)
