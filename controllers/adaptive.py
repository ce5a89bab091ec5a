"""The adaptive controller of §4: a parameter estimator, soft gain scheduling, and the cascade outside."""

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
from fbl_gym.checks import check_number
from fbl_gym.records import set_fields

SAMPLES = 3
"""How many samples an estimate takes: the paper's three."""


@dataclass(frozen=True)
class AdaptiveFlm(CascadeFlm):
    """The adaptive controller of §4, with the estimator as printed (three samples, pseudo-inverse) and gain scheduling (46).

    Each sample is the motion measured at the end of a control interval and the torque held in it. As soon as three of them
    tell the five lumped parameters apart, and the result is that of an arm, it replaces the model that is linearised; until
    then the model is the nominal one. The estimator needs an acceleration sensor without noise: with sigma = 0.01 rad/s^2,
    three samples a millisecond apart are useless.

    Args:
        kp, velocity_p, velocity_i: as in `CascadeFlm`.
        alpha: alpha_ij of (46), [2 x 2]; the paper leaves them open. Zeros (default): no scheduling.
        v_s: velocity scale of (46) [(rad/s)^2].
        total_mass: of the real arm [kg], as (39) assumes it known; None: the form that needs none.
        weakest: smallest singular value of the scaled regressor at which an estimate is accepted; below 1e-12 it is rounding.
    """

    alpha: Any = ((0.0, 0.0), (0.0, 0.0))
    v_s: float = 1e-3
    total_mass: float | None = None
    weakest: float = 1e-7

    needs: ClassVar[tuple[str, ...]] = ("position", "velocity", "acceleration")

    def __post_init__(self) -> None:
        super().__post_init__()
        alpha = np.asarray(self.alpha, dtype=float)
        if alpha.shape != (2, 2) or not np.isfinite(alpha).all() or (alpha < 0).any():
            raise ValueError(f"alpha must be four numbers [2 x 2], zero or more, got {self.alpha!r}")
        set_fields(
            self,
            alpha=tuple(tuple(float(x) for x in row) for row in alpha),
            v_s=check_number("v_s", self.v_s, above=0),
            weakest=check_number("weakest", self.weakest, low=1e-12),
        )
        if self.total_mass is not None:
            set_fields(self, total_mass=check_number("total_mass", self.total_mass, above=0))

    def initial(self, observation: Array) -> State:
        n = len(observation)
        return (
            np.zeros((n, 2)),  # integral
            np.zeros((n, SAMPLES, 2, 5)),  # regressors of the last samples
            np.zeros((n, SAMPLES, 2)),  # torques applied up to each of them
            np.zeros(n, dtype=int),  # observations so far
            np.zeros((n, 2)),  # torque applied in the interval that ends now
            np.broadcast_to(self.interface.nominal.lumped, (n, 5)).copy(),  # the estimate
        )

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        integral, y, torques, count, applied, lumped = state
        q, v, a = self.read(observation, "position", "velocity", "acceleration")
        y = np.concatenate([y[:, 1:], regressor(q, v, a)[:, None]], axis=1)
        torques = np.concatenate([torques[:, 1:], applied[:, None]], axis=1)
        # The first observation of an episode ends no interval: the three samples after it are the first to count.
        found, ok = self.learn(y, torques)
        lumped = np.where((ok & (count >= SAMPLES))[:, None], found, lumped)
        torque, integral = self.drive(observation, q, v, integral, lumped, schedule(v, self.alpha, self.v_s))
        return torque, (integral, y, torques, count + 1, self.interface.saturate(torque), lumped)

    def learn(self, y: Array, torques: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Lumped parameters [n x 5] from regressors [n x 3 x 2 x 5] and torques [n x 3 x 2], and where to believe them [n]."""
        found, ok = estimate(y, torques, self.weakest)
        if self.total_mass is None:
            return found, ok
        with np.errstate(divide="ignore", invalid="ignore"):
            masses = point_masses(found, self.total_mass)
            # (39) finds L1, L2 and m2, and the total mass gives m1; the lumped parameters follow from those four.
            return lumped_of(masses), ok & np.all(masses > 0.0, axis=-1)

    def parameters(self, state: State) -> Array:
        """The estimates m1, m2, L1, L2 [n x 4] that a state holds."""
        return point_masses(state[5], self.total_mass)
