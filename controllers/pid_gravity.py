"""PID with gravity compensation: the floor that industry uses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from controllers.policy import State
from controllers.simple import PdGravity
from fbl_gym.arm import Array
from fbl_gym.checks import Pair, check_pair
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class PidGravity(PdGravity):
    """torque = Kp e + Kd e' + Ki int(e) + G(q), with the nominal gravity torque.

    Arimoto, "Control Theory of Non-linear Mechanical Systems", 1996, §3.3; Kelly, Santibanez and Loria, "Control of Robot
    Manipulators in Joint Space", 2005, ch. 9. Kp and Kd are those of `PdGravity`, and Ki = integral w^3 M_ii, so that each
    joint on its own has the characteristic polynomial s^3 + 2 damping w s^2 + w^2 s + integral w^3, stable for
    integral < 2 damping. The integrator pauses where the torque saturates and the error asks for more.

    Args:
        frequency, damping: as in `PdGravity`. The defaults are faster and less damped than its own: at 100 Hz what binds is
            the velocity gain 2 damping w, which an arm lighter than its model multiplies.
        integral: share, per joint.
    """

    frequency: Pair | float = 20.0
    damping: Pair | float = 0.4
    integral: Pair | float = 0.1

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {**PdGravity.ranges, "integral": (0.01, 1.0)}
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        set_fields(self, integral=check_pair("integral", self.integral, low=0))

    def initial(self, observation: Array) -> State:
        return (np.zeros((len(observation), 2)),)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        (integral,) = state
        q, r = self.read(observation, "position", "reference_position")
        error = r - q
        ki = np.array(self.integral) * np.array(self.frequency) ** 3 * self.inertia
        torque = super().torque(observation, ())[0] + ki * integral
        pause = (self.interface.saturate(torque) != torque) & (torque * error > 0.0)
        return torque, (integral + np.where(pause, 0.0, error * self.interface.control_dt),)
