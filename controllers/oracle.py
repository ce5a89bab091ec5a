"""The oracle: feedback linearisation with the true arm. Its score is 100."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from controllers.policy import State
from fbl_gym.arm import Array, inverse_dynamics, with_rotors
from fbl_gym.batch import Truth
from fbl_gym.checks import Pair
from fbl_gym.records import Record, pair


@dataclass(frozen=True)
class OracleFlm(Record):
    """The oracle: feedback linearisation that knows everything. It is not ranked.

        torque = M a + C v + G + friction + d,    a = r'' + kp (r - q) + kd (r' - v)

    All terms are true ones, read from `env.truth`, and e'' + kd e' + kp e = 0 up to sampling and
    torque limits. It acts only in the environment that it was built for.

    Args:
        env: the environment, single or batched.
        kp: proportional gain [1/s^2], per joint.
        kd: derivative gain [1/s], per joint.
    """

    env: Any = dataclasses.field(repr=False)
    kp: Pair | float = pair(400.0, unit="1/s^2")
    kd: Pair | float = pair(40.0, unit="1/s")

    access: ClassVar[str] = "privileged"

    def predict(
        self,
        observation: Array,
        state: State | None = None,
        episode_start: Array | None = None,
        deterministic: bool = False,
    ) -> tuple[Array, State | None]:
        """Return the action for the environment's true state, and `state` unchanged."""
        truth: Truth = self.env.truth
        lanes, rows = len(np.atleast_2d(truth.position)), len(np.atleast_2d(observation))
        if rows != lanes:
            raise ValueError(f"the oracle was made for an environment of {lanes} lanes, got {rows} observations")
        error, rate = truth.reference - truth.position, truth.reference_velocity - truth.velocity
        a = truth.reference_acceleration + np.array(self.kp) * error + np.array(self.kd) * rate
        arm = with_rotors(truth.lumped, self.env.scenario.rotor)
        load = inverse_dynamics(arm, truth.position, truth.velocity, a)
        torque = (load + self._friction(truth) + truth.disturbance) / truth.gain
        action = self.env.interface.action_from_torque(torque, truth.position, truth.velocity)
        return action.reshape(*np.shape(observation)[:-1], 2), state

    def _friction(self, truth: Truth) -> Array:
        """Return the friction, its dry part along the reference, whose sign is steady."""
        if self.env.scenario.friction is None:
            return np.zeros_like(truth.velocity)
        v = truth.reference_velocity
        dry = truth.coulomb + truth.stiction * np.exp(-(truth.velocity**2) / truth.v_s)
        return truth.viscous * truth.velocity + dry * np.sign(v)
