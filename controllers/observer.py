"""The extended state observer: position, velocity and the acceleration that the nominal model does not explain.

Per joint the nominally linearised arm is x'' = u + f, where u is what the model makes of the applied torque and f all the
rest: wrong parameters, friction, disturbance. The observer takes f for a third state (Han 2009, "From PID to active disturbance
rejection control", IEEE TIE 56(3), §IV) and puts its three poles at -w (Gao 2003, "Scaling and bandwidth-parameterization
based controller tuning", ACC).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fbl_gym.arm import Array
from fbl_gym.checks import Pair


@dataclass(frozen=True)
class ExtendedStateObserver:
    """The observer of both joints of n lanes, in discrete time: stable at every rate.

    It is the current estimator of the plant held between samples (Miklosovic, Radke and Gao 2006, "Discrete implementation
    and generalization of the extended state observer", ACC): its error obeys e(k+1) = (F - F L H) e(k), whose three
    eigenvalues are exp(-w dt). What it foresees [n x 2 x 3] (joint, then position, velocity and f) is its only state.

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
        """What is foreseen of the first sample: this position and velocity, and no disturbance.  [n x 2] each."""
        return np.stack([position, velocity, np.zeros_like(position)], axis=-1)

    def correct(self, foreseen: Array, position: Array) -> Array:
        """The estimate [n x 2 x 3] at a sample, from what was foreseen of it and the measured position [n x 2]."""
        # x = x + L (y - H x)
        return foreseen + self.gain * (position - foreseen[..., 0])[..., None]

    def foresee(self, estimate: Array, acceleration: Array) -> Array:
        """What the next sample will be [n x 2 x 3] under the nominal acceleration u [n x 2], held until then."""
        q, v, f = np.moveaxis(estimate, -1, 0)
        dt, a = self.dt, acceleration + f
        # x = F x + G u
        return np.stack([q + dt * v + 0.5 * dt**2 * a, v + dt * a, f], axis=-1)
