"""Anti-windup of the laws that linearise by `arm.inverse_dynamics`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.numerics.dynamics import forward_dynamics
from fbl_gym.interface import Interface
from fbl_gym.model.arm import Array


def winds_up(
    interface: Interface, model: Any, q: Array, v: Array, a: Array, torque: Array, error: Array, loads: Any = 0.0
) -> NDArray[np.bool_]:
    """Return where an integrator of `error` must pause [n x 2].

    It pauses where the torque, which is that of `inverse_dynamics` plus known loads, saturates and
    the error asks for more of the part that is cut off. A joint therefore also pauses when the
    other joint's saturation takes its acceleration away through the coupling.

    Args:
        interface: with the torque limits.
        model: as `forward_dynamics` takes it.
        q: position [n x 2] rad.
        v: velocity [n x 2] rad/s.
        a: desired acceleration [n x 2] rad/s^2.
        torque: before it is limited [n x 2] N m.
        error: what is integrated [n x 2], of any unit.
        loads: known loads within the torque [n x 2] N m.
    """
    saturated = interface.saturate(torque)
    cut = (saturated != torque).any(axis=-1, keepdims=True)
    if not cut.any():
        return np.zeros_like(torque, dtype=bool)
    remaining = forward_dynamics(model, q, v, saturated - loads)
    return cut & ((a - remaining) * error > 0)
