"""The feedback linearisation mapping (FLM) of the paper's figure 2, and its part in anti-windup."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fbl_gym.arm import ArmParameters, Array, forward_dynamics, inverse_dynamics
from fbl_gym.interface import Interface


def linearize(model: ArmParameters | Array, position: Array, velocity: Array, acceleration: Array) -> Array:
    """The torque that gives the model this acceleration: M a + C v + G.  All [n x 2].

    With an exact model the joints then behave as double integrators, q'' = a; what is left otherwise is the leakage of
    equation (5).

    Args:
        model: the nominal arm, or the lumped parameters [n x 5] that an estimator found.
        position, velocity: measured or estimated.
        acceleration: the one wished for.
    """
    return inverse_dynamics(model, position, velocity, acceleration)


def winds_up(
    interface: Interface,
    model: ArmParameters | Array,
    position: Array,
    velocity: Array,
    acceleration: Array,
    torque: Array,
    error: Array,
) -> NDArray[np.bool_]:
    """Where an integrator must pause: the torque saturates, and the error asks for more of what is cut off.  [n x 2].

    What the limits leave of the wished acceleration is found by running the model on the saturated torque, so that a
    joint also pauses when the other one's saturation, through the coupling, takes its acceleration away.

    Args:
        interface: for the torque limits.
        model, position, velocity, acceleration: as given to `linearize`.
        torque: what `linearize` made of them.
        error: what the integrator would add up.
    """
    cut = interface.saturate(torque)
    left = forward_dynamics(model, position, velocity, cut)
    saturated = np.any(cut != torque, axis=-1, keepdims=True)
    return saturated & ((acceleration - left) * error > 0)
