"""The cascade of §3.1 of the paper: an inner velocity loop that fights the leakage, an outer position loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from controllers.feedback_linearization import linearize, winds_up
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import ArmParameters, Array
from fbl_gym.checks import Pair, check_pair
from fbl_gym.records import set_fields


@dataclass(frozen=True)
class CascadeFlm(TorqueLaw):
    """Inner PI on velocity, outer proportional loop with derivative feed-forward, through the nominal mapping.

    a = P e_v + I int(e_v)  with  e_v = r' + Kp (r - q) - v, equation (8). As in the paper, there is no feed-forward of r''.

    Args:
        kp: Kp of the outer loop [1/s], per joint. The paper leaves it open; 10 is the project's choice.
        velocity_p: P of the inner loops [1/s]; the paper's 30 and 35.
        velocity_i: I of the inner loops [1/s^2]; the paper's 13 and 20.
    """

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType(
        {"kp": (1.0, 100.0), "velocity_p": (5.0, 200.0), "velocity_i": (1.0, 2000.0)}
    )

    kp: Pair | float = 10.0
    velocity_p: Pair | float = (30.0, 35.0)
    velocity_i: Pair | float = (13.0, 20.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        gains = {name: check_pair(name, getattr(self, name)) for name in ("kp", "velocity_p", "velocity_i")}
        set_fields(self, **gains)

    def initial(self, observation: Array) -> State:
        return (np.zeros((len(observation), 2)),)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        q, v = self.read(observation, "position", "velocity")
        torque, integral = self.drive(observation, q, v, state[0], self.interface.nominal)
        return torque, (integral,)

    def drive(
        self,
        observation: Array,
        q: Array,
        v: Array,
        integral: Array,
        model: ArmParameters | Array,
        schedule: Array | float = 1.0,
    ) -> tuple[Array, Array]:
        """Both loops and the mapping: the torque, and the next integral.  All [n x 2].

        Args:
            observation: for the reference.
            q, v: position and velocity to go by, measured or filtered.
            integral: of the inner loops' errors.
            model: the arm to linearise with; lumped parameters [n x 5] where they are estimated.
            schedule: factor on the inner loops' error, on P as well as inside the integral; see `gain_scheduling.py`.
        """
        r, r_dot = self.read(observation, "reference_position", "reference_velocity")
        error = schedule * (r_dot + np.array(self.kp) * (r - q) - v)
        a = np.array(self.velocity_p) * error + np.array(self.velocity_i) * integral
        torque = linearize(model, q, v, a)
        pause = winds_up(self.interface, model, q, v, a, torque, error)
        return torque, integral + np.where(pause, 0.0, error * self.interface.control_dt)
