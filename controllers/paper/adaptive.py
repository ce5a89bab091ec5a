"""The paper's adaptive controller: parameter estimator, gain scheduling and cascade (§4).

The estimator has three samples and the pseudo-inverse (§4.1). The paper solves K_t X = -M_t e_t for
the errors X of seven products of parameters, equations (32)-(37). Two pairs of its seven columns
are equal, so at most five combinations can be estimated (its equation (38)): the five lumped
parameters of `arm.py`. With the applied torque on the right the same equations read Y p = torque.
Unlike (36), that also holds under saturation, where the torque cannot give the commanded
acceleration.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.base import State
from controllers.numerics.dynamics import forward_dynamics
from controllers.numerics.solving import least_squares
from controllers.paper.cascade import CascadeFlm
from controllers.paper.kalman import RobustFlm
from fbl_gym.model.arm import STANDARD_GRAVITY, Array, inertia_matrix, regressor, with_rotors
from fbl_gym.records.record import choice, number, table

#: Samples of an estimate: the paper's three.
SAMPLES = 3

#: Forms of a gain schedule: (46), a switch, and linguistic rules.
FORMS = ("soft", "hard", "fuzzy")


def estimate(y: Array, torque: Array, weakest: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return p1 to p5 of least squares [n x 5], in kg m^2 and N m, and where to accept them [n].

    y [n x s x 2 x 5] is the regressor of the measured motion at each sample (`arm.regressor`), and
    the torque [n x s x 2] N m that applied in it. An estimate is accepted where the parameters are
    physical and the samples tell all five apart: the smallest singular value of the regressor
    (columns scaled to length one) exceeds `weakest`. At rest the rank is 2, and (39) would return
    nonsense.
    """
    n = len(y)
    # At full rank the pseudo-inverse (Y'Y)^-1 Y' gives the solution of least squares.
    lumped, rich = least_squares(y.reshape(n, -1, 5), torque.reshape(n, -1), weakest)
    return lumped, rich & plausible(lumped)


def plausible(lumped: Array) -> NDArray[np.bool_]:
    """Return where lumped parameters [n x 5] are positive, with positive definite inertia, [n]."""
    p1, p2, p3 = (lumped[..., i] for i in range(3))
    return np.all(np.isfinite(lumped) & (lumped > 0.0), axis=-1) & (p1 * p2 > p3 * p3)


def point_masses(lumped: Array, total_mass: Array | float | None = None, gravity: float = STANDARD_GRAVITY) -> Array:
    """Return m1, m2 [kg], L1 and L2 [m] [n x 4] of point masses, from lumped parameters [n x 5].

    With the total mass m1 + m2 known, equation (39): L2 = Y1 / Y3, L1 = Y2 / Y3, m2 = Y3^2 / Y1 and
    m1 = mass - m2, for Y1 = p2, Y2 = p3 and Y3 = p5 / g. Without it, from the rest of the same
    regression: L1 = g p1 / p4 and m1 + m2 = (p4 / g)^2 / p1.
    """
    y1, y2, y3 = lumped[..., 1], lumped[..., 2], lumped[..., 4] / gravity
    m2, L2 = y3**2 / y1, y1 / y3
    if total_mass is None:
        L1 = gravity * lumped[..., 0] / lumped[..., 3]
        return np.stack([(lumped[..., 3] / gravity) ** 2 / lumped[..., 0] - m2, m2, L1, L2], axis=-1)
    return np.stack([total_mass - m2, m2, y2 / y3, L2], axis=-1)


def lumped_of(parameters: Array, gravity: float = STANDARD_GRAVITY) -> Array:
    """Return the lumped parameters [n x 5] of point masses m1, m2 [kg], L1, L2 [m] [n x 4]."""
    m1, m2, L1, L2 = (parameters[..., i] for i in range(4))
    both = m1 + m2
    return np.stack([both * L1**2, m2 * L2**2, m2 * L1 * L2, both * L1 * gravity, m2 * L2 * gravity], axis=-1)


def schedule(velocity: Array, alpha: Array, v_s: float, form: str = "soft") -> Array:
    """Return the factor of gain scheduling against stiction on each inner loop [n x 2].

        GS_i = alpha_i1 m(v_1) + alpha_i2 m(v_2) + 1

        soft    m(v) = exp(-v^2 / v_s), equation (46)
        hard    m(v) = 1 if v^2 < v_s, else 0
        fuzzy   1, exp(-1) and 0 for the speeds abs(v) / sqrt(v_s) zero, small and large

    The velocity v is [n x 2] rad/s, alpha [2 x 2], and v_s in (rad/s)^2; the form is one of
    `FORMS`. The factor is large where joints hardly move and stiction acts, and goes to 1 with
    speed. Velocity noise makes it smaller. The fuzzy rules have triangular memberships around the
    speeds 0, 1 and 2, and are averaged by them (Takagi and Sugeno, IEEE Trans. SMC 15:116, 1985).
    """
    if form == "fuzzy":
        speed = np.abs(velocity) / np.sqrt(v_s)
        zero, small = np.maximum(1.0 - speed, 0.0), np.maximum(1.0 - np.abs(speed - 1.0), 0.0)
        large = np.clip(speed - 1.0, 0.0, 1.0)
        near_rest = (zero + np.exp(-1.0) * small) / (zero + small + large)
    else:
        near_rest = np.exp(-(velocity**2) / v_s) if form == "soft" else (velocity**2 < v_s).astype(float)
    return 1.0 + near_rest @ np.asarray(alpha).T


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
        scheduling: form of the schedule, one of `FORMS`.
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
        q, v, a = self.read(observation, "position", "velocity", "acceleration")
        return self.adapt(observation, q, v, a, state)

    def adapt(
        self, observation: Array, q: Array, v: Array, a: Array, state: AdaptiveState
    ) -> tuple[Array, AdaptiveState]:
        """Return the torque [n x 2] N m and the next state for a measured or estimated motion.

        Position, velocity and acceleration are [n x 2]; the observation gives the reference.
        """
        y, torques, lumped = self.sampled(q, v, a, state)
        model = with_rotors(lumped, self.interface.nominal.rotor)
        factor = schedule(v, self.alpha, self.v_s, self.scheduling)
        torque, integral = self.loops(observation, q, v, state.integral, model, factor)
        if self.regression == "printed":
            applied = forward_dynamics(model, q, v, torque - self.loads(v))
        else:
            applied = self.interface.saturate(torque) - self.loads(v)
        return torque, AdaptiveState(integral, y, torques, state.samples + 1, applied, lumped, state.kalman)

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
        lumped, accepted = estimate(y, torques, self.weakest)
        if self.total_mass is None:
            return lumped, accepted
        with np.errstate(divide="ignore", invalid="ignore"):
            masses = point_masses(lumped, self.total_mass)
            # (39) gives L1, L2 and m2, the total mass gives m1. The lumped parameters follow.
            return lumped_of(masses), accepted & np.all(masses > 0.0, axis=-1)

    def parameters(self, state: State) -> Array:
        """Return the estimates of m1, m2 [kg], L1, L2 [m] in a state, [n x 4]."""
        return point_masses(state.lumped, self.total_mass)


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

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        position, acceleration = self.read(observation, "position", "acceleration")
        kalman = self.filter.update(state.kalman, position, acceleration)
        state = state._replace(kalman=kalman)
        return self.adapt(observation, kalman.position, kalman.velocity, acceleration, state)
