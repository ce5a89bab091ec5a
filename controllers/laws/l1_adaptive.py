"""L1 adaptive control: fast estimation, and a low-pass filter on all that it adds."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controllers.base import Acting, Array, Gain, State, pair
from controllers.laws.computed_torque import ComputedTorque


class L1State(NamedTuple):
    """State of `L1Adaptive`, the arrays [n x 2]."""

    predicted: Array  # v^ [rad/s]
    filtered: Array  # C(s) f^ [rad/s^2]
    acting: Acting


@dataclass(frozen=True)
class L1Adaptive(ComputedTorque):
    """L1 adaptive control on the nominal linearisation, with the piecewise constant adaptive law.

        torque = M (a - C(s) f^) + C v + G,    a = r'' + w^2 (r - q) + 2 w (r' - v)
        v^' = u + f^ - p (v^ - v),    f^ = -p / (exp(p dt) - 1) (v^ - v) over the next interval

    Each joint of the nominally linearised arm is v' = u + f: u is the nominal acceleration under
    the torque within its limits as the known drive applies it, and f all the rest. v^ is the
    predictor's velocity, and C(s) = bandwidth / (s + bandwidth) the filter that gives the method
    its robustness. The law is close to a disturbance observer of that bandwidth, and a constant
    load leaves a small error.

    Sensors: position and velocity. Source: Hovakimyan and Cao, "L1 Adaptive Control Theory", 2010,
    §3.3 (piecewise constant adaptive law).

    Args:
        frequency: w [rad/s], per joint: both poles of the error's reference model are -w.
        bandwidth: of the filter C(s) [rad/s], per joint.
        pole: p, the pole of the predictor is -p [rad/s], per joint.
    """

    frequency: Gain = 10.0
    bandwidth: Gain = pair(30.0, unit="rad/s", above=0, tune=(2.0, 300.0))
    pole: Gain = pair(5.0, unit="rad/s", above=0)

    def initial(self, observation: Array) -> State:
        """Return the state: the predictor's velocity, C(s) f^, zero, and the drive at rest."""
        q, v = self.read(observation, "position", "velocity")
        return L1State(v, np.zeros_like(v), self.drive.hold(self.holding(q)))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        q, v = self.read(observation, "position", "velocity")
        dt, pole = self.interface.control_dt, np.array(self.pole)
        f = -pole / np.expm1(pole * dt) * (state.predicted - v)
        filtered = state.filtered - np.expm1(-np.array(self.bandwidth) * dt) * (f - state.filtered)
        torque = self.inverse(q, v, self.acceleration(observation, q, v) - filtered)
        acting = self.drive.act(state.acting, self.interface.saturate(torque))
        keep = np.exp(-pole * dt)
        predicted = v + dt * self.forward(q, v, acting.mean) + keep * (state.predicted - v) + (1.0 - keep) / pole * f
        return torque, L1State(predicted, filtered, acting)
