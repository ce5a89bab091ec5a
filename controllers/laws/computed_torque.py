"""Computed torque, the textbook law for a known model, alone and with disturbance estimates."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from controllers.base import Acting, Array, Gain, State, TorqueLaw, number, pair
from controllers.numerics.dynamics import momentum


@dataclass(frozen=True)
class ComputedTorque(TorqueLaw):
    """Computed torque, critically damped.

        torque = M(q) a + C v + G,    a = r'' + w^2 (r - q) + 2 w (r' - v)

    With an exact model the error obeys e'' + 2 w e' + w^2 e = 0.

    Sensors: position and velocity. Source: Siciliano, Sciavicco, Villani and Oriolo, "Robotics:
    Modelling, Planning and Control", 2009, §8.5.2.

    Args:
        frequency: w [rad/s], per joint.
    """

    frequency: Gain = pair(15.0, unit="rad/s", above=0, tune=(2.0, 150.0))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m; there is no state."""
        q, v = self.read(observation, "position", "velocity")
        return self.inverse(q, v, self.acceleration(observation, q, v)), state

    def acceleration(self, observation: Array, q: Array, v: Array) -> Array:
        """Return a, the desired acceleration [n x 2] rad/s^2."""
        r, r_dot, r_ddot = self.reference(observation)
        w = np.array(self.frequency)
        return r_ddot + w**2 * (r - q) + 2.0 * w * (r_dot - v)


class DobState(NamedTuple):
    """State of `ComputedTorqueDob`, the arrays [n x 2]."""

    disturbance: Array  # d^ [N m]
    momentum: Array  # at the last sample [N m s]
    drift: Array  # C'v - G at the last sample [N m]
    acting: Acting


@dataclass(frozen=True)
class ComputedTorqueDob(ComputedTorque):
    """Computed torque with a disturbance observer on the momentum p = M(q) v.

        torque = M(q) a + C v + G + d^,    d^' = bandwidth (torque + C'v - G - p' - d^)

    The momentum obeys p' = torque + C'v - G - d with the skew form of C, so no acceleration is
    needed. Model errors count as disturbance. The observer gets the torque within its limits, so it
    does not wind up, at the time at which the known drive applies it.

    Sensors: position and velocity. Source: De Luca, Albu-Schaeffer, Haddadin and Hirzinger,
    "Collision detection and safe reaction with the DLR-III lightweight robot arm", IROS 2006.

    Args:
        bandwidth: of the observer [rad/s]; its time constant is 1 / bandwidth.
    """

    frequency: Gain = 10.0
    bandwidth: float = number(30.0, unit="rad/s", above=0, tune=(2.0, 300.0))

    def initial(self, observation: Array) -> State:
        """Return the state: no disturbance, and the torque that leaves the momentum as it is."""
        q, v = self.read(observation, "position", "velocity")
        p, drift = momentum(self.interface.nominal, q, v)
        return DobState(np.zeros_like(q), p, drift, self.drive.hold(self.holding(q))._replace(mean=-drift))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        q, v = self.read(observation, "position", "velocity")
        dt, (p, drift) = self.interface.control_dt, momentum(self.interface.nominal, q, v)
        # d = torque + (C'v - G) - p', averaged over the interval that ends now.
        missing = state.acting.mean + 0.5 * (state.drift + drift) - (p - state.momentum) / dt
        disturbance = state.disturbance - np.expm1(-self.bandwidth * dt) * (missing - state.disturbance)
        torque = self.inverse(q, v, self.acceleration(observation, q, v)) + disturbance
        acting = self.drive.act(state.acting, self.interface.saturate(torque))
        return torque, DobState(disturbance, p, drift, acting)


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

    frequency: Gain = pair(10.0, unit="rad/s", above=0, tune=(2.0, 40.0))
    bandwidth: Gain = pair(12.0, unit="rad/s", above=0, tune=(5.0, 200.0))

    needs: ClassVar[tuple[str, ...]] = ("position", "velocity", "acceleration")

    def initial(self, observation: Array) -> State:
        """Return the state: d, zero, and the torque that holds the nominal arm still."""
        (q,) = self.read(observation, "position")
        return TdeState(np.zeros_like(q), self.drive.hold(self.holding(q)))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        q, v, a = self.read(observation, "position", "velocity", "acceleration")
        # d = d + (1 - exp(-g dt)) (torque_0 - (M a_0 + C v + G) - d)
        share = -np.expm1(-np.array(self.bandwidth) * self.interface.control_dt)
        missed = state.missed + share * (state.acting.torque - self.inverse(q, v, a) - state.missed)
        torque = self.inverse(q, v, self.acceleration(observation, q, v)) + missed
        return torque, TdeState(missed, self.drive.act(state.acting, self.interface.saturate(torque)))
