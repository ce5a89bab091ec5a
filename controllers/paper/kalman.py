"""The paper's Kalman filter for each joint (§3.2), and the robust controller on its estimates."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.base import Array, State, TorqueLaw
from controllers.paper.cascade import CascadeFlm
from fbl_gym.interface import clip
from fbl_gym.records.record import choice, number

#: Root of the paper's 0.1: the noise variance of (17) and (18), taken per sample.
PAPER_SIGMA = float(np.sqrt(0.1))


#: Forms of the filter: exact for a sampled motion, or the paper's (19)-(21) with Euler steps.
FORMS = ("discrete", "continuous")


@lru_cache(maxsize=64)
def continuous_gains(dt: float, acceleration_sigma: float, position_sigma: float) -> Array:
    """Return K dt of (20) and (21) at each sample until it has converged, [k x 2].

    dP/dt = -P C' R^-1 C P + A P + P A' + Q and K = P C' R^-1, in Euler steps of dt. Q and R are
    densities, as printed: the squares of the sigmas. At steady state K is that of `gains` over dt,
    since only the ratio of the sigmas counts. These are the roots of the densities of acceleration
    [rad/s^2/sqrt(Hz)] and position [rad/sqrt(Hz)].
    """
    A, C = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]])
    Q, R = np.diag([0.0, acceleration_sigma**2]), position_sigma**2
    P = np.diag([R, 0.01])
    rows: list[Array] = []
    while not _converged(rows):
        K = P @ C.T / R
        rows.append(dt * K[:, 0])
        P = P + dt * (-K @ C @ P + A @ P + P @ A.T + Q)
        if not np.abs(P).max() < 1e9:
            raise ValueError(f"position_sigma must be larger for Euler steps of {dt:g} s, got {position_sigma:g}")
    return np.array(rows)


def _converged(rows: list[Array]) -> bool:
    """Return True if the last gain is that of 99 samples ago."""
    return len(rows) > 100 and (np.allclose(rows[-1], rows[-100], rtol=1e-9, atol=0.0) or len(rows) >= 200_000)


@lru_cache(maxsize=64)
def gains(dt: float, acceleration_sigma: float, position_sigma: float) -> Array:
    """Return the Kalman gain K of each sample until it has converged, [k x 2], from filterpy.

    In discrete time (15)-(18) are x = (position, velocity), F = [[1, dt], [0, 1]], B = (dt^2 / 2,
    dt), H = (1, 0). The input is the measured acceleration, held over a sample. Its noise is the
    process noise: Q = sigma^2 B B' (`Q_discrete_white_noise`; Labbe, "Kalman and Bayesian Filters
    in Python", ch. 8). The gain does not depend on the data, so all joints and lanes share it. The
    sigmas are per sample, in rad/s^2 and rad.
    """
    try:  # filterpy brings matplotlib, and few programs filter
        from filterpy.common import Q_discrete_white_noise
        from filterpy.kalman import KalmanFilter
    except ModuleNotFoundError as problem:
        text = "the Kalman filter needs filterpy, which is not installed: pip install 'fbl-gym[bench]'"
        raise ModuleNotFoundError(text, name=problem.name) from None
    kalman = KalmanFilter(dim_x=2, dim_z=1)
    kalman.F = np.array([[1.0, dt], [0.0, 1.0]])
    kalman.H = np.array([[1.0, 0.0]])
    kalman.Q = Q_discrete_white_noise(2, dt, acceleration_sigma**2)
    kalman.R = np.array([[position_sigma**2]])
    # The first position is a reading, the first velocity within 0.1 rad/s.
    kalman.P = np.diag([position_sigma**2, 0.01])
    rows: list[Array] = []
    while not _converged(rows):
        kalman.predict()
        kalman.update(np.zeros((1, 1)))
        rows.append(kalman.K[:, 0].copy())
    table = np.array(rows)
    table.setflags(write=False)
    return table


class KalmanState(NamedTuple):
    """State of `JointKalman`."""

    position: Array  # [n x 2] rad
    velocity: Array  # [n x 2] rad/s
    samples: Array  # their number [n]; -1 before the first observation


class RobustState(NamedTuple):
    """State of `RobustFlm`."""

    integral: Array  # of the cascade [n x 2]
    kalman: KalmanState


@dataclass(frozen=True)
class JointKalman:
    """The Kalman filter of both joints, driven by acceleration and corrected by position.

    The first observation ends no sample and leaves the estimate alone.

    Args:
        dt: sample time [s].
        acceleration_sigma: noise of the acceleration per sample [rad/s^2].
        position_sigma: noise of the position per sample [rad].
        form: one of `FORMS`.
    """

    dt: float
    acceleration_sigma: float
    position_sigma: float
    form: str = "discrete"

    def initial(self, position: Array, velocity: Array) -> KalmanState:
        """Return the state before the first observation, from position and velocity [n x 2]."""
        return KalmanState(position, velocity, np.full(len(position), -1))

    def update(self, state: KalmanState, position: Array, acceleration: Array) -> KalmanState:
        """Return the state at a sample's end, by (19).

        The position [n x 2] rad is measured there, the acceleration [n x 2] rad/s^2 in the sample.
        """
        gains_of = continuous_gains if self.form == "continuous" else gains
        table = gains_of(self.dt, self.acceleration_sigma, self.position_sigma)
        gain, before = table[clip(state.samples, 0, len(table) - 1)], state.samples[:, None] < 0
        # x = F x + B u
        q = state.position + self.dt * state.velocity + 0.5 * self.dt**2 * acceleration
        v = state.velocity + self.dt * acceleration
        # x = x + K (y - H x)
        innovation = position - q
        q, v = q + gain[:, :1] * innovation, v + gain[:, 1:] * innovation
        return KalmanState(np.where(before, state.position, q), np.where(before, state.velocity, v), state.samples + 1)


class FilteredLaw(TorqueLaw):
    """Base of the laws on the estimates of a `JointKalman`, whose other state is an integral."""

    acceleration_sigma: float
    position_sigma: float
    filtering: str = "discrete"

    needs: ClassVar[tuple[str, ...]] = ("position", "acceleration")

    @cached_property
    def filter(self) -> JointKalman:
        """The Kalman filter of both joints."""
        return JointKalman(self.interface.control_dt, self.acceleration_sigma, self.position_sigma, self.filtering)

    def initial(self, observation: Array) -> State:
        """Return the state before the first observation."""
        position, velocity = self.read(observation, "position", "reference_velocity")
        return RobustState(np.zeros_like(position), self.filter.initial(position, velocity))


@dataclass(frozen=True)
class RobustFlm(FilteredLaw, CascadeFlm):
    """The paper's robust controller: the cascade on the estimates of a Kalman filter (§3).

        q, v = Kalman filter(position, acceleration),    torque = cascade(q, v)

    An accelerometer bias b gives a position error of about b (position_sigma / acceleration_sigma).

    Sensors: position and acceleration.

    Args:
        acceleration_sigma: noise of the accelerometer per sample, from its data sheet [rad/s^2].
            The default is the paper's.
        position_sigma: noise of the encoder per sample [rad]. The default is the paper's. Once the
            gain has converged, only the ratio of both sigmas matters.
        filtering: form of the filter, "discrete" (default) or the paper's "continuous".
    """

    acceleration_sigma: float = number(PAPER_SIGMA, unit="rad/s^2", above=0)
    position_sigma: float = number(PAPER_SIGMA, unit="rad", above=0, tune=(1e-4, 1.0))
    filtering: str = choice("discrete", FORMS)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        kalman = self.filter.update(state.kalman, *self.read(observation, "position", "acceleration"))
        nominal = self.interface.nominal
        torque, integral = self.loops(observation, kalman.position, kalman.velocity, state.integral, nominal)
        return torque, RobustState(integral, kalman)
