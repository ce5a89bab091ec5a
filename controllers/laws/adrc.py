"""Active disturbance rejection by an extended state observer, with the model and without."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.base import Acting, Gain, State, TorqueLaw, pair
from controllers.parts import Eso
from fbl_gym.model.arm import Array, inertia_matrix


class EsoState(NamedTuple):
    """State of `ComputedTorqueEso`."""

    memory: Array  # of the observer [n x 2 x 4]
    acting: Acting


@dataclass(frozen=True)
class ComputedTorqueEso(TorqueLaw):
    """Computed torque on an extended state observer, with the position sensor alone.

        a = r'' + wc^2 (r - q) + 2 wc (r' - v) - f,    torque = M a + C v + G

    q, v and f come from the extended state observer (`Eso`); f is the acceleration that the
    nominal model does not explain. A constant load leaves no error. The law is active disturbance
    rejection whose b0 is the inverse of the full nominal inertia. The observer gets the torque
    within its limits as the known drive applies it.

    Sensors: position. Source: Han, "From PID to active disturbance rejection control", IEEE TIE
    56(3), 2009, in the linear form of Gao, "Scaling and bandwidth-parameterization based controller
    tuning", ACC 2003; the drive's delay in the observer: Zhao and Gao, "Modified active disturbance
    rejection control for time-delay systems", ISA Transactions 53(4), 2014.

    Args:
        controller_bandwidth: wc [rad/s], per joint: both poles of the tracking error are -wc.
        observer_bandwidth: w [rad/s], per joint: all three poles of the observer are -w. Choose
            several times wc; sensor noise limits it.
    """

    controller_bandwidth: Gain = pair(12.0, unit="rad/s", above=0, tune=(2.0, 60.0))
    observer_bandwidth: Gain = pair(60.0, unit="rad/s", above=0, tune=(15.0, 300.0))

    needs: ClassVar[tuple[str, ...]] = ("position",)

    @cached_property
    def observer(self) -> Eso:
        """The extended state observer of both joints."""
        return Eso(self.interface.control_dt, self.observer_bandwidth)

    def initial(self, observation: Array) -> State:
        """Return the state: at the reference's velocity, held by the model's torque at rest."""
        q, v = self.read(observation, "position", "reference_velocity")
        hold = self.interface.saturate(self.inverse(q, np.zeros_like(q), np.zeros_like(q)))
        return EsoState(self.observer.initial(q, v), self.drive.hold(hold))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next state."""
        r, r_dot, r_ddot = self.reference(observation)
        estimate = self.observer.correct(state.memory, *self.read(observation, "position"))
        q, v, _, f = estimate.transpose(2, 0, 1)
        w = np.array(self.controller_bandwidth)
        torque = self.inverse(q, v, r_ddot + w**2 * (r - q) + 2.0 * w * (r_dot - v) - f)
        # The torque that acts until the next sample drives the observer.
        acting = self.drive.act(state.acting, self.interface.saturate(torque))
        return torque, EsoState(self.observer.predict(estimate, self.forward(q, v, acting.mean)), acting)


@dataclass(frozen=True)
class Ladrc(ComputedTorqueEso):
    """Linear active disturbance rejection, without a model: each joint is q'' = f + b0 torque.

        torque = (r'' + wc^2 (r - q) + 2 wc (r' - v) - f) / b0,    b0 = (M^-1)_ii

    Of the arm it knows b0 alone, the acceleration of each joint of the stretched nominal arm for
    its own torque; of the drive it knows delay, lag and limit. Gravity, Coriolis torques, the
    coupling of the joints and the inertia's change with the pose are part of f, as friction and
    loads are. f begins at zero, so an arm under gravity sags until the observer has found it.

    Sensors: position. Source: Gao, "Scaling and bandwidth-parameterization based controller
    tuning", ACC 2003, §III.

    Args:
        controller_bandwidth, observer_bandwidth: as in `ComputedTorqueEso`.
    """

    controller_bandwidth: Gain = 15.0
    observer_bandwidth: Gain = 150.0

    @cached_property
    def b0(self) -> Array:
        """Acceleration of each joint for its own torque [2], 1/(kg m^2)."""
        return np.diagonal(np.linalg.inv(inertia_matrix(self.interface.nominal, (0.0, 0.0))))

    def inverse(self, q: Array, v: Array, a: Array) -> Array:
        """Return a / b0 [n x 2] N m."""
        return a / self.b0

    def forward(self, q: Array, v: Array, torque: Array) -> Array:
        """Return b0 torque [n x 2] rad/s^2."""
        return self.b0 * torque
