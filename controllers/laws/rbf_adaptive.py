"""Neural adaptive control: radial basis functions learn the model's torque error."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from controllers.base import Gain, State, TorqueLaw, number, pair
from fbl_gym.model.arm import Array, coriolis_matrix, gravity_torque, inertia_matrix

#: Basis functions around the circle of one joint angle.
NODES = 6

#: Unit of the network's accelerations [rad/s^2]: the largest of a move by two radians in 1.5 s.
ACCELERATION = 5.0

#: Speed over which the network's friction changes its sign [rad/s].
TURN = 0.05

#: Inputs of the network's weights.
FEATURES = NODES**2 + 2 * NODES + 2


def bumps(angle: Array) -> Array:
    """Return the basis functions of an angle, normalised to length one, [... x NODES].

    exp((cos(x - c) - 1) / s^2) about centres c evenly round the circle, s their distance.
    """
    distance = 2.0 * np.pi / NODES
    values = np.exp((np.cos(angle[..., None] - distance * np.arange(NODES)) - 1.0) / distance**2)
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


def features(q: Array, v: Array, a: Array) -> Array:
    """Return phi, the features of a motion [n x FEATURES].

    Lewis's partitioned network: gravity over both angles, inertia over the second angle in
    proportion to acceleration, friction over the signs of the velocities.
    """
    n = len(q)
    first, second = bumps(q[:, 0]), bumps(q[:, 1])
    gravity = (first[:, :, None] * second[:, None, :]).reshape(n, -1)
    inertia = (second[:, :, None] * (a / ACCELERATION)[:, None, :]).reshape(n, -1)
    return np.concatenate([gravity, inertia, np.tanh(v / TURN)], axis=-1)


class RbfState(NamedTuple):
    """State of `RbfAdaptive`."""

    weights: Array  # W [n x 2 x FEATURES]


@dataclass(frozen=True)
class RbfAdaptive(TorqueLaw):
    """Neural adaptive control with radial basis functions.

        torque = M (a_r + k s) + C v_r + G + D W' phi
        dW/dt = rate (phi s' - forget |s| W)
        s = e' + l e,    v_r = r' + l e,    a_r = r'' + l e'

    The features phi are taken along the reference, so they are free of noise. D is the nominal
    inertia of the bent arm (q2 = 90 degrees), so the network's outputs are accelerations.
    Forgetting (e-modification) keeps |W_i| below max |phi| / forget without excitation. A joint's
    weights are held while its torque is cut off and s asks for more.

    Sensors: position and velocity. Source: Lewis, Jagannathan and Yesildirek, "Neural Network
    Control of Robot Manipulators and Nonlinear Systems", 1999, ch. 4.

    Args:
        error_rate: l [1/s], per joint: the error's pole where s = 0 is -l.
        gain: k [1/s], per joint.
        rate: learning rate [1/s^2], per joint. At a constant reference the learned gravity acts as
            an integrator: s'' + k s' + rate s = 0 for a joint alone.
        forget: strength of forgetting.
    """

    error_rate: Gain = pair(10.0, unit="1/s", above=0, tune=(2.0, 40.0))
    gain: Gain = pair(15.0, unit="1/s", above=0, tune=(3.0, 60.0))
    rate: Gain = pair(40.0, unit="1/s^2", above=0, tune=(10.0, 3000.0))
    forget: float = number(0.03, low=0, tune=(1e-4, 1.0))

    def initial(self, observation: Array) -> State:
        """Return the state: the weights W [n x 2 x FEATURES], zero."""
        return RbfState(np.zeros((len(observation), 2, FEATURES)))

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next weights."""
        q, v, r, r_dot, r_ddot = self.motion(observation)
        nominal, error_rate = self.interface.nominal, np.array(self.error_rate)
        v_r, a_r = r_dot + error_rate * (r - q), r_ddot + error_rate * (r_dot - v)
        s, phi = v_r - v, features(r, r_dot, r_ddot)
        inertia, coriolis = inertia_matrix(nominal, q), coriolis_matrix(nominal, q, v, skew=True)
        model = np.einsum("nij,nj->ni", inertia, a_r + np.array(self.gain) * s)
        model = model + np.einsum("nij,nj->ni", coriolis, v_r) + gravity_torque(nominal, q)
        torque = model + self.learned(state.weights, phi)
        learns = (torque - self.interface.saturate(torque)) * s <= 0.0
        # Forgetting is implicit, which is stable at every size of s.
        step = (self.interface.control_dt * np.array(self.rate) * learns)[..., None]
        size = np.linalg.norm(s, axis=-1)[:, None, None]
        weights = (state.weights + step * s[..., None] * phi[:, None, :]) / (1.0 + step * self.forget * size)
        return torque, RbfState(weights)

    def learned(self, weights: Array, phi: Array) -> Array:
        """Return the network's torque [n x 2] N m."""
        return np.einsum("nif,nf->ni", weights, phi) @ inertia_matrix(self.interface.nominal, (0.0, np.pi / 2))
