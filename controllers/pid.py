"""Decentralised PID on the nominal linearised arm, §2.2 of the paper."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from controllers.feedback_linearization import linearize, winds_up
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array
from fbl_gym.checks import Pair, check_pair
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class PidFlm(TorqueLaw):
    """a = r'' + kp e + kd e' + ki int(e), through the nominal feedback linearisation mapping.

    With an exact model the error obeys e'' + kd e' + kp e = 0 (for ki = 0). The paper's §2.2 gives "P, I, D = 10, 3, 0",
    which is unstable on a double integrator: s^3 + 10 s + 3 has the roots 0.149 +- 3.17j. The defaults read it as P = 10,
    D = 3, I = 0.

    Args:
        kp: [1/s^2], per joint.
        ki: [1/s^3], per joint.
        kd: [1/s], per joint.
    """

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {"kp": (1.0, 1e4), "ki": (1e-2, 1e4), "kd": (1.0, 200.0)}
    )

    kp: Pair | float = 10.0
    ki: Pair | float = 0.0
    kd: Pair | float = 3.0

    def __post_init__(self) -> None:
        super().__post_init__()
        set_fields(self, kp=check_pair("kp", self.kp), ki=check_pair("ki", self.ki), kd=check_pair("kd", self.kd))

    def initial(self, observation: Array) -> State:
        return (np.zeros((len(observation), 2)),)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        q, v = self.read(observation, "position", "velocity")
        r, r_dot, r_ddot = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        (integral,) = state
        error = r - q
        a = r_ddot + np.array(self.kp) * error + np.array(self.kd) * (r_dot - v) + np.array(self.ki) * integral
        torque = linearize(self.interface.nominal, q, v, a)
        pause = winds_up(self.interface, self.interface.nominal, q, v, a, torque, error)
        return torque, (integral + np.where(pause, 0.0, error * self.interface.control_dt),)
