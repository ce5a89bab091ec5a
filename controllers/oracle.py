"""The ceiling of the board: feedback linearisation that knows everything. Marked as the privileged access, and never ranked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from controllers.policy import State
from fbl_gym.arm import Array, inverse_dynamics
from fbl_gym.batch import Truth
from fbl_gym.checks import Pair, check_pair
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class OracleFlm:
    """a = r'' + kp e + kd e' on the true state, through the true arm, with friction and disturbance compensated.

    It looks at `env.truth`, so it must be used with the very environment it was made for.

    Args:
        env: the environment, single or batched.
        kp: [1/s^2], per joint.
        kd: [1/s], per joint.
    """

    env: Any
    kp: Pair | float = 400.0
    kd: Pair | float = 40.0

    access: ClassVar[str] = "privileged"

    def __post_init__(self) -> None:
        set_fields(self, kp=check_pair("kp", self.kp), kd=check_pair("kd", self.kd))

    def predict(
        self,
        observation: Array,
        state: State | None = None,
        episode_start: Array | None = None,
        deterministic: bool = False,
    ) -> tuple[Array, State | None]:
        """See `controllers.policy.Policy.predict`; the observation tells it nothing but the shape of the answer."""
        truth: Truth = self.env.truth
        lanes, asked = len(np.atleast_2d(truth.position)), len(np.atleast_2d(observation))
        if asked != lanes:
            raise ValueError(f"the oracle was made for an environment of {lanes} lanes, got {asked} observations")
        error, rate = truth.reference - truth.position, truth.reference_velocity - truth.velocity
        a = truth.reference_acceleration + np.array(self.kp) * error + np.array(self.kd) * rate
        load = inverse_dynamics(truth.lumped, truth.position, truth.velocity, a)
        torque = load + self._friction(truth) + truth.disturbance
        interface = self.env.interface
        action = interface.action_from_torque(torque, truth.position, truth.velocity)
        return action.reshape(*np.shape(observation)[:-1], 2), state

    def _friction(self, truth: Truth) -> Array:
        """Friction of the motion asked for: its sign is steady where the real velocity's would chatter."""
        friction = self.env.scenario.friction
        if friction is None:
            return np.zeros_like(truth.velocity)
        v = truth.reference_velocity
        fade = np.exp(-(truth.velocity**2) / np.array(friction.v_s))
        dry = np.array(friction.coulomb) + np.array(friction.stiction) * fade
        return np.array(friction.viscous) * truth.velocity + dry * np.sign(v)
