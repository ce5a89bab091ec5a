"""LQG with integral action on the nominally linearised arm: the optimal regulator on what the Kalman filter estimates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from scipy.linalg import solve_discrete_are

from controllers.feedback_linearization import linearize, winds_up
from controllers.kalman import JointKalman
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array
from fbl_gym.checks import Pair, check_number, check_pair
from fbl_gym.records import set_fields


def plant(dt: float) -> tuple[Array, Array]:
    """F [3 x 3] and G [3 x 1] of x = (z, e, e') with e'' = u held over a sample, and z the sum of e dt."""
    return np.array([[1.0, dt, 0.0], [0.0, 1.0, dt], [0.0, 0.0, 1.0]]), np.array([[0.0], [0.5 * dt**2], [dt]])


@lru_cache(maxsize=64)
def regulator(dt: float, integral: float, position: float, velocity: float) -> Array:
    """The gain K [3] of u = -K x that minimises the sum of (integral z)^2 + (position e)^2 + (velocity e')^2 + u^2.

    P = Q + F' P (F - G K), K = (1 + G' P G)^-1 G' P F (Anderson and Moore, "Optimal Control", 1990, §2.4). As dt goes to zero,
    the gain on z goes to `integral`; with integral = 0, those on e and e' to `position` and sqrt(velocity^2 + 2 position).

    Args:
        dt: sample time [s].
        integral, position, velocity: weights, as gains [1/s^3], [1/s^2], [1/s].
    """
    f, g = plant(dt)
    p = solve_discrete_are(f, g, np.diag([integral, position, velocity]) ** 2, np.eye(1))
    k = np.linalg.solve(np.eye(1) + g.T @ p @ g, g.T @ p @ f)[0]
    k.setflags(write=False)
    return k


@dataclass(frozen=True)
class Lqg(TorqueLaw):
    """a = r'' + K (z, r - q, r' - v) through the nominal mapping, with z the integral of r - y.

    K is the optimal gain (`regulator`), q and v come from the Kalman filter of §3.2 (`JointKalman`), and y is the position as
    measured, so that a filter misled by its accelerometer leaves no lasting error. The poles are those of the regulator and
    of the filter: neither knows of the other.

    Args:
        integral: weight of z [1/s^3], per joint.
        position: weight of the error [1/s^2], per joint.
        velocity: weight of its rate [1/s], per joint; all against 1 for acceleration.
        acceleration_sigma, position_sigma: noise of the sensors per sample [rad/s^2], [rad]; only their ratio matters once the
            filter has converged.
    """

    integral: Pair | float = 3000.0
    position: Pair | float = 200.0
    velocity: Pair | float = 40.0
    acceleration_sigma: float = 0.5
    position_sigma: float = 5e-3

    needs: ClassVar[tuple[str, ...]] = ("position", "acceleration")
    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {"integral": (10.0, 1e4), "position": (10.0, 1000.0), "velocity": (1.0, 100.0), "position_sigma": (1e-4, 0.1)}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("integral", "position", "velocity"):
            set_fields(self, **{name: check_pair(name, getattr(self, name), above=0)})
        for name in ("acceleration_sigma", "position_sigma"):
            set_fields(self, **{name: check_number(name, getattr(self, name), above=0)})

    @property
    def gain(self) -> Array:
        """K [2 x 3], per joint."""
        weights = zip(*(check_pair("", x) for x in (self.integral, self.position, self.velocity)), strict=True)
        return np.array([regulator(self.interface.control_dt, *joint) for joint in weights])

    @property
    def filter(self) -> JointKalman:
        return JointKalman(self.interface.control_dt, self.acceleration_sigma, self.position_sigma)

    def initial(self, observation: Array) -> State:
        position, velocity = self.read(observation, "position", "reference_velocity")
        return (np.zeros_like(position), *self.filter.initial(position, velocity), np.zeros(len(position), dtype=bool))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        integral, estimate, count, begun = state
        y, y_ddot = self.read(observation, "position", "acceleration")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        updated, more, _ = self.filter.update(estimate, count, y, y_ddot)
        # The first observation of an episode ends no sample: there is nothing to predict yet.
        estimate = np.where(begun[:, None, None], updated, estimate)
        count = np.where(begun, more, count)
        q, v = estimate[..., 0], estimate[..., 1]
        nominal, error = self.interface.nominal, r - y
        # e'' = r'' - a = u = -K x
        x = np.stack([integral, r - q, r_dot - v], axis=-1)
        a = r_ddot + (self.gain * x).sum(axis=-1)
        torque = linearize(nominal, q, v, a)
        pause = winds_up(self.interface, nominal, q, v, a, torque, error)
        integral = integral + np.where(pause, 0.0, error * self.interface.control_dt)
        return torque, (integral, estimate, count, np.ones_like(begun))
