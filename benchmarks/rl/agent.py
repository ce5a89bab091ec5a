"""An agent as a policy, which is an adapter and an actor network, and the folder that holds it.

In the folder, `agent.json` describes the agent, and `weights.npz` holds its network in single
precision. Both are plain data: reading them runs no code.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from benchmarks.rl.adapter import SENSORS, AdapterSettings, AgentAdapter
from benchmarks.rl.network import Actor
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array
from fbl_gym.interface import Interface

DESCRIPTION, WEIGHTS = "agent.json", "weights.npz"


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


def write(folder: Path, actor: Actor, description: dict[str, Any]) -> None:
    """Write an agent to a folder.

    The description is plain data; its entry `interface` holds the fields of the `AdapterSettings`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {}
    for i, (weight, bias) in enumerate(actor.layers):
        arrays[f"weight_{i}"], arrays[f"bias_{i}"] = np.float32(weight), np.float32(bias)
    np.savez(folder / f".{WEIGHTS}", **arrays)
    (folder / f".{WEIGHTS}").replace(folder / WEIGHTS)
    network = {"layers": len(actor.layers), "activation": actor.activation, "output": actor.output}
    replace_text(folder / DESCRIPTION, json.dumps({**description, "network": network}, indent=1) + "\n")


def replace_text(path: Path, text: str) -> None:
    """Write a text file in one move, so that no reader sees half of it."""
    temporary = path.with_name(f".{path.name}")
    temporary.write_text(text)
    temporary.replace(path)


def describe(folder: Path) -> dict[str, Any]:
    """Return the content of a folder's `agent.json`."""
    path = folder / DESCRIPTION
    if not path.exists():
        raise ValueError(f"folder must hold an agent.json, as `fbl-gym train` writes it, got {str(folder)!r}")
    return json.loads(path.read_text())


def read(folder: Path) -> tuple[AdapterSettings, Actor]:
    """Return the adapter's settings and the network of the agent in a folder."""
    description = describe(folder)
    network = description["network"]
    with np.load(folder / WEIGHTS, allow_pickle=False) as file:
        layers = tuple(
            (file[f"weight_{i}"].astype(float), file[f"bias_{i}"].astype(float)) for i in range(network["layers"])
        )
    return AdapterSettings(**description["interface"]), Actor(layers, network["activation"], network["output"])


def access_of(folder: Path) -> str:
    """Return the access of a folder's agent: "privileged" with context, else "nominal"."""
    return "privileged" if describe(folder)["interface"].get("context") else "nominal"


def saved_agent(env: Any, folder: str) -> Agent:
    """Return the agent of a folder; only one with context gets the environment itself."""
    settings, actor = read(Path(folder))
    if isinstance(env, Interface):
        return Agent(env, settings, actor)
    return Agent(env.unwrapped.interface, settings, actor, env.unwrapped if settings.context else None)
