"""The paper's adaptive controller: parameter estimator, gain scheduling and cascade (§4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from controllers.cascade import CascadeFlm
from controllers.estimator import estimate, lumped_of, point_masses
from controllers.gain_scheduling import schedule
from controllers.policy import State
from fbl_gym.arm import Array, regressor
from fbl_gym.records import declared, number

SAMPLES = 3
"""Samples of an estimate: the paper's three."""


def _check_alpha(name: str, value: object) -> tuple[tuple[float, ...], ...]:
    alpha = np.asarray(value, dtype=float)
    if alpha.shape != (2, 2) or not np.isfinite(alpha).all() or (alpha < 0).any():
        raise ValueError(f"{name} must be four numbers [2 x 2], zero or more, got {value!r}")
    return tuple(tuple(float(x) for x in row) for row in alpha)


@dataclass(frozen=True)
class AdaptiveFlm(CascadeFlm):
    """The paper's adaptive controller: the cascade on an estimated model, gains scheduled (§4).

        p^ = argmin |Y p - torque| over three samples
        torque = cascade(p^), with the factor (46) on the inner loops

    A sample is the motion measured at the end of a control interval and the torque applied in it.
    The estimate replaces the nominal model as soon as three samples tell the five lumped parameters
    apart and the result is physical. The accelerometer must be free of noise: with sigma = 0.01
    rad/s^2, three samples a millisecond apart are useless. `AdaptiveFlmLs` works with noise.

    Sensors: position, velocity and acceleration. Source: Wang, Wang and Brdys, Cogent Engineering
    3:1173529, 2016, §4.

    Args:
        kp, velocity_p, velocity_i: as in `CascadeFlm`.
        alpha: alpha_ij of (46) [2 x 2]. The paper leaves them open; zeros (default) mean no
            scheduling.
        v_s: velocity scale of (46) [(rad/s)^2].
        total_mass: mass of the real arm [kg], which (39) assumes known. None: the form of (39) that
            needs no mass.
        weakest: smallest singular value of the scaled regressor at which an estimate is accepted.
            Below 1e-12 it is rounding.
    """

    alpha: Any = declared(((0.0, 0.0), (0.0, 0.0)), _check_alpha, "four numbers [2 x 2], zero or more")
    v_s: float = number(1e-3, unit="(rad/s)^2", above=0)
    total_mass: float | None = number(None, unit="kg", above=0)
    weakest: float = number(1e-7, low=1e-12)

    needs: ClassVar[tuple[str, ...]] = ("position", "velocity", "acceleration")

    def initial(self, observation: Array) -> State:
        """Return the state; see the comments for its parts."""
        n = len(observation)
        return (
            np.zeros((n, 2)),  # the cascade's integral
            np.zeros((n, SAMPLES, 2, 5)),  # regressors of the last samples
            np.zeros((n, SAMPLES, 2)),  # torques applied up to each of them
            np.zeros(n, dtype=int),  # observations so far
            np.zeros((n, 2)),  # torque applied in the interval that ends now
            np.broadcast_to(self.interface.nominal.lumped, (n, 5)).copy(),  # the estimate
        )

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        integral, y, torques, count, applied, lumped = state
        q, v, a = self.read(observation, "position", "velocity", "acceleration")
        y = np.concatenate([y[:, 1:], regressor(q, v, a)[:, None]], axis=1)
        torques = np.concatenate([torques[:, 1:], applied[:, None]], axis=1)
        # An episode's first observation ends no interval, so estimates start three samples later.
        fitted, accepted = self.fit(y, torques)
        lumped = np.where((accepted & (count >= SAMPLES))[:, None], fitted, lumped)
        torque, integral = self.drive(observation, q, v, integral, lumped, schedule(v, self.alpha, self.v_s))
        return torque, (integral, y, torques, count + 1, self.interface.saturate(torque), lumped)

    def fit(self, y: Array, torques: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return lumped parameters [n x 5] that fit the last samples, and their acceptance [n]."""
        lumped, accepted = estimate(y, torques, self.weakest)
        if self.total_mass is None:
            return lumped, accepted
        with np.errstate(divide="ignore", invalid="ignore"):
            masses = point_masses(lumped, self.total_mass)
            # (39) gives L1, L2 and m2, the total mass gives m1. The lumped parameters follow.
            return lumped_of(masses), accepted & np.all(masses > 0.0, axis=-1)

    def parameters(self, state: State) -> Array:
        """Return the estimates of m1, m2 [kg], L1, L2 [m] in a state, [n x 4]."""
        return point_masses(state[5], self.total_mass)
