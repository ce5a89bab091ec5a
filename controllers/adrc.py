"""Active disturbance rejection: an observer estimates the model's error, and the law cancels it."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.parts import Acting, Drive, Eso
from controllers.policy import State, TorqueLaw
from fbl_gym.checks import Pair
from fbl_gym.model.arm import Array, forward_dynamics, gravity_torque, inverse_dynamics
from fbl_gym.records import pair


class AdrcState(NamedTuple):
    """State of `Adrc`."""

    memory: Array  # of the observer [n x 2 x 4]
    acting: Acting


@dataclass(frozen=True)
class Adrc(TorqueLaw):
    """Active disturbance rejection, on the position sensor alone.

        a = r'' + wc^2 (r - q) + 2 wc (r' - v) - f,    torque = M a + C v + G

    q, v and f come from the extended state observer (`parts.Eso`); f is the acceleration that the
    nominal model does not explain. A constant load leaves no error. The b0 of the literature is the
    inverse of the full nominal inertia. The observer gets the torque within its limits
    as the known drive applies it.

    Sensors: position. Source: Han, "From PID to active disturbance rejection control", IEEE TIE
    56(3), 2009, in the linear form of Gao, "Scaling and bandwidth-parameterization based controller
    tuning", ACC 2003.

    Args:
        controller_bandwidth: wc [rad/s], per joint: both poles of the tracking error are -wc.
        observer_bandwidth: w [rad/s], per joint: all three poles of the observer are -w. Choose
            several times wc; sensor noise limits it.
    """

    controller_bandwidth: Pair | float = pair(12.0, unit="rad/s", above=0, tune=(2.0, 60.0))
    observer_bandwidth: Pair | float = pair(60.0, unit="rad/s", above=0, tune=(15.0, 300.0))

    needs: ClassVar[tuple[str, ...]] = ("position",)

    @cached_property
    def drive(self) -> Drive:
        """The drive, by which the observer pairs a motion with the torque of its time."""
        return Drive.of(self.interface)

    @cached_property
    def observer(self) -> Eso:
        """The extended state observer of both joints."""
        return Eso(self.interface.control_dt, self.observer_bandwidth)

    def initial(self, observation: Array) -> State:
        """Return the state at rest."""
        q, v = self.read(observation, "position", "reference_velocity")
        hold = self.interface.saturate(gravity_torque(self.interface.nominal, q))
        return AdrcState(self.observer.initial(q, v), self.drive.hold(hold))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the observer's next memory."""
        (position,) = self.read(observation, "position")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        estimate = self.observer.correct(state.memory, position)
        q, v, _, f = estimate.transpose(2, 0, 1)
        w = np.array(self.controller_bandwidth)
        torque = inverse_dynamics(self.interface.nominal, q, v, r_ddot + w**2 * (r - q) + 2.0 * w * (r_dot - v) - f)
        # u: the nominal acceleration under the torque that acts until the next sample.
        acting = self.drive.act(state.acting, self.interface.saturate(torque))
        u = forward_dynamics(self.interface.nominal, q, v, acting.mean)
        return torque, AdrcState(self.observer.predict(estimate, u), acting)
