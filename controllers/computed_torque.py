"""Computed torque, the textbook law for a known model, alone and with a disturbance observer."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controllers.policy import State, TorqueLaw
from fbl_gym.checks import Pair
from fbl_gym.model.arm import Array, coriolis_matrix, gravity_torque, inertia_matrix, inverse_dynamics
from fbl_gym.records import number, pair


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

    frequency: Pair | float = pair(15.0, unit="rad/s", above=0, tune=(2.0, 150.0))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m; there is no state."""
        q, v = self.read(observation, "position", "velocity")
        return inverse_dynamics(self.interface.nominal, q, v, self.acceleration(observation, q, v)), state

    def acceleration(self, observation: Array, q: Array, v: Array) -> Array:
        """Return a, the desired acceleration [n x 2] rad/s^2."""
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        w = np.array(self.frequency)
        return r_ddot + w**2 * (r - q) + 2.0 * w * (r_dot - v)


class DobState(NamedTuple):
    """State of `ComputedTorqueDob`, each array [n x 2]."""

    disturbance: Array  # d^ [N m]
    momentum: Array  # at the last sample [N m s]
    drift: Array  # C'v - G at the last sample [N m]
    applied: Array  # torque within its limits since the last sample [N m]
    started: Array  # False before the first sample [n]


@dataclass(frozen=True)
class ComputedTorqueDob(ComputedTorque):
    """Computed torque with a disturbance observer on the momentum p = M(q) v.

        torque = M(q) a + C v + G + d^,    d^' = bandwidth (torque + C'v - G - p' - d^)

    The momentum obeys p' = torque + C'v - G - d with the skew form of C, so no acceleration is
    needed. Model errors count as disturbance. The observer gets the applied torque, so it does not
    wind up.

    Sensors: position and velocity. Source: De Luca, Albu-Schaeffer, Haddadin and Hirzinger,
    "Collision detection and safe reaction with the DLR-III lightweight robot arm", IROS 2006.

    Args:
        bandwidth: of the observer [rad/s]; its time constant is 1 / bandwidth.
    """

    frequency: Pair | float = 10.0
    bandwidth: float = number(10.0, unit="rad/s", above=0, tune=(2.0, 200.0))

    def initial(self, observation: Array) -> State:
        """Return the state before the first sample: zeros."""
        zeros = np.zeros((len(observation), 2))
        return DobState(zeros, zeros, zeros, zeros, np.zeros(len(observation), dtype=bool))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        q, v = self.read(observation, "position", "velocity")
        model, dt = self.interface.nominal, self.interface.control_dt
        momentum = np.einsum("nij,nj->ni", inertia_matrix(model, q), v)
        drift = np.einsum("nji,nj->ni", coriolis_matrix(model, q, v, skew=True), v) - gravity_torque(model, q)
        # d = torque + (C'v - G) - p', averaged over the interval that ends now.
        missing = state.applied + 0.5 * (state.drift + drift) - (momentum - state.momentum) / dt
        keep = np.exp(-self.bandwidth * dt)
        filtered = keep * state.disturbance + (1.0 - keep) * missing
        disturbance = np.where(state.started[:, None], filtered, state.disturbance)
        torque = inverse_dynamics(model, q, v, self.acceleration(observation, q, v)) + disturbance
        applied = self.interface.saturate(torque)
        return torque, DobState(disturbance, momentum, drift, applied, np.ones_like(state.started))
