"""An agent as a policy: an adapter and an actor network."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from benchmarks.rl.adapter import SENSORS, AdapterSettings, AgentAdapter
from benchmarks.rl.network import Actor
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array


@dataclass(frozen=True, eq=False)
class Agent(TorqueLaw):
    """An agent as a policy of the environment, for any kind of action.

    Args:
        settings: of the adapter.
        actor: network of the agent.
        env: the environment in which an agent with context acts; None for all other agents.
    """

    settings: AdapterSettings
    actor: Actor
    env: Any = None

    needs: ClassVar[tuple[str, ...]] = SENSORS

    def validate(self) -> None:
        """Refuse an agent with context without an environment."""
        super().validate()
        if self.settings.context and self.env is None:
            raise ValueError("an agent with context observes the truth, so it needs the environment, got its interface")

    @cached_property
    def adapter(self) -> AgentAdapter:
        """The adapter between the environment and the network."""
        return AgentAdapter(self.settings, self.interface)

    def initial(self, observation: Array) -> State:
        """Return the state at the start of an episode."""
        return self.adapter.initial(observation)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        context = self.adapter.context(self.env, len(observation))
        action = self.actor(self.adapter.observe(observation, state, context))
        return self.adapter.torque(action, observation, state)
