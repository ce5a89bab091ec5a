"""The paper's cascade: an inner velocity loop and an outer position loop (§3.1)."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from controllers.base import Array, Gain, IntegralLaw, IntegralState, State, number, pair
from fbl_gym.options import Friction
from fbl_gym.records.record import Distribution, record


def friction_torque(friction: Friction, velocity: Array) -> Array:
    """Return the friction torque of equation (43) as printed, with sign(0) = 0, [... x 2] N m."""
    fade = np.exp(-(velocity**2) / np.array(friction.v_s))
    dry = np.array(friction.coulomb) + np.array(friction.stiction) * fade
    return np.array(friction.viscous) * velocity + dry * np.sign(velocity)


@dataclass(frozen=True)
class CascadeFlm(IntegralLaw):
    """The paper's cascade: an inner velocity PI and an outer P loop (§3.1, equation (8)).

        a = P e_v + I int(e_v) dt,    e_v = r' + Kp (r - q) - v,    torque = M a + C v + G

    The integral pauses where the torque saturates. The last three gains are off by default: F^ of
    (22) and tau_d^ of (6) in the torque, and an acceleration that the paper does not feed forward.

    Sensors: position and velocity.

    Args:
        kp: Kp of the outer loop [1/s], per joint. The paper leaves it open.
        velocity_p: P of the inner loop [1/s], per joint. The defaults are the paper's.
        velocity_i: I of the inner loop [1/s^2], per joint. The defaults are the paper's.
        feedforward: share of the velocity reference's derivative, r'' + Kp (r' - v), added to a.
        friction: F^, the known friction, a `Friction` without `load`, or a dict of its fields;
            None: none.
        disturbance: tau_d^, a known constant disturbance torque [N m], per joint.
    """

    kp: Gain = pair(10.0, unit="1/s", tune=(1.0, 100.0))
    velocity_p: Gain = pair((30.0, 35.0), unit="1/s", tune=(5.0, 200.0))
    velocity_i: Gain = pair((13.0, 20.0), unit="1/s^2", tune=(1.0, 2000.0))
    feedforward: float = number(0.0, low=0, high=1)
    friction: Friction | None = record(Friction, None)
    disturbance: Gain = pair(0.0, unit="N m")

    def validate(self) -> None:
        """Refuse a known friction that varies, or that follows the torque."""
        super().validate()
        known = self.friction or Friction()
        varies = any(isinstance(number, Distribution) for value in vars(known).values() for number in value)
        if varies or known.load != (0.0, 0.0):
            raise ValueError(f"friction must have fixed numbers and no load, as in equation (22), got {known}")

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m, and the next integral."""
        q, v = self.read(observation, "position", "velocity")
        torque, integral = self.loops(observation, q, v, state.integral, self.interface.nominal)
        return torque, IntegralState(integral)

    def loops(
        self, observation: Array, q: Array, v: Array, integral: Array, model: Any, schedule: Array | float = 1.0
    ) -> tuple[Array, Array]:
        """Return the torque [n x 2] N m of both loops, and the next integral [n x 2].

        q [rad] and v [rad/s] are measured or estimated. The model is an arm, or estimated lumped
        parameters [n x 5], with rotors [n x 7]. The schedule multiplies the inner loops' error, in
        P and in the integral; see `gain_scheduling.py`.
        """
        r, r_dot = self.read(observation, "reference_position", "reference_velocity")
        error = schedule * (r_dot + np.array(self.kp) * (r - q) - v)
        a = np.array(self.velocity_p) * error + np.array(self.velocity_i) * integral
        if self.feedforward:
            (r_ddot,) = self.read(observation, "reference_acceleration")
            a = a + self.feedforward * (r_ddot + np.array(self.kp) * (r_dot - v))
        return self.integrating(q, v, a, integral, error, model, self.loads(v))

    def loads(self, v: Array) -> Array:
        """Return the known loads F^(v) + tau_d^ of (22) and (6) at a velocity, [n x 2] N m."""
        dry = 0.0 if self.friction is None else friction_torque(self.friction, v)
        return dry + np.broadcast_to(np.array(self.disturbance), v.shape)
