"""The extended state observer of ADRC and NMPC: position, velocity, unexplained acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbl_gym.arm import Array
from fbl_gym.checks import Pair


@dataclass(frozen=True)
class ExtendedStateObserver:
    """The extended state observer of both joints, in discrete time.

    Each joint of the nominally linearised arm is x'' = u + f. u is the nominal acceleration under
    the applied torque, and f all the rest: wrong parameters, friction, disturbance. f is the third
    state (Han, "From PID to active disturbance rejection control", IEEE TIE 56(3), 2009, §IV). All
    three poles lie at -w (Gao, "Scaling and bandwidth-parameterization based controller tuning",
    ACC 2003).

    The observer is the current estimator of the plant held between samples (Miklosovic, Radke and
    Gao, "Discrete implementation and generalization of the extended state observer", ACC 2006). Its
    error obeys e(k+1) = (F - F L H) e(k) with three eigenvalues exp(-w dt), so it is stable at
    every rate. Its state is the prediction [n x 2 x 3]: for each joint position, velocity and f at
    the next sample.

    Args:
        dt: sample time [s].
        bandwidth: w [rad/s], per joint.
    """

    dt: float
    bandwidth: Pair

    @property
    def gain(self) -> Array:
        """L [2 x 3], per joint."""
        z, dt = np.exp(-np.array(self.bandwidth) * self.dt), self.dt
        # det(s I - F + F L H) = (s - z)^3
        return np.stack([1.0 - z**3, 1.5 * (1.0 - z) ** 2 * (1.0 + z) / dt, (1.0 - z) ** 3 / dt**2], axis=-1)

    def initial(self, position: Array, velocity: Array) -> Array:
        """Return the prediction of the first sample [n x 2 x 3], without disturbance."""
        return np.stack([position, velocity, np.zeros_like(position)], axis=-1)

    def correct(self, prediction: Array, position: Array) -> Array:
        """Return the estimate at a sample [n x 2 x 3], from its prediction and the position."""
        # x = x + L (y - H x)
        return prediction + self.gain * (position - prediction[..., 0])[..., None]

    def predict(self, estimate: Array, acceleration: Array) -> Array:
        """Return the prediction of the next sample [n x 2 x 3].

        The acceleration is u, the nominal one, held until the next sample [n x 2] rad/s^2.
        """
        q, v, f = np.moveaxis(estimate, -1, 0)
        dt, a = self.dt, acceleration + f
        # x = F x + G u
        return np.stack([q + dt * v + 0.5 * dt**2 * a, v + dt * a, f], axis=-1)
