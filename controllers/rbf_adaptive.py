"""Neural adaptive control: radial basis functions learn, while the arm moves, what the nominal model misses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array, coriolis_matrix, gravity_torque, inertia_matrix
from fbl_gym.checks import Pair, check_number, check_pair
from fbl_gym.records import set_fields

NODES = 6
"""Basis functions around the circle of one joint angle."""

ACCELERATION = 5.0
"""What counts as one for the network's accelerations [rad/s^2]: the largest of a move by two radians in 1.5 s."""

TURN = 0.05
"""Speed over which the network's friction changes its sign [rad/s]."""

FEATURES = NODES**2 + 2 * NODES + 2


def bumps(angle: Array) -> Array:
    """The basis functions of an angle [...], normalised to length one: [... x NODES].

    exp((cos(x - c) - 1) / s^2) about centres c evenly round the circle, s their distance: an angle has no ends, and so
    no box of angles need be chosen.
    """
    distance = 2.0 * np.pi / NODES
    found = np.exp((np.cos(angle[..., None] - distance * np.arange(NODES)) - 1.0) / distance**2)
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def features(q: Array, v: Array, a: Array) -> Array:
    """What the network looks at, [n x FEATURES], from position, velocity and acceleration [n x 2].

    Lewis's partitioned network: one part for each kind of term of the arm. Gravity depends on both angles, inertia on the
    second and in proportion to acceleration, friction on the signs of the velocities.
    """
    n = len(q)
    first, second = bumps(q[:, 0]), bumps(q[:, 1])
    gravity = (first[:, :, None] * second[:, None, :]).reshape(n, -1)
    inertia = (second[:, :, None] * (a / ACCELERATION)[:, None, :]).reshape(n, -1)
    return np.concatenate([gravity, inertia, np.tanh(v / TURN)], axis=-1)


@dataclass(frozen=True)
class RbfAdaptive(TorqueLaw):
    """torque = M (a_r + k s) + C v_r + G + D W' phi, on the filtered error s = e' + l e, with v_r = r' + l e and a_r = v_r'.

    The weights follow W' = rate (phi s' - forget |s| W): e-modification, which keeps |W_i| below max |phi| / forget without
    excitation. phi is taken along the reference, so that the network's input is free of noise and its nodes few. D is the
    nominal inertia of the bent arm (q2 = 90 degrees), so that the network's outputs are accelerations. For a real arm M_r with
    ideal weights W* and no forgetting,

        V = s' M_r s / 2 + tr(D E' E) / (2 rate), E = W* - W,    has    V' = -k s' M s,

    whatever the nominal model (Lewis, Jagannathan and Yesildirek, "Neural Network Control of Robot Manipulators and Nonlinear
    Systems", 1999, ch. 4). A joint learns nothing while its torque is cut off and s asks for more.

    Args:
        error_rate: l [1/s], per joint: the error's pole where s = 0.
        gain: k [1/s], per joint.
        rate: of learning [1/s^2], per joint. At a fixed reference the learned gravity acts as an integrator:
            s'' + k s' + rate s = 0 for a joint on its own.
        forget: of e-modification [1].
    """

    error_rate: Pair | float = 10.0
    gain: Pair | float = 15.0
    rate: Pair | float = 150.0
    forget: float = 0.03

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {"error_rate": (2.0, 40.0), "gain": (3.0, 60.0), "rate": (10.0, 3000.0), "forget": (1e-4, 1.0)}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("error_rate", "gain", "rate"):
            set_fields(self, **{name: check_pair(name, getattr(self, name), above=0)})
        set_fields(self, forget=check_number("forget", self.forget, low=0))

    def initial(self, observation: Array) -> State:
        return (np.zeros((len(observation), 2, FEATURES)),)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        (weights,) = state
        q, v = self.read(observation, "position", "velocity")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        nominal, l = self.interface.nominal, np.array(self.error_rate)
        v_r, a_r = r_dot + l * (r - q), r_ddot + l * (r_dot - v)
        s, phi = v_r - v, features(r, r_dot, r_ddot)
        inertia, coriolis = inertia_matrix(nominal, q), coriolis_matrix(nominal, q, v, skew=True)
        model = np.einsum("nij,nj->ni", inertia, a_r + np.array(self.gain) * s)
        model = model + np.einsum("nij,nj->ni", coriolis, v_r) + gravity_torque(nominal, q)
        torque = model + self.learned(weights, phi)
        cut = self.interface.saturate(torque)
        learns = (torque - cut) * s <= 0.0
        # W' = rate (phi s' - forget |s| W), forgetting implicit, which is stable at every size of s
        step = (self.interface.control_dt * np.array(self.rate) * learns)[..., None]
        size = np.linalg.norm(s, axis=-1)[:, None, None]
        weights = (weights + step * s[..., None] * phi[:, None, :]) / (1.0 + step * self.forget * size)
        return torque, (weights,)

    def learned(self, weights: Array, phi: Array) -> Array:
        """The network's torque [n x 2] N m, from weights [n x 2 x FEATURES] and features [n x FEATURES]."""
        return np.einsum("nif,nf->ni", weights, phi) @ inertia_matrix(self.interface.nominal, (0.0, np.pi / 2))
