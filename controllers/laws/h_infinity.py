"""H-infinity loop shaping, on the nominally linearised arm."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.interpolate import pade
from scipy.linalg import solve_continuous_are
from scipy.signal import cont2discrete, tf2ss

from controllers.base import Array, Gain, State, TorqueLaw, pair

#: Zero of the weight's integral action, in multiples of the bandwidth.
INTEGRAL = 0.2

#: Ratio of gamma to the least one, at which the controller would be singular.
SLACK = 1.05

#: Dead times of a design, in multiples of 1 / bandwidth.
#:
#: Below, the delay's approximation is ill-conditioned; above, the controller itself is unstable.
LEAST, MOST = 0.05, 1.5


class HInfinityState(NamedTuple):
    """State of `HInfinity`."""

    integral: Array  # of the robust controller's output [n x 2]
    memory: Array  # of the robust controller [n x 2 x 5]


@lru_cache(maxsize=64)
def robust_controller(dead: float) -> tuple[Array, Array, Array, float]:
    """Return A [5 x 5], B [5 x 1] and C [1 x 5] of the controller of a shaped plant, and gamma.

    The shaped plant is (s + INTEGRAL) / s^3 exp(-dead s), with a Padé approximation of second
    order. The controller -C (s - A)^-1 B stabilises all plants whose normalised coprime factors
    are off by less than 1 / gamma (Skogestad and Postlethwaite, "Multivariable Feedback Control",
    2005, equations 9.63 to 9.69).

    Args:
        dead: time, in multiples of 1 / bandwidth.
    """
    above, below = pade(np.cumprod([1.0, *(-dead / k for k in range(1, 5))]), 2)
    a, b, c, _ = tf2ss(np.polymul(above, [1.0, INTEGRAL]), np.polymul(below, [1.0, 0.0, 0.0, 0.0]))
    x = solve_continuous_are(a, b, c.T @ c, np.eye(1))
    z = solve_continuous_are(a.T, c.T, b @ b.T, np.eye(1))
    gamma = SLACK * float(np.sqrt(1.0 + np.linalg.eigvals(x @ z).real.max()))
    gain = gamma**2 * np.linalg.solve(((1.0 - gamma**2) * np.eye(5) + x @ z).T, z @ c.T)
    return a - b @ b.T @ x + gain @ c, gain, b.T @ x, gamma


@dataclass(frozen=True)
class HInfinity(TorqueLaw):
    """H-infinity loop shaping of McFarlane and Glover, with the position sensor alone.

        a = r'' + w^2 (u + 0.2 w int(u) dt),    u = K (r - q),    torque = M a + C r' + G

    Each joint of the linearised arm is a double integrator behind the known dead time: half a
    sample, and the drive's delay and lag. K is the controller that bears the largest error of its
    normalised coprime factors, discretised by Tustin's rule. The integral pauses where the torque
    saturates.

    Sensors: position. Source: McFarlane and Glover, "A loop shaping design procedure using
    H-infinity synthesis", IEEE TAC 37(6), 1992.

    Args:
        bandwidth: w [rad/s], per joint: of the shaped plant without its dead time.
    """

    bandwidth: Gain = pair(25.0, unit="rad/s", above=0, tune=(5.0, 200.0))

    needs: ClassVar[tuple[str, ...]] = ("position",)

    @cached_property
    def controller(self) -> tuple[Array, Array, Array, Array]:
        """A [2 x 5 x 5], B [2 x 5], C [2 x 5] and D [2] of both joints, discrete."""
        joints, dead = [], 0.5 * self.drive.dt + self.drive.delay + self.drive.lag
        for w in self.bandwidth:  # type: ignore[union-attr]
            a, b, c, _ = robust_controller(min(max(w * dead, LEAST), MOST))
            joints.append(cont2discrete((w * a, w * b, -c, 0.0), self.interface.control_dt, "bilinear")[:4])
        a, b, c, d = (np.array(matrix) for matrix in zip(*joints, strict=True))
        return a, b[..., 0], c[:, 0], d[:, 0, 0]

    def initial(self, observation: Array) -> State:
        """Return the state before the first observation."""
        return HInfinityState(np.zeros((len(observation), 2)), np.zeros((len(observation), 2, 5)))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next state."""
        (q,) = self.read(observation, "position")
        r, r_dot, r_ddot = self.reference(observation)
        a, b, c, d = self.controller
        error, w = r - q, np.array(self.bandwidth)
        u = (c * state.memory).sum(axis=-1) + d * error
        memory = (a * state.memory[:, :, None]).sum(axis=-1) + b * error[..., None]
        a = r_ddot + w**2 * (u + INTEGRAL * w * state.integral)
        torque, integral = self.integrating(q, r_dot, a, state.integral, u)
        return torque, HInfinityState(integral, memory)
