"""The paper's cascade: an inner velocity loop and an outer position loop (§3.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from controllers.feedback_linearization import linearize, winds_up
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import ArmParameters, Array
from fbl_gym.checks import Pair
from fbl_gym.records import pair


@dataclass(frozen=True)
class CascadeFlm(TorqueLaw):
    """The paper's cascade: an inner velocity PI and an outer P loop (§3.1, equation (8)).

        a = P e_v + I int(e_v) dt,    e_v = r' + Kp (r - q) - v,    torque = M a + C v + G

    With an exact model and a constant reference the inner loop has the poles of s^2 + P s + I, and
    the outer one the pole -Kp. As in the paper, r'' is not fed forward. The integral pauses where
    the torque saturates.

    Sensors: position and velocity. Source: Wang, Wang and Brdys, Cogent Engineering 3:1173529,
    2016, §3.1, equation (8).

    Args:
        kp: Kp of the outer loop [1/s], per joint. The paper leaves it open.
        velocity_p: P of the inner loop [1/s], per joint. The defaults are the paper's.
        velocity_i: I of the inner loop [1/s^2], per joint. The defaults are the paper's.
    """

    kp: Pair | float = pair(10.0, unit="1/s", tune=(1.0, 100.0))
    velocity_p: Pair | float = pair((30.0, 35.0), unit="1/s", tune=(5.0, 200.0))
    velocity_i: Pair | float = pair((13.0, 20.0), unit="1/s^2", tune=(1.0, 2000.0))

    def initial(self, observation: Array) -> State:
        """Return the state: the integral of the velocity error [n x 2], zero."""
        return (np.zeros((len(observation), 2)),)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next integral."""
        q, v = self.read(observation, "position", "velocity")
        torque, integral = self.drive(observation, q, v, state[0], self.interface.nominal)
        return torque, (integral,)

    def drive(
        self,
        observation: Array,
        q: Array,
        v: Array,
        integral: Array,
        model: ArmParameters | Array,
        schedule: Array | float = 1.0,
    ) -> tuple[Array, Array]:
        """Return the torque [n x 2] N m of both loops, and the next integral [n x 2].

        q [rad] and v [rad/s] are measured or estimated. The model is an arm, or estimated lumped
        parameters [n x 5]. The schedule multiplies the inner loops' error, in P and in the
        integral; see `gain_scheduling.py`.
        """
        r, r_dot = self.read(observation, "reference_position", "reference_velocity")
        error = schedule * (r_dot + np.array(self.kp) * (r - q) - v)
        a = np.array(self.velocity_p) * error + np.array(self.velocity_i) * integral
        torque = linearize(model, q, v, a)
        pause = winds_up(self.interface, model, q, v, a, torque, error)
        return torque, integral + np.where(pause, 0.0, error * self.interface.control_dt)
