"""Computed torque, the textbook law for an arm with a known model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.feedback_linearization import linearize
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array
from fbl_gym.checks import Pair
from fbl_gym.records import pair


@dataclass(frozen=True)
class ComputedTorque(TorqueLaw):
    """Computed torque, critically damped.

        torque = M(q) a + C v + G,    a = r'' + w^2 (r - q) + 2 w (r' - v)

    With an exact model the error obeys e'' + 2 w e' + w^2 e = 0. An inertia k times smaller than
    the model's is stable for k w dt < 1, dt the control interval.

    Sensors: position and velocity. Source: Siciliano, Sciavicco, Villani and Oriolo, "Robotics:
    Modelling, Planning and Control", 2009, §8.5.2.

    Args:
        frequency: w [rad/s], per joint.
    """

    frequency: Pair | float = pair(15.0, unit="rad/s", above=0, tune=(2.0, 150.0))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m; there is no state."""
        q, v = self.read(observation, "position", "velocity")
        return linearize(self.interface.nominal, q, v, self.acceleration(observation, q, v)), state

    def acceleration(self, observation: Array, q: Array, v: Array) -> Array:
        """Return a, the desired acceleration [n x 2] rad/s^2."""
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        w = np.array(self.frequency)
        return r_ddot + w**2 * (r - q) + 2.0 * w * (r_dot - v)
