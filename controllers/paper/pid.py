"""The paper's PID on the nominally linearised arm (§2.2)."""

from dataclasses import dataclass

import numpy as np

from controllers.base import Array, Gain, IntegralLaw, IntegralState, State, pair


@dataclass(frozen=True)
class PidFlm(IntegralLaw):
    """The paper's PID for each joint, through nominal feedback linearisation (§2.2).

        a = r'' + kp e + kd e' + ki int(e) dt,    e = r - q,    torque = M a + C v + G

    With an exact model the error obeys e''' + kd e'' + kp e' + ki e = 0. The paper prints "P, I, D
    = 10, 3, 0", which is unstable; the defaults read it as P = 10, D = 3, I = 0. It does not say
    that r'' is fed forward. The integral pauses where the torque saturates.

    Sensors: position and velocity.

    Args:
        kp: proportional gain [1/s^2], per joint.
        ki: integral gain [1/s^3], per joint.
        kd: derivative gain [1/s], per joint.
    """

    kp: Gain = pair(10.0, unit="1/s^2", tune=(1.0, 1e4))
    ki: Gain = pair(0.0, unit="1/s^3", tune=(1e-2, 1e4))
    kd: Gain = pair(3.0, unit="1/s", tune=(1.0, 200.0))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next integral."""
        q, v, r, r_dot, r_ddot = self.motion(observation)
        error = r - q
        a = r_ddot + np.array(self.kp) * error + np.array(self.kd) * (r_dot - v) + np.array(self.ki) * state.integral
        torque, integral = self.integrating(q, v, a, state.integral, error)
        return torque, IntegralState(integral)
