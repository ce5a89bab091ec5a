"""Time-delay control: the torque error of the last interval corrects the next torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array, gravity_torque, inverse_dynamics
from fbl_gym.checks import Pair
from fbl_gym.records import pair


@dataclass(frozen=True)
class TimeDelay(TorqueLaw):
    """Time-delay control.

        torque = M a + C v + G + d,    a = r'' + w^2 (r - q) + 2 w (r' - v)
        d = LP(torque_0 - (M a_0 + C v + G))

    a_0 is the measured acceleration and torque_0 the torque applied up to it, so d is the torque
    that the nominal model missed. Both pass the same low-pass filter LP. Without the filter the law
    is torque = torque_0 + M (a - a_0), also known as incremental nonlinear dynamic inversion.

    With a real inertia of M / k the estimate d has the pole 1 - k h per sample, h = 1 - exp(-g dt).
    The loop is stable for k < 2 / (h + 2 w dt - h w dt), w^2 dt^2 neglected; without the filter and
    with slow poles that is Hsia's k < 2.

    Sensors: position, velocity and acceleration. Source: Youcef-Toumi and Ito, "A time delay
    controller for systems with unknown dynamics", J. Dyn. Sys. Meas. Control 112(1), 1990; Hsia, "A
    new technique for robust control of servo systems", IEEE TIE 36(1), 1989; Sieberling, Chu and
    Mulder, "Robust flight control using incremental nonlinear dynamic inversion and angular
    acceleration prediction", JGCD 33(6), 2010.

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
        return np.zeros_like(q), self.interface.saturate(gravity_torque(self.interface.nominal, q))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        missed, applied = state
        q, v, a = self.read(observation, "position", "velocity", "acceleration")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        nominal, w = self.interface.nominal, np.array(self.frequency)
        # d = d + (1 - exp(-g dt)) (torque_0 - (M a_0 + C v + G) - d)
        share = -np.expm1(-np.array(self.bandwidth) * self.interface.control_dt)
        missed = missed + share * (applied - inverse_dynamics(nominal, q, v, a) - missed)
        desired = r_ddot + w**2 * (r - q) + 2.0 * w * (r_dot - v)
        torque = inverse_dynamics(nominal, q, v, desired) + missed
        return torque, (missed, self.interface.saturate(torque))
