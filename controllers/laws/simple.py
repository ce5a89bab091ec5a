"""The simplest laws: no torque, and PD and PID with gravity compensation."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from controllers.base import Gain, IntegralLaw, IntegralState, State, TorqueLaw, pair
from fbl_gym.model.arm import Array, gravity_torque


@dataclass(frozen=True)
class Zero(TorqueLaw):
    """The law torque = 0. It needs no sensor and has no gain."""

    needs: ClassVar[tuple[str, ...]] = ()
    missing: ClassVar[int] = 2
    access: ClassVar[str] = "none"

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return zeros."""
        return np.zeros((len(observation), 2)), ()


@dataclass(frozen=True)
class PdGravity(TorqueLaw):
    """PD with gravity compensation.

        torque = Kp (r - q) + Kd (r' - v) + G(q),    Kp = w^2 M_ii,    Kd = 2 damping w M_ii

    M_ii is the diagonal of the nominal inertia of the stretched arm, so that each joint alone is a
    second-order system of frequency w. A constant load d leaves the error d / Kp.

    Sensors: position and velocity. Source: Takegaki and Arimoto, "A new feedback method for dynamic
    control of manipulators", J. Dyn. Sys. Meas. Control 103(2), 1981.

    Args:
        frequency: w [rad/s], per joint.
        damping: damping ratio, per joint; 1 is critical. The default is lower because a bent or
            light arm multiplies the velocity gain 2 damping w, which a delay limits.
    """

    frequency: Gain = pair(10.0, unit="rad/s", tune=(2.0, 100.0))
    damping: Gain = pair(0.4, tune=(0.3, 3.0))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m; there is no state."""
        q, v, r, r_dot = self.read(observation, "position", "velocity", "reference_position", "reference_velocity")
        w = np.array(self.frequency)
        kp, kd = w**2 * self.stretched, 2.0 * np.array(self.damping) * w * self.stretched
        return kp * (r - q) + kd * (r_dot - v) + gravity_torque(self.interface.nominal, q), ()


@dataclass(frozen=True)
class PidGravity(PdGravity, IntegralLaw):
    """PID with gravity compensation, the usual law of industrial robots.

        torque = Kp (r - q) + Kd (r' - v) + Ki int(r - q) dt + G(q),    Ki = integral w^3 M_ii

    Kp and Kd are those of `PdGravity`. Each joint alone is stable for integral < 2 damping. At rest
    no constant load leaves an error. The integral pauses where the torque saturates and the error
    asks for more.

    Sensors: position and velocity. Source: Arimoto, "Control Theory of Non-linear Mechanical
    Systems", 1996, §3.3; Kelly, Santibanez and Loria, "Control of Robot Manipulators in Joint
    Space", 2005, ch. 9.

    Args:
        integral: share of the integral action, per joint.
    """

    integral: Gain = pair(0.1, low=0, tune=(0.01, 1.0))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next integral."""
        q, r = self.read(observation, "position", "reference_position")
        error = r - q
        ki = np.array(self.integral) * np.array(self.frequency) ** 3 * self.stretched
        torque = super().torque(observation, ())[0] + ki * state.integral
        pause = (self.interface.saturate(torque) != torque) & (torque * error > 0.0)
        return torque, IntegralState(state.integral + np.where(pause, 0.0, error * self.interface.control_dt))
