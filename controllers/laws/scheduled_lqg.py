"""LQG that schedules the bandwidth of its filter by hand."""

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from controllers.base import State
from controllers.laws.lqg_elastic import LqgElastic
from fbl_gym.model.arm import Array
from fbl_gym.records.record import number


class ScheduledState(NamedTuple):
    """State of `LqgElasticScheduled`."""

    careful: State
    fast: State
    apart: Array  # difference of the two torques at the last sample, over the inertia [n x 2] rad/s^2
    change: Array  # running mean square of its change over a sample [n x 2] rad^2/s^4


@dataclass(frozen=True)
class LqgElasticScheduled(LqgElastic):
    """A careful and a fast `LqgElastic`, of which an oscillation takes the former.

        torque = s careful + (1 - s) fast,    s = c^2 / (c^2 + onset^4)

    c is the mean square of the change, over one sample, of the difference between both torques
    over the inertia, for each joint. It is the rule that an engineer writes down in place of the
    agent `ppo-blend`, which chooses s by a network. Both get the torque that is sent.

    Sensors: position. Source: Rugh and Shamma, "Research on gain scheduling", Automatica 36(10),
    2000, for the method; the rule itself is this package's.

    Args:
        careful: the careful filter's bandwidth, in multiples of `observer`.
        fast: that of the fast one.
        onset: root of c at which both have equal shares [rad/s^2].
        memory: time constant of the mean square [s].
    """

    careful: float = number(0.75, above=0)
    fast: float = number(1.5, above=0)
    onset: float = number(12.0, unit="rad/s^2", above=0)
    memory: float = number(0.3, unit="s", above=0)

    @cached_property
    def both(self) -> tuple[LqgElastic, LqgElastic]:
        """The careful and the fast law."""
        gains = {each.name: getattr(self, each.name) for each in dataclasses.fields(LqgElastic)}
        careful, fast = (LqgElastic(**gains | {"observer": self.observer * each}) for each in (self.careful, self.fast))
        return careful, fast

    def initial(self, observation: Array) -> State:
        """Return the state: that of both laws, without an oscillation."""
        careful, fast = (law.initial(observation) for law in self.both)
        zero = np.zeros((len(observation), 2))
        return ScheduledState(careful, fast, zero, zero)

    def decide(self, observation: Array, state: State) -> tuple[Array, Any]:
        """Return the torque [n x 2] N m, and a draft for `settle`."""
        (careful, first), (fast, second) = (
            law.decide(observation, each) for law, each in zip(self.both, state[:2], strict=True)
        )
        apart = (careful - fast) / self.stretched
        share = min(1.0, self.interface.control_dt / self.memory)
        change = state.change + share * ((apart - state.apart) ** 2 - state.change)
        taken = change**2 / (change**2 + self.onset**4)
        return fast + taken * (careful - fast), ScheduledState(first, second, apart, change)

    def settle(self, draft: Any, torque: Array) -> State:
        """Return the next state where a torque [n x 2] N m is sent."""
        careful, fast = (law.settle(each, torque) for law, each in zip(self.both, draft[:2], strict=True))
        return draft._replace(careful=careful, fast=fast)
