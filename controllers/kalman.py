"""The Kalman filter of §3.2: per joint, driven by the measured acceleration and corrected by the measured position."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter

from controllers.cascade import CascadeFlm
from controllers.policy import State
from fbl_gym.arm import Array
from fbl_gym.checks import check_number
from fbl_gym.records import set_fields

PAPER_SIGMA = float(np.sqrt(0.1))
"""Square root of the paper's 0.1, the variance of acceleration and position noise in (17) and (18), taken per sample."""


@lru_cache(maxsize=64)
def gains(dt: float, acceleration_sigma: float, position_sigma: float) -> Array:
    """The gain K of each sample until it has converged, [k x 2], from filterpy.

    In discrete time (15)-(18) are x = (position, velocity), F = [[1, dt], [0, 1]], B = (dt^2 / 2, dt), H = (1, 0), with the
    measured acceleration held over a sample as the input. Its noise is the process noise: Q = sigma^2 B B'
    (`Q_discrete_white_noise`; Labbe, "Kalman and Bayesian Filters in Python", ch. 8). The recursion does not look at the data,
    so all joints and lanes share it.

    Args:
        dt: sample time [s].
        acceleration_sigma, position_sigma: noise of each sample [rad/s^2], [rad].
    """
    kalman = KalmanFilter(dim_x=2, dim_z=1)
    kalman.F = np.array([[1.0, dt], [0.0, 1.0]])
    kalman.H = np.array([[1.0, 0.0]])
    kalman.Q = Q_discrete_white_noise(2, dt, acceleration_sigma**2)
    kalman.R = np.array([[position_sigma**2]])
    kalman.P = np.diag([position_sigma**2, 0.01])  # the arm starts where it says it is, within 0.1 rad/s
    found: list[Array] = []
    while len(found) < 200_000:
        kalman.predict()
        kalman.update(np.zeros((1, 1)))
        found.append(kalman.K[:, 0].copy())
        if len(found) > 100 and np.allclose(found[-1], found[-100], rtol=1e-9, atol=0.0):
            break
    table = np.array(found)
    table.setflags(write=False)
    return table


@dataclass(frozen=True)
class JointKalman:
    """The filter of both joints of n lanes.

    Args:
        dt: sample time [s].
        acceleration_sigma, position_sigma: noise of each sample [rad/s^2], [rad].

    Its state: the estimate [n x 2 x 2] (joint, then position and velocity), and how many samples it has seen [n].
    """

    dt: float
    acceleration_sigma: float
    position_sigma: float

    def initial(self, position: Array, velocity: Array) -> State:
        """The first estimate, and a count of zero [n].  position: measured, [n x 2] rad; velocity: guessed, [n x 2] rad/s."""
        return np.stack([position, velocity], axis=-1), np.zeros(len(position), dtype=int)

    def update(self, estimate: Array, count: Array, position: Array, acceleration: Array) -> tuple[Array, Array, Array]:
        """Equation (19) over a sample: predict with the acceleration measured in it, correct with the position at its end.

        Args:
            estimate: position and velocity of each joint, [n x 2 x 2].
            count: samples so far, [n].
            position: measured at the sample's end, [n x 2] rad.
            acceleration: measured in it, [n x 2] rad/s^2.

        Returns:
            Estimate [n x 2 x 2], count [n] and innovation [n x 2].
        """
        table = gains(self.dt, self.acceleration_sigma, self.position_sigma)
        gain = table[np.minimum(count, len(table) - 1)]
        q, v = estimate[..., 0], estimate[..., 1]
        # x = F x + B u
        q = q + self.dt * v + 0.5 * self.dt**2 * acceleration
        v = v + self.dt * acceleration
        # x = x + K (y - H x)
        innovation = position - q
        q, v = q + gain[:, :1] * innovation, v + gain[:, 1:] * innovation
        return np.stack([q, v], axis=-1), count + 1, innovation


@dataclass(frozen=True)
class RobustFlm(CascadeFlm):
    """The robust controller of §3: the cascade on positions and velocities that a Kalman filter estimates.

    It needs no velocity sensor. The filter leans on the accelerometer: a bias b there gives an error of about
    b (position_sigma / acceleration_sigma) in position at steady state.

    Args:
        kp, velocity_p, velocity_i: as in `CascadeFlm`.
        acceleration_sigma, position_sigma: noise of the sensors per sample, as from their data sheets [rad/s^2], [rad]; only
            their ratio matters once the gain has converged. The defaults are the paper's: both sqrt(0.1).
    """

    acceleration_sigma: float = PAPER_SIGMA
    position_sigma: float = PAPER_SIGMA

    needs: ClassVar[tuple[str, ...]] = ("position", "acceleration")
    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {**CascadeFlm.ranges, "position_sigma": (1e-4, 1.0)}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("acceleration_sigma", "position_sigma"):
            set_fields(self, **{name: check_number(name, getattr(self, name), above=0)})

    @property
    def filter(self) -> JointKalman:
        return JointKalman(self.interface.control_dt, self.acceleration_sigma, self.position_sigma)

    def initial(self, observation: Array) -> State:
        position, velocity = self.read(observation, "position", "reference_velocity")
        return (np.zeros_like(position), *self.filter.initial(position, velocity), np.zeros(len(position), dtype=bool))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        integral, estimate, count, begun = state
        position, acceleration = self.read(observation, "position", "acceleration")
        updated, more, _ = self.filter.update(estimate, count, position, acceleration)
        # The first observation of an episode ends no sample: there is nothing to predict yet.
        estimate = np.where(begun[:, None, None], updated, estimate)
        count = np.where(begun, more, count)
        q, v = estimate[..., 0], estimate[..., 1]
        torque, integral = self.drive(observation, q, v, integral, self.interface.nominal)
        return torque, (integral, estimate, count, np.ones_like(begun))
