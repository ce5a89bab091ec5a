"""The paper's adaptive controller: parameter estimator, gain scheduling and cascade (§4)."""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.base import State
from controllers.numerics.dynamics import forward_dynamics
from controllers.paper.cascade import CascadeFlm
from controllers.paper.estimator import estimate, lumped_of, point_masses
from controllers.paper.gain_scheduling import FORMS, schedule
from controllers.paper.kalman import RobustFlm
from fbl_gym.model.arm import Array, inertia_matrix, regressor, with_rotors
from fbl_gym.records.record import choice, number, table

#: Samples of an estimate: the paper's three.
SAMPLES = 3


class AdaptiveState(NamedTuple):
    """State of the adaptive controllers."""

    integral: Array  # of the cascade [n x 2]
    regressors: Array  # of the last samples [n x SAMPLES x 2 x 5]
    torques: Array  # right sides of the regression [n x SAMPLES x 2]: torques up to each, less those of the rotors
    samples: Array  # observations so far [n]
    applied: Array  # torque applied in the interval that ends now [n x 2]; "printed": a
    lumped: Array  # the estimate [n x 5]
    kalman: State = ()  # of the Kalman filter, if there is one


@dataclass(frozen=True)
class AdaptiveFlm(CascadeFlm):
    """The paper's adaptive controller: the cascade on an estimated model, gains scheduled (§4).

        p^ = argmin |Y p - torque| over three samples
        torque = cascade(p^), with the factor (46) on the inner loops

    A sample is the motion measured at the end of a control interval and the torque applied in it.
    The estimate replaces the nominal model as soon as three samples tell the five lumped parameters
    apart and the result is physical. Under noise the samples must lie apart. The regression
    "printed" is (36): X = -pinv(K_t) M^e with e = a - q'', and p = p^ - X. It is wrong where the
    torque saturates.

    Sensors: position, velocity and acceleration.

    Args:
        alpha: alpha_ij of (46) [2 x 2]. The paper leaves them open; zeros (default) mean no
            scheduling.
        v_s: velocity scale of (46) [(rad/s)^2].
        scheduling: form of the schedule, one of `gain_scheduling.FORMS`.
        spacing: time between two of the three samples [s]; 0: one control interval.
        regression: right side of the regression: "torque" (default) or "printed".
        total_mass: mass of the real arm [kg], which (39) assumes known. None: the form of (39) that
            needs no mass.
        weakest: smallest singular value of the scaled regressor at which an estimate is accepted.
            Below 1e-12 it is rounding.
    """

    alpha: Any = table(((0.0, 0.0), (0.0, 0.0)))
    v_s: float = number(1e-3, unit="(rad/s)^2", above=0)
    scheduling: str = choice("soft", FORMS)
    spacing: float = number(0.0, unit="s", low=0, tune=(0.01, 1.0))
    regression: str = choice("torque", ("torque", "printed"))
    total_mass: float | None = number(None, unit="kg", above=0)
    weakest: float = number(1e-7, low=1e-12)

    needs: ClassVar[tuple[str, ...]] = ("position", "velocity", "acceleration")

    def validate(self) -> None:
        """Refuse an alpha that is not four numbers, zero or more."""
        super().validate()
        if np.shape(self.alpha) != (2, 2) or np.min(self.alpha) < 0.0:
            raise ValueError(f"alpha must be four numbers [2 x 2], zero or more, got {self.alpha!r}")

    def initial(self, observation: Array) -> State:
        """Return the state before the first observation, with the nominal estimate."""
        n = len(observation)
        lumped = np.broadcast_to(self.interface.nominal.lumped, (n, 5)).copy()
        zeros, regressors, torques = np.zeros((n, 2)), np.zeros((n, SAMPLES, 2, 5)), np.zeros((n, SAMPLES, 2))
        return AdaptiveState(zeros, regressors, torques, np.zeros(n, dtype=int), zeros, lumped)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        q, v, a, kalman = self.sensed(observation, state)
        y, torques, lumped = self.sampled(q, v, a, state)
        model = with_rotors(lumped, self.interface.nominal.rotor)
        factor = schedule(v, self.alpha, self.v_s, self.scheduling)
        torque, integral = self.loops(observation, q, v, state.integral, model, factor)
        sent = torque if self.drive.sent is None else self.drive.sent
        applied = self.interface.saturate(sent) - self.loads(v)
        if self.regression == "printed":
            applied = forward_dynamics(model, q, v, sent - self.loads(v))
        return torque, AdaptiveState(integral, y, torques, state.samples + 1, applied, lumped, kalman)

    def sensed(self, observation: Array, state: AdaptiveState) -> tuple[Array, Array, Array, State]:
        """Return position, velocity and acceleration [n x 2], and the Kalman filter's state."""
        return *self.read(observation, "position", "velocity", "acceleration"), ()  # type: ignore[return-value]

    def sampled(self, q: Array, v: Array, a: Array, state: AdaptiveState) -> tuple[Array, Array, Array]:
        """Return regressors, torques and estimate, with a motion [n x 2] where one is due."""
        stride = max(round(self.spacing / self.interface.control_dt), 1)
        # An episode's first observation ends no interval, so estimates start three samples later.
        due = (state.samples % stride == 0) & (state.samples > 0)
        if not due.any():
            return state.regressors, state.torques, state.lumped
        row, lumped, rotor = regressor(q, v, a), state.lumped, np.array(self.interface.nominal.rotor)
        right = state.applied - rotor * a
        if self.regression == "printed":
            error = np.einsum("nij,nj->ni", inertia_matrix(with_rotors(lumped, rotor), q), state.applied - a)
            right = np.einsum("nij,nj->ni", row, lumped) + error
        new = due[:, None, None]
        y = np.where(new[..., None], np.concatenate([state.regressors[:, 1:], row[:, None]], axis=1), state.regressors)
        torques = np.where(new, np.concatenate([state.torques[:, 1:], right[:, None]], axis=1), state.torques)
        fitted, accepted = self.fit(y, torques)
        accepted &= due & (state.samples >= SAMPLES * stride)
        return y, torques, np.where(accepted[:, None], fitted, lumped)

    def fit(self, y: Array, torques: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return lumped parameters [n x 5] that fit the last samples, and their acceptance [n]."""
        lumped, accepted = estimate(y, torques, self.weakest, self.interface.nominal.gravity > 0.0)
        if self.total_mass is None:
            return lumped, accepted
        with np.errstate(divide="ignore", invalid="ignore"):
            masses = point_masses(lumped, self.total_mass, gravity := self.interface.nominal.gravity)
            # (39) gives L1, L2 and m2, the total mass gives m1. The lumped parameters follow.
            return lumped_of(masses, gravity), accepted & np.all(masses > 0.0, axis=-1)

    def parameters(self, state: State) -> Array:
        """Return the estimates of m1, m2 [kg], L1, L2 [m] in a state, [n x 4]."""
        return point_masses(state.lumped, self.total_mass, self.interface.nominal.gravity)


@dataclass(frozen=True)
class AdaptiveFlmScheduled(AdaptiveFlm):
    """The paper's adaptive controller with its gain schedule (§4.1 and §4.2).

    `AdaptiveFlm` with alpha_ii = 20, the project's choice: at rest the inner gains are 21 times as
    large.
    """

    alpha: Any = ((20.0, 0.0), (0.0, 20.0))


@dataclass(frozen=True)
class AdaptiveRobustFlm(AdaptiveFlmScheduled, RobustFlm):
    """The paper's tools together: estimator, gain schedule, cascade and Kalman filter (§3 and §4).

    The position and the velocity come from the Kalman filter, the acceleration is the measured one.

    Sensors: position and acceleration.
    """

    spacing: float = 0.2

    needs: ClassVar[tuple[str, ...]] = ("position", "acceleration")

    def initial(self, observation: Array) -> State:
        """Return the states of `AdaptiveFlm` and of the Kalman filter."""
        kalman = RobustFlm.initial(self, observation).kalman
        return AdaptiveFlm.initial(self, observation)._replace(kalman=kalman)

    def sensed(self, observation: Array, state: AdaptiveState) -> tuple[Array, Array, Array, State]:
        """Return position and velocity of the Kalman filter, the acceleration, and its state."""
        position, acceleration = self.read(observation, "position", "acceleration")
        kalman = self.filter.update(state.kalman, position, acceleration)
        return kalman.position, kalman.velocity, acceleration, kalman
