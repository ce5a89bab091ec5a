"""Super-twisting and terminal sliding mode on the nominal linearisation."""

from dataclasses import dataclass

import numpy as np

from controllers.base import Array, Gain, IntegralLaw, IntegralState, State, number, pair
from controllers.laws.computed_torque import ComputedTorqueDob


@dataclass(frozen=True)
class SlidingMode(IntegralLaw):
    """Super-twisting sliding mode.

        a = r'' + slope e' + k1 |s|^(1/2) sign(s) + z,    z' = k2 sign(s),    s = e' + slope e
        torque = M a + C v + G

    k1 = 1.5 L^(1/2) and k2 = 1.1 L. A sampled sign chatters: within the boundary layer the law is
    linear, s' = -k1 layer^(-1/2) s - z and z' = k2 s / layer, which gives up the finite-time
    convergence. Its damping ratio is 0.72 for every gain. z pauses where the torque saturates.

    Sensors: position and velocity. Source: Levant, "Sliding order and sliding accuracy in sliding
    mode control", Int. J. Control 58(6), 1993.

    Args:
        slope: of the sliding surface [1/s], per joint.
        bound: L [rad/s^3], per joint.
        layer: half width of the boundary layer [rad/s]; 0: the plain sign.
    """

    slope: Gain = pair(15.0, unit="1/s", above=0, tune=(2.0, 80.0))
    bound: Gain = pair(90.0, unit="rad/s^3", above=0, tune=(5.0, 5000.0))
    layer: float = number(0.3, unit="rad/s", low=0, tune=(0.01, 5.0))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next z."""
        q, v, r, r_dot, r_ddot = self.motion(observation)
        slope, bound = np.array(self.slope), np.array(self.bound)
        s = r_dot - v + slope * (r - q)
        sign = np.sign(s) if self.layer == 0.0 else np.clip(s / self.layer, -1.0, 1.0)
        size = np.maximum(np.abs(s), self.layer)
        a = r_ddot + slope * (r_dot - v) + 1.5 * np.sqrt(bound * size) * sign + state.integral
        torque, integral = self.integrating(q, v, a, state.integral, 1.1 * bound * sign)
        return torque, IntegralState(integral)


@dataclass(frozen=True)
class TerminalSlidingMode(ComputedTorqueDob):
    """Nonsingular terminal sliding mode with the disturbance observer of `ComputedTorqueDob`.

        torque = M a + C v + G + d^,    s = e + |e'|^power sign(e') / w
        a = r'' + w / power |e'|^(2 - power) sign(e') + bound sat(w^2 s / bound)

    On s = 0 the error is gone in finite time, and a has no negative power of e', so it is never
    singular. Speeds are counted in rad/s. The observer takes off the model's errors, so the sliding
    mode bears those of the observer alone. With power = 1 and a large bound the law is
    `ComputedTorqueDob`.

    Sensors: position and velocity. Source: Feng, Yu and Man, "Non-singular terminal sliding mode
    control of rigid manipulators", Automatica 38(12), 2002; with an observer: Chen,
    Ballance, Gawthrop and O'Reilly, "A nonlinear disturbance observer for robotic manipulators",
    IEEE TIE 47(4), 2000.

    Args:
        frequency: w [rad/s], per joint.
        power: of e' in s.
        bound: of the error of d^, as an acceleration [rad/s^2], per joint. The boundary layer is
            |s| < bound / w^2.
    """

    power: float = number(1.2, low=1, high=1.9, tune=(1.02, 1.8))
    bound: Gain = pair(20.0, unit="rad/s^2", above=0, tune=(1.0, 200.0))

    def acceleration(self, observation: Array, q: Array, v: Array) -> Array:
        """Return a, the desired acceleration [n x 2] rad/s^2."""
        r, r_dot, r_ddot = self.reference(observation)
        w, bound, rate = np.array(self.frequency), np.array(self.bound), r_dot - v
        s = r - q + np.sign(rate) * np.abs(rate) ** self.power / w
        ahead = w / self.power * np.sign(rate) * np.abs(rate) ** (2.0 - self.power)
        return r_ddot + ahead + np.clip(w**2 * s, -bound, bound)
