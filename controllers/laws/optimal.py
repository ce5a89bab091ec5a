"""Optimal linear designs on the nominally linearised arm: LQG and H-infinity loop shaping."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.interpolate import pade
from scipy.linalg import solve_continuous_are, solve_discrete_are
from scipy.signal import cont2discrete, tf2ss

from controllers.base import Gain, State, TorqueLaw
from controllers.numerics.dynamics import inverse_dynamics, winds_up
from controllers.paper.kalman import JointKalman, RobustState
from fbl_gym.model.arm import Array
from fbl_gym.records.record import number, pair


def plant(dt: float) -> tuple[Array, Array]:
    """Return F [3 x 3] and G [3 x 1] of x = (z, e, e'), z the sum of e dt, and e'' = u held."""
    return np.array([[1.0, dt, 0.0], [0.0, 1.0, dt], [0.0, 0.0, 1.0]]), np.array([[0.0], [0.5 * dt**2], [dt]])


@lru_cache(maxsize=64)
def regulator(dt: float, integral: float, position: float, velocity: float) -> Array:
    """Return the gain K [3] of the optimal regulator u = -K x.

    It minimises the sum of (integral z)^2 + (position e)^2 + (velocity e')^2 + u^2:

        P = Q + F' P (F - G K),    K = (1 + G' P G)^-1 G' P F

    (Anderson and Moore, "Optimal Control", 1990, §2.4). The weights are in 1/s^3, 1/s^2 and 1/s.
    """
    f, g = plant(dt)
    p = solve_discrete_are(f, g, np.diag([integral, position, velocity]) ** 2, np.eye(1))
    k = np.linalg.solve(np.eye(1) + g.T @ p @ g, g.T @ p @ f)[0]
    k.setflags(write=False)
    return k


@dataclass(frozen=True)
class Lqg(TorqueLaw):
    """LQG with integral action.

        a = r'' + K (z, r - q, r' - v),    z = int(r - y) dt,    torque = M a + C v + G

    K is the optimal gain (`regulator`). q and v come from the Kalman filter of the paper
    (`JointKalman`). y is the measured position, so an accelerometer bias leaves no lasting error.
    The integral pauses where the torque saturates.

    Sensors: position and acceleration. Source: Anderson and Moore, "Optimal Control", 1990, §2.4.

    Args:
        integral: weight of z [1/s^3], per joint, against 1 for acceleration.
        position: weight of the position error [1/s^2], per joint.
        velocity: weight of the velocity error [1/s], per joint.
        acceleration_sigma: noise of the accelerometer per sample [rad/s^2].
        position_sigma: noise of the encoder per sample [rad]. Once the filter has converged, only
            the ratio of both sigmas matters.
    """

    integral: Gain = pair(1000.0, unit="1/s^3", above=0, tune=(10.0, 1e4))
    position: Gain = pair(100.0, unit="1/s^2", above=0, tune=(10.0, 1000.0))
    velocity: Gain = pair(20.0, unit="1/s", above=0, tune=(1.0, 100.0))
    acceleration_sigma: float = number(0.5, unit="rad/s^2", above=0)
    position_sigma: float = number(5e-3, unit="rad", above=0, tune=(1e-4, 0.1))

    needs: ClassVar[tuple[str, ...]] = ("position", "acceleration")

    @cached_property
    def gain(self) -> Array:
        """K [2 x 3], per joint."""
        weights = zip(self.integral, self.position, self.velocity, strict=True)  # type: ignore[arg-type]
        return np.array([regulator(self.interface.control_dt, *joint) for joint in weights])

    @cached_property
    def filter(self) -> JointKalman:
        """The Kalman filter of both joints."""
        return JointKalman(self.interface.control_dt, self.acceleration_sigma, self.position_sigma)

    def initial(self, observation: Array) -> State:
        """Return the state before the first observation."""
        position, velocity = self.read(observation, "position", "reference_velocity")
        return RobustState(np.zeros_like(position), self.filter.initial(position, velocity))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        y, y_ddot = self.read(observation, "position", "acceleration")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        kalman = self.filter.update(state.kalman, y, y_ddot)
        q, v = kalman.position, kalman.velocity
        nominal, error = self.interface.nominal, r - y
        # e'' = r'' - a = u = -K x
        x = np.stack([state.integral, r - q, r_dot - v], axis=-1)
        a = r_ddot + (self.gain * x).sum(axis=-1)
        torque = inverse_dynamics(nominal, q, v, a)
        pause = winds_up(self.interface, nominal, q, v, a, torque, error)
        integral = state.integral + np.where(pause, 0.0, error * self.interface.control_dt)
        return torque, RobustState(integral, kalman)


#: Zero of the weight's integral action, in multiples of the bandwidth.
INTEGRAL = 0.2

#: Ratio of gamma to the least one, at which the controller would be singular.
SLACK = 1.05

#: Dead times of a design, in multiples of 1 / bandwidth.
#:
#: Below, the delay's approximation is ill-conditioned; above, the controller itself is unstable.
LEAST, MOST = 0.05, 1.5


class HInfinityState(NamedTuple):
    """State of `HInfinity`."""

    integral: Array  # of the robust controller's output [n x 2]
    memory: Array  # of the robust controller [n x 2 x 5]


@lru_cache(maxsize=64)
def robust_controller(dead: float) -> tuple[Array, Array, Array, float]:
    """Return A [5 x 5], B [5 x 1] and C [1 x 5] of the controller of a shaped plant, and gamma.

    The shaped plant is (s + INTEGRAL) / s^3 exp(-dead s), with a Padé approximation of second
    order. The controller -C (s - A)^-1 B stabilises all plants whose normalised coprime factors
    are off by less than 1 / gamma (Skogestad and Postlethwaite, "Multivariable Feedback Control",
    2005, equations 9.63 to 9.69).

    Args:
        dead: time, in multiples of 1 / bandwidth.
    """
    above, below = pade(np.cumprod([1.0, *(-dead / k for k in range(1, 5))]), 2)
    a, b, c, _ = tf2ss(np.polymul(above, [1.0, INTEGRAL]), np.polymul(below, [1.0, 0.0, 0.0, 0.0]))
    x = solve_continuous_are(a, b, c.T @ c, np.eye(1))
    z = solve_continuous_are(a.T, c.T, b @ b.T, np.eye(1))
    gamma = SLACK * float(np.sqrt(1.0 + np.linalg.eigvals(x @ z).real.max()))
    gain = gamma**2 * np.linalg.solve(((1.0 - gamma**2) * np.eye(5) + x @ z).T, z @ c.T)
    return a - b @ b.T @ x + gain @ c, gain, b.T @ x, gamma


@dataclass(frozen=True)
class HInfinity(TorqueLaw):
    """H-infinity loop shaping of McFarlane and Glover, with the position sensor alone.

        a = r'' + w^2 (u + 0.2 w int(u) dt),    u = K (r - q),    torque = M a + C r' + G

    Each joint of the linearised arm is a double integrator behind the known dead time: half a
    sample, and the drive's delay and lag. K is the controller that bears the largest error of its
    normalised coprime factors, discretised by Tustin's rule. The integral pauses where the torque
    saturates.

    Sensors: position. Source: McFarlane and Glover, "A loop shaping design procedure using
    H-infinity synthesis", IEEE TAC 37(6), 1992.

    Args:
        bandwidth: w [rad/s], per joint: of the shaped plant without its dead time.
    """

    bandwidth: Gain = pair(25.0, unit="rad/s", above=0, tune=(5.0, 200.0))

    needs: ClassVar[tuple[str, ...]] = ("position",)

    @property
    def dead(self) -> float:
        """The known dead time of the loop [s]."""
        return 0.5 * self.drive.dt + self.drive.delay + self.drive.lag

    @cached_property
    def controller(self) -> tuple[Array, Array, Array, Array]:
        """A [2 x 5 x 5], B [2 x 5], C [2 x 5] and D [2] of both joints, discrete."""
        joints = []
        for w in self.bandwidth:  # type: ignore[union-attr]
            a, b, c, _ = robust_controller(min(max(w * self.dead, LEAST), MOST))
            joints.append(cont2discrete((w * a, w * b, -c, 0.0), self.interface.control_dt, "bilinear")[:4])
        a, b, c, d = (np.array(matrix) for matrix in zip(*joints, strict=True))
        return a, b[..., 0], c[:, 0], d[:, 0, 0]

    def initial(self, observation: Array) -> State:
        """Return the state before the first observation."""
        return HInfinityState(np.zeros((len(observation), 2)), np.zeros((len(observation), 2, 5)))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next state."""
        (q,) = self.read(observation, "position")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        a, b, c, d = self.controller
        error, w, nominal = r - q, np.array(self.bandwidth), self.interface.nominal
        u = (c * state.memory).sum(axis=-1) + d * error
        memory = (a * state.memory[:, :, None]).sum(axis=-1) + b * error[..., None]
        wanted = r_ddot + w**2 * (u + INTEGRAL * w * state.integral)
        torque = inverse_dynamics(nominal, q, r_dot, wanted)
        pause = winds_up(self.interface, nominal, q, r_dot, wanted, torque, u)
        integral = state.integral + np.where(pause, 0.0, u * self.interface.control_dt)
        return torque, HInfinityState(integral, memory)
