"""The adaptive controller for noisy sensors: the idea of §4 with recursive least squares."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.estimator import plausible, point_masses
from controllers.kalman import KalmanState, RobustFlm
from controllers.passivity import friction_regressor
from controllers.policy import State
from controllers.solving import accumulate, exceeds, solve
from fbl_gym.model.arm import Array, regressor, with_rotors
from fbl_gym.records import number

TERMS = 9
"""Unknowns: five lumped parameters, viscous and Coulomb friction of both joints."""


class LeastSquaresState(NamedTuple):
    """State of `AdaptiveFlmLs`."""

    integral: Array  # of the cascade [n x 2]
    kalman: KalmanState
    regressor: Array  # z [n x 2 x 9]
    filtered: Array  # torque through the low-pass filter, without the known rotors' part [n x 2]
    a: Array  # A [n x 9 x 9]
    b: Array  # b [n x 9]
    unknowns: Array  # their estimate [n x 9]
    applied: Array  # torque applied in the interval that ends now [n x 2]


@dataclass(frozen=True)
class AdaptiveFlmLs(RobustFlm):
    """The robust controller on a model and friction fitted by weighted least squares.

        dA/dt = z'z - A / memory,    db/dt = z' LP(torque) - b / memory
        p^ = (A + prior I)^-1 (b + prior p_nominal)

    z = LP(Y(q, v, a)) is the regressor of the five lumped parameters and of viscous and Coulomb
    friction, through the same low-pass filter LP as the torque. q and v come from the Kalman
    filter, a from the accelerometer. While the arm stands still, A and b are held. An estimate that
    is not physical is refused, and negative friction is set to zero. The estimated friction is fed
    forward.

    Sensors: position and acceleration. Source: Slotine and Li, "Applied Nonlinear Control", 1991,
    §8.7; Ljung, "System Identification", 1999, §11.2.

    Args:
        acceleration_sigma, position_sigma: as in `RobustFlm`. The defaults suit an accelerometer a
            hundred times as coarse as the encoder.
        memory: time constant of forgetting [s].
        bandwidth: of the low-pass filter [rad/s].
        prior: weight of the nominal arm, which decides where the data do not [rad^2/s^3].
        excitation: smallest eigenvalue of A at which an estimate is used [rad^2/s^3]. A motion that
            is too small or too simple does not tell the unknowns apart.
        moving: filtered speed above which the arm counts as moving [rad/s].
        turn: speed over which Coulomb friction changes its sign [rad/s].
    """

    acceleration_sigma: float = 0.5
    position_sigma: float = 5e-3
    memory: float = number(5.0, unit="s", above=0, tune=(1.0, 20.0))
    bandwidth: float = number(20.0, unit="rad/s", above=0, tune=(5.0, 100.0))
    prior: float = number(1e-8, unit="rad^2/s^3", above=0)
    excitation: float = number(0.02, unit="rad^2/s^3", above=0)
    moving: float = number(0.05, unit="rad/s", above=0)
    turn: float = number(0.02, unit="rad/s", above=0)

    @cached_property
    def scale(self) -> Array:
        """Size of each unknown in the nominal arm [9]. Fits are made in shares of it."""
        lumped = self.interface.nominal.lumped
        weight = np.maximum(lumped[4], lumped[1])
        return np.concatenate([np.maximum(lumped, 1e-9), np.full(4, weight)])

    def initial(self, observation: Array) -> State:
        """Return the state before the first observation, with the nominal estimate."""
        n = len(observation)
        start = np.concatenate([self.interface.nominal.lumped, np.zeros(4)])
        z, a, b, zeros = np.zeros((n, 2, TERMS)), np.zeros((n, TERMS, TERMS)), np.zeros((n, TERMS)), np.zeros((n, 2))
        kalman = super().initial(observation).kalman
        return LeastSquaresState(zeros, kalman, z, zeros, a, b, np.tile(start, (n, 1)), zeros)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        unknowns = state.unknowns
        position, acceleration = self.read(observation, "position", "acceleration")
        kalman = self.filter.update(state.kalman, position, acceleration)
        q, v = kalman.position, kalman.velocity

        # The first sample of an episode ends no interval; the second sets the filters.
        keep = np.where(kalman.samples > 1, np.exp(-self.bandwidth * self.interface.control_dt), 0.0)
        z = keep[:, None, None] * state.regressor + (1.0 - keep)[:, None, None] * np.concatenate(
            [regressor(q, v, acceleration), friction_regressor(v, self.turn)], axis=-1
        )
        rotor = self.interface.nominal.rotor
        filtered = keep[:, None] * state.filtered + (1.0 - keep)[:, None] * (
            state.applied - np.array(rotor) * acceleration
        )
        moves = (kalman.samples > 0) & (np.abs(z[:, :, 5:7]).max(axis=(1, 2)) > self.moving)
        a, b = self.add(z, filtered, state.a, state.b, moves)
        rich = moves & exceeds(a, self.excitation)
        if rich.any():
            unknowns = np.where(rich[:, None], self.fit(a, b, unknowns), unknowns)

        torque, integral = self.drive(observation, q, v, state.integral, with_rotors(unknowns[:, :5], rotor))
        # The Coulomb friction fed forward follows the reference's velocity, whose sign is steady.
        (r_dot,) = self.read(observation, "reference_velocity")
        torque = torque + (unknowns[:, 5:7] * v + unknowns[:, 7:9] * np.tanh(r_dot / self.turn))
        applied = self.interface.saturate(torque)
        return torque, LeastSquaresState(integral, kalman, z, filtered, a, b, unknowns, applied)

    def add(self, z: Array, torque: Array, a: Array, b: Array, moves: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return A [n x 9 x 9] and b [n x 9] with one sample more, in shares of the nominal arm.

        z [n x 2 x 9] and the torque [n x 2] are filtered. Lanes change where they move.
        """
        dt = self.interface.control_dt
        weight = 1.0 / self.stretched
        rows = z * self.scale * weight[:, None]
        return accumulate(a, b, rows, torque * weight, np.exp(-dt / self.memory), dt, moves)

    def fit(self, a: Array, b: Array, before: Array) -> Array:
        """Return the new estimate of the unknowns [n x 9], or the last one if it is unphysical."""
        start = np.concatenate([np.ones(5), np.zeros(4)])
        new = solve(a + self.prior * np.eye(TERMS), b + self.prior * start) * self.scale
        new[:, 5:] = np.maximum(new[:, 5:], 0.0)
        return np.where(plausible(new[:, :5])[:, None], new, before)

    def parameters(self, state: State) -> Array:
        """Return the estimates of m1, m2 [kg], L1, L2 [m] in a state, [n x 4]."""
        return point_masses(state.unknowns[:, :5])
