"""PID with gravity compensation, the usual law of industrial robots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.policy import State
from controllers.simple import PdGravity
from fbl_gym.arm import Array
from fbl_gym.checks import Pair
from fbl_gym.records import pair


@dataclass(frozen=True)
class PidGravity(PdGravity):
    """PID with gravity compensation.

        torque = Kp (r - q) + Kd (r' - v) + Ki int(r - q) dt + G(q),    Ki = integral w^3 M_ii

    Kp and Kd are those of `PdGravity`. Each joint alone has the characteristic polynomial s^3 + 2
    damping w s^2 + w^2 s + integral w^3, which is stable for integral < 2 damping. At rest no
    constant load leaves an error. The integral pauses where the torque saturates and the error asks
    for more.

    Sensors: position and velocity. Source: Arimoto, "Control Theory of Non-linear Mechanical
    Systems", 1996, §3.3; Kelly, Santibanez and Loria, "Control of Robot Manipulators in Joint
    Space", 2005, ch. 9.

    Args:
        frequency: w [rad/s], per joint.
        damping: damping ratio, per joint.
        integral: share of the integral action, per joint.
    """

    integral: Pair | float = pair(0.1, low=0, tune=(0.01, 1.0))

    def initial(self, observation: Array) -> State:
        """Return the state: the integral of the error [n x 2], zero."""
        return (np.zeros((len(observation), 2)),)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next integral."""
        (integral,) = state
        q, r = self.read(observation, "position", "reference_position")
        error = r - q
        ki = np.array(self.integral) * np.array(self.frequency) ** 3 * self.inertia
        torque = super().torque(observation, ())[0] + ki * integral
        pause = (self.interface.saturate(torque) != torque) & (torque * error > 0.0)
        return torque, (integral + np.where(pause, 0.0, error * self.interface.control_dt),)
