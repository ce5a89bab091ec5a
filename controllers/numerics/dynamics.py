"""The dynamics of `fbl_gym.model.arm`, compiled with the same bits for laws; and anti-windup.

The arm is an `ArmParameters`, or lumped parameters, with or without rotors, for each lane
[n x 5 or 7]. All signals have the same shape [... x 2].
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fbl_gym.interface import Interface
from fbl_gym.kernel.arm import prediction
from fbl_gym.model.arm import ArmParameters, Array, with_rotors


def inverse_dynamics(arm: ArmParameters | Array, q: Array, v: Array, a: Array) -> Array:
    """Return the torque M a + C v + G [N m] for an acceleration a, as `arm.inverse_dynamics`."""
    return _run(prediction.find_torques, arm, q, v, a)


def forward_dynamics(arm: ArmParameters | Array, q: Array, v: Array, torque: Array) -> Array:
    """Return the acceleration M^-1 (torque - C v - G) [rad/s^2], as `arm.forward_dynamics`."""
    return _run(prediction.find_accelerations, arm, q, v, torque)


def momentum(arm: ArmParameters, q: Array, v: Array) -> tuple[Array, Array]:
    """Return M v [N m s], and C'v - G [N m] with the skew form of C, of signals [n x 2]."""
    p, drift = np.empty(q.shape), np.empty(q.shape)
    prediction.find_momenta(arm.base, np.ascontiguousarray(q), np.ascontiguousarray(v), p, drift)
    return p, drift


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


def _run(function: Callable[..., Any], arm: ArmParameters | Array, *signals: Array) -> Array:
    arms = arm.base if isinstance(arm, ArmParameters) else arm if arm.shape[-1] == 7 else with_rotors(arm, 0.0)
    result = np.empty(signals[0].shape)
    # Compiled code does not check shapes.
    same = (x if x.shape == result.shape else np.broadcast_to(x, result.shape) for x in signals)
    rows = [np.ascontiguousarray(x).reshape(-1, 2) for x in (*same, result)]
    function(np.ascontiguousarray(arms).reshape(-1, 7), *rows)
    return result
