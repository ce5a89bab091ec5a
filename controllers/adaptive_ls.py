"""What it takes to make the idea of §4 work with real sensors: recursive least squares on filtered regressors.

The paper's three samples amplify every error of the accelerometer. Here all samples count, those of the last seconds most:
the filtered equation (Y p + friction) = tau is fitted by exponentially weighted least squares, with the nominal arm as prior
(Slotine and Li, "Applied Nonlinear Control", 1991, §8.7; Ljung, "System Identification", 1999, §11.2).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from controllers.estimator import plausible, point_masses
from controllers.kalman import RobustFlm
from controllers.policy import State
from controllers.solving import accumulate, exceeds, solve
from fbl_gym.arm import Array, inertia_matrix, regressor
from fbl_gym.checks import check_number
from fbl_gym.records import set_fields

TERMS = 9
"""Unknowns: the five lumped parameters, viscous friction of both joints, Coulomb friction of both joints."""


@dataclass(frozen=True)
class AdaptiveFlmLs(RobustFlm):
    """The cascade behind a Kalman filter, on a model that least squares keeps fitting.

    Per sample, the regressor of the five lumped parameters and of viscous and Coulomb friction, and the torque applied, pass
    the same low-pass filter, which takes the noise off the acceleration. Their weighted products A and b decay with
    `memory`; A p = b, with a small weight on the nominal arm, gives the estimate. While the arm stands still nothing is
    added and nothing forgotten. An estimate that is no arm's is refused, and negative friction is cut to zero. What is found
    of friction is fed forward along the reference's velocity. What the fit does not know of, it takes for parameters: under a
    large disturbance torque it is worse than no adaptation.

    Args:
        kp, velocity_p, velocity_i: as in `CascadeFlm`.
        acceleration_sigma, position_sigma: of the filter, as in `RobustFlm`; the defaults suit an accelerometer a hundred
            times as coarse as the encoder.
        memory: time constant of forgetting [s].
        bandwidth: of the low-pass filter [rad/s].
        prior: weight of the nominal arm, which decides where nothing else does [rad^2/s^3].
        excitation: smallest eigenvalue of A at which an estimate is used [rad^2/s^3]; what moves too little, or one way only,
            does not tell the unknowns apart.
        moving: speed [rad/s] or acceleration [rad/s^2] (filtered) above which the arm counts as moving.
        turn: speed over which Coulomb friction changes its sign [rad/s].
    """

    acceleration_sigma: float = 0.5
    position_sigma: float = 5e-3
    memory: float = 5.0
    bandwidth: float = 20.0
    prior: float = 1e-8
    excitation: float = 0.02
    moving: float = 0.05
    turn: float = 0.02

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {**RobustFlm.ranges, "memory": (1.0, 20.0), "bandwidth": (5.0, 100.0)}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("memory", "bandwidth", "prior", "excitation", "moving", "turn"):
            set_fields(self, **{name: check_number(name, getattr(self, name), above=0)})

    @cached_property
    def scale(self) -> Array:
        """The size of each unknown in the nominal arm [9]: fits are made in shares of it."""
        lumped = self.interface.nominal.lumped
        weight = np.maximum(lumped[4], lumped[1])
        return np.concatenate([np.maximum(lumped, 1e-9), np.full(4, weight)])

    @cached_property
    def weight(self) -> Array:
        """Of each joint's torque [2], one over its nominal inertia, so that residuals are accelerations."""
        return 1.0 / np.diagonal(inertia_matrix(self.interface.nominal, (0.0, 0.0)))

    def initial(self, observation: Array) -> State:
        n = len(observation)
        start = np.concatenate([self.interface.nominal.lumped, np.zeros(4)])
        return (
            *super().initial(observation),
            np.zeros((n, 2, TERMS)),  # filtered regressor
            np.zeros((n, 2)),  # filtered torque
            np.zeros((n, TERMS, TERMS)),  # A
            np.zeros((n, TERMS)),  # b
            np.broadcast_to(start, (n, TERMS)).copy(),  # the estimate
            np.zeros((n, 2)),  # torque applied in the interval that ends now
        )

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        integral, estimate, count, begun, z, filtered, a_sum, b_sum, found, applied = state
        position, acceleration = self.read(observation, "position", "acceleration")
        updated, more, _ = self.filter.update(estimate, count, position, acceleration)
        estimate = np.where(begun[:, None, None], updated, estimate)
        count = np.where(begun, more, count)
        q, v = estimate[..., 0], estimate[..., 1]

        # The first sample of an episode ends no interval; the second sets the filters.
        keep = np.where(count > 1, np.exp(-self.bandwidth * self.interface.control_dt), 0.0)
        z = keep[:, None, None] * z + (1.0 - keep)[:, None, None] * self.row(q, v, acceleration)
        filtered = keep[:, None] * filtered + (1.0 - keep)[:, None] * applied
        moves = begun & (np.abs(z[:, :, 5:7]).max(axis=(1, 2)) > self.moving)
        a_sum, b_sum = self.add(z, filtered, a_sum, b_sum, moves)
        rich = moves & exceeds(a_sum, self.excitation)
        if rich.any():
            found = np.where(rich[:, None], self.fit(a_sum, b_sum, found), found)

        torque, integral = self.drive(observation, q, v, integral, found[:, :5])
        torque = torque + self.friction(observation, v, found)
        return torque, (
            integral, estimate, count, np.ones_like(begun), z, filtered, a_sum, b_sum, found, self.interface.saturate(torque),
        )  # fmt: skip

    def row(self, q: Array, v: Array, a: Array) -> Array:
        """The regressor [n x 2 x 9] of lumped parameters, viscous and Coulomb friction."""
        eye = np.eye(2)
        viscous, coulomb = v[..., None] * eye, np.tanh(v / self.turn)[..., None] * eye
        return np.concatenate([regressor(q, v, a), viscous, coulomb], axis=-1)

    def add(self, z: Array, torque: Array, a: Array, b: Array, moves: NDArray[np.bool_]) -> tuple[Array, Array]:
        """A and b with one sample more, in shares of the nominal arm; where nothing moves, as they were."""
        dt = self.interface.control_dt
        rows = z * self.scale * self.weight[:, None]
        return accumulate(a, b, rows, torque * self.weight, np.exp(-dt / self.memory), dt, moves)

    def fit(self, a: Array, b: Array, before: Array) -> Array:
        """The estimate [n x 9] from A and b: that of an arm, or the one before."""
        start = np.concatenate([np.ones(5), np.zeros(4)])
        new = solve(a + self.prior * np.eye(TERMS), b + self.prior * start) * self.scale
        new[:, 5:] = np.maximum(new[:, 5:], 0.0)
        return np.where(plausible(new[:, :5])[:, None], new, before)

    def friction(self, observation: Array, v: Array, found: Array) -> Array:
        """Friction to compensate: viscous at the velocity, Coulomb along the reference's, whose sign is steady."""
        (r_dot,) = self.read(observation, "reference_velocity")
        return found[:, 5:7] * v + found[:, 7:9] * np.tanh(r_dot / self.turn)

    def parameters(self, state: State) -> Array:
        """The estimates m1, m2, L1, L2 [n x 4] that a state holds."""
        return point_masses(state[8][:, :5])
