"""Observers: the motion of both joints, estimated from the measured position."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_discrete_are

from fbl_gym.model.arm import Array
from fbl_gym.records.checks import Pair
from fbl_gym.records.record import Record, number, pair

TUNE = (15.0, 300.0)
"""Tuning range of an observer's bandwidth [rad/s]."""


@dataclass(frozen=True)
class Observer(Record):
    """Base of the observers: each estimates both joints' motion from the measured position.

    `correct` returns the estimate from the memory and the position that is measured at a sample
    [n x 2] rad. `predict` returns the memory for the next sample from the estimate and the nominal
    acceleration u [n x 2] rad/s^2.

    An estimate [n x 2 x 4] is position, velocity, acceleration and f of each joint. f is the
    acceleration that the nominal model does not explain; zero, if the observer does not estimate
    it. The memory [n x 2 x 4] is all that changes from sample to sample.

    Args:
        dt: sample time [s].
    """

    dt: float

    def initial(self, position: Array, velocity: Array) -> Array:
        """Return the memory before an episode, from the motion [n x 2] rad and rad/s."""
        zeros = np.zeros_like(position)
        return np.stack([position, velocity, zeros, zeros], axis=-1)


@dataclass(frozen=True)
class Eso(Observer):
    """The extended state observer, driven by the nominal acceleration u.

    Each joint of the nominally linearised arm is x'' = u + f. u is the nominal acceleration under
    the applied torque, and f all the rest: wrong parameters, friction, disturbance. f is the third
    state (Han, "From PID to active disturbance rejection control", IEEE TIE 56(3), 2009, §IV), so a
    constant load leaves no error of the velocity. All three poles lie at -bandwidth (Gao, "Scaling
    and bandwidth-parameterization based controller tuning", ACC 2003).

    The observer is the current estimator of the plant held between samples (Miklosovic, Radke and
    Gao, "Discrete implementation and generalization of the extended state observer", ACC 2006). Its
    error obeys e(k+1) = (F - F L H) e(k) with three eigenvalues exp(-bandwidth dt), so it is stable
    at every rate. The memory is the prediction of position, velocity and f, and u.

    Args:
        bandwidth: all three poles are minus this [rad/s], per joint.
    """

    bandwidth: Pair | float = pair(80.0, unit="rad/s", above=0, tune=TUNE)

    @cached_property
    def gain(self) -> Array:
        """L [2 x 3], per joint."""
        z, dt = np.exp(-np.array(self.bandwidth) * self.dt), self.dt
        # det(s I - F + F L H) = (s - z)^3
        return np.stack([1.0 - z**3, 1.5 * (1.0 - z) ** 2 * (1.0 + z) / dt, (1.0 - z) ** 3 / dt**2], axis=-1)

    def correct(self, memory: Array, position: Array) -> Array:
        """Return the estimate at a sample."""
        # x = x + L (y - H x)
        q, v, f = (memory[..., :3] + self.gain * (position - memory[..., 0])[..., None]).transpose(2, 0, 1)
        return np.stack([q, v, memory[..., 3] + f, f], axis=-1)

    def predict(self, estimate: Array, u: Array) -> Array:
        """Return the prediction of position, velocity and f, and u."""
        q, v, _, f = estimate.transpose(2, 0, 1)
        dt, a = self.dt, u + f
        # x = F x + G u
        return np.stack([q + dt * v + 0.5 * dt**2 * a, v + dt * a, f, u], axis=-1)


@dataclass(frozen=True)
class Kalman(Observer):
    """The Kalman filter of a double integrator at steady state, driven by the nominal acceleration.

    Only the ratio of the noises counts: bandwidth^2 is the noise of the acceleration over that of
    the position, both per sample. At a fast rate the poles have this frequency,
    and the damping 0.71. A constant load f leaves an error of the velocity.

    Args:
        bandwidth: of the filter [rad/s].
    """

    bandwidth: float = number(100.0, unit="rad/s", above=0, tune=TUNE)

    @cached_property
    def gain(self) -> Array:
        """K at steady state [2]."""
        f, b = np.array([[1.0, self.dt], [0.0, 1.0]]), np.array([[0.5 * self.dt**2], [self.dt]])
        p = solve_discrete_are(f.T, np.array([[1.0], [0.0]]), self.bandwidth**4 * b @ b.T, np.eye(1))
        return p[:, 0] / (p[0, 0] + 1.0)

    def correct(self, memory: Array, position: Array) -> Array:
        """Return the estimate at a sample; the acceleration is that of the estimated velocity."""
        q, v, u, f = memory.transpose(2, 0, 1)
        innovation = position - q
        change = self.gain[1] * innovation
        return np.stack([q + self.gain[0] * innovation, v + change, u + change / self.dt, f], axis=-1)

    def predict(self, estimate: Array, u: Array) -> Array:
        """Return the prediction of position and velocity, and u."""
        q, v, _, f = estimate.transpose(2, 0, 1)
        return np.stack([q + self.dt * v + 0.5 * self.dt**2 * u, v + self.dt * u, u, f], axis=-1)


OBSERVERS: dict[str, type[Eso | Kalman]] = {"kalman": Kalman, "eso": Eso}
"""The observers, by name."""
