"""Time-delay control, and computed torque with time-delay estimation."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.computed_torque import ComputedTorque
from controllers.parts import Acting
from controllers.policy import State
from fbl_gym.checks import Pair
from fbl_gym.model.arm import Array, gravity_torque, inverse_dynamics
from fbl_gym.records import pair


class TimeDelayState(NamedTuple):
    """State of `TimeDelay`, each array [n x 2]."""

    velocity: Array  # at the last sample [rad/s]
    applied: Array  # the last torque within its limits [N m]


@dataclass(frozen=True)
class TimeDelay(ComputedTorque):
    """Time-delay control: the last torque and the last acceleration replace the model.

        torque(t) = torque(t - L) + Mbar (a - q''(t - L)),    a = r'' + w^2 (r - q) + 2 w (r' - v)

    L is the control interval, q''(t - L) = (v(t) - v(t - L)) / L, and torque(t - L) the torque
    within its limits. Mbar = (1 - exp(-bandwidth L)) diag(M) of the stretched nominal arm is all
    that the law uses of the model, besides the gravity torque at an episode's start. A small Mbar
    acts as a low-pass filter, which noise and a delay of the drive require.

    Sensors: position and velocity. Source: Youcef-Toumi and Ito, "A time delay controller for
    systems with unknown dynamics", J. Dyn. Sys. Meas. Control 112(1), 1990; Hsia, Lasky and Guo,
    "Robust independent joint controller design for industrial robot manipulators", IEEE TIE 38(1),
    1991.

    Args:
        frequency: w [rad/s], per joint: both poles of the tracking error are -w.
        bandwidth: of the estimate that the last torque is [rad/s], per joint: for a joint alone it
            nears the torque that is missing with the time constant 1 / bandwidth, at every rate.
    """

    frequency: Pair | float = pair(8.0, unit="rad/s", above=0, tune=(2.0, 40.0))
    bandwidth: Pair | float = pair(15.0, unit="rad/s", above=0, tune=(2.0, 200.0))

    def initial(self, observation: Array) -> State:
        """Return the state: the last velocity, and the torque that holds the nominal arm still."""
        q, v = self.read(observation, "position", "velocity")
        return TimeDelayState(v, self.interface.saturate(gravity_torque(self.interface.nominal, q)))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        q, v = self.read(observation, "position", "velocity")
        change = self.acceleration(observation, q, v) - (v - state.velocity) / self.interface.control_dt
        share = -np.expm1(-np.array(self.bandwidth) * self.interface.control_dt)
        torque = state.applied + share * self.stretched * change
        return torque, TimeDelayState(v, self.interface.saturate(torque))


class TdeState(NamedTuple):
    """State of `ComputedTorqueTde`."""

    missed: Array  # d [n x 2] N m
    acting: Acting


@dataclass(frozen=True)
class ComputedTorqueTde(ComputedTorque):
    """Computed torque with time-delay estimation of the torque that the nominal model misses.

        torque = M a + C v + G + d,    a = r'' + w^2 (r - q) + 2 w (r' - v)
        d = LP(torque_0 - (M a_0 + C v + G))

    a_0 is the measured acceleration and torque_0 the torque of that time, by the known drive. Both
    pass the same low-pass filter LP. Without the filter the law is torque = torque_0 + M (a - a_0),
    also known as incremental nonlinear dynamic inversion.

    Sensors: position, velocity and acceleration. Source: Hsia, "A new technique for robust control
    of servo systems", IEEE TIE 36(1), 1989; Sieberling, Chu and Mulder, "Robust flight control
    using incremental nonlinear dynamic inversion and angular acceleration prediction", JGCD 33(6),
    2010.

    Args:
        frequency: w [rad/s], per joint: both poles of the tracking error are -w.
        bandwidth: g of the filter [rad/s], per joint. Sensor noise and light arms limit it.
    """

    frequency: Pair | float = pair(10.0, unit="rad/s", above=0, tune=(2.0, 40.0))
    bandwidth: Pair | float = pair(12.0, unit="rad/s", above=0, tune=(5.0, 200.0))

    needs: ClassVar[tuple[str, ...]] = ("position", "velocity", "acceleration")

    def initial(self, observation: Array) -> State:
        """Return the state: d, zero, and the torque that holds the nominal arm still."""
        (q,) = self.read(observation, "position")
        return TdeState(
            np.zeros_like(q), self.drive.hold(self.interface.saturate(gravity_torque(self.interface.nominal, q)))
        )

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        q, v, a = self.read(observation, "position", "velocity", "acceleration")
        nominal = self.interface.nominal
        # d = d + (1 - exp(-g dt)) (torque_0 - (M a_0 + C v + G) - d)
        share = -np.expm1(-np.array(self.bandwidth) * self.interface.control_dt)
        missed = state.missed + share * (state.acting.torque - inverse_dynamics(nominal, q, v, a) - state.missed)
        torque = inverse_dynamics(nominal, q, v, self.acceleration(observation, q, v)) + missed
        return torque, TdeState(missed, self.drive.act(state.acting, self.interface.saturate(torque)))
