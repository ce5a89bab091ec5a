"""LQG with integral action, on the nominally linearised arm."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg import solve_discrete_are

from controllers.base import Array, Gain, State, number, pair
from controllers.paper.kalman import FilteredLaw, RobustState


def plant(dt: float) -> tuple[Array, Array]:
    """Return F [3 x 3] and G [3 x 1] of x = (z, e, e'), z the sum of e dt, and e'' = u held."""
    return np.array([[1.0, dt, 0.0], [0.0, 1.0, dt], [0.0, 0.0, 1.0]]), np.array([[0.0], [0.5 * dt**2], [dt]])


@lru_cache(maxsize=64)
def regulator(dt: float, integral: float, position: float, velocity: float) -> Array:
    """Return the gain K [3] of the optimal regulator u = -K x.

    It minimises the sum of (integral z)^2 + (position e)^2 + (velocity e')^2 + u^2:

        P = Q + F' P (F - G K),    K = (1 + G' P G)^-1 G' P F

    (Anderson and Moore, "Optimal Control", 1990, §2.4). The weights are in 1/s^3, 1/s^2 and 1/s.
    """
    f, g = plant(dt)
    p = solve_discrete_are(f, g, np.diag([integral, position, velocity]) ** 2, np.eye(1))
    return np.linalg.solve(np.eye(1) + g.T @ p @ g, g.T @ p @ f)[0]


@dataclass(frozen=True)
class Lqg(FilteredLaw):
    """LQG with integral action.

        a = r'' + K (z, r - q, r' - v),    z = int(r - y) dt,    torque = M a + C v + G

    K is the optimal gain (`regulator`). q and v come from the Kalman filter of the paper
    (`JointKalman`). y is the measured position, so an accelerometer bias leaves no lasting error.
    The integral pauses where the torque saturates.

    Sensors: position and acceleration. Source: Anderson and Moore, "Optimal Control", 1990, §2.4.

    Args:
        integral: weight of z [1/s^3], per joint, against 1 for acceleration.
        position: weight of the position error [1/s^2], per joint.
        velocity: weight of the velocity error [1/s], per joint.
        acceleration_sigma: noise of the accelerometer per sample [rad/s^2].
        position_sigma: noise of the encoder per sample [rad]. Once the filter has converged, only
            the ratio of both sigmas matters.
    """

    integral: Gain = pair(1000.0, unit="1/s^3", above=0, tune=(10.0, 1e4))
    position: Gain = pair(100.0, unit="1/s^2", above=0, tune=(10.0, 1000.0))
    velocity: Gain = pair(20.0, unit="1/s", above=0, tune=(1.0, 100.0))
    acceleration_sigma: float = number(0.5, unit="rad/s^2", above=0)
    position_sigma: float = number(5e-3, unit="rad", above=0, tune=(1e-4, 0.1))

    @cached_property
    def gain(self) -> Array:
        """K [2 x 3], per joint."""
        weights = zip(self.integral, self.position, self.velocity, strict=True)  # type: ignore[arg-type]
        return np.array([regulator(self.interface.control_dt, *joint) for joint in weights])

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        y, y_ddot = self.read(observation, "position", "acceleration")
        r, r_dot, r_ddot = self.reference(observation)
        kalman = self.filter.update(state.kalman, y, y_ddot)
        q, v = kalman.position, kalman.velocity
        # e'' = r'' - a = u = -K x
        x = np.stack([state.integral, r - q, r_dot - v], axis=-1)
        torque, integral = self.integrating(q, v, r_ddot + (self.gain * x).sum(axis=-1), state.integral, r - y)
        return torque, RobustState(integral, kalman)
