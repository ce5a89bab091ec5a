"""The folder of a trained agent.

`agent.json` describes the agent, `weights.npz` holds its network in single precision. Both are
plain
data: reading them runs no code.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from benchmarks.rl.adapter import SENSORS, AdapterSettings
from benchmarks.rl.agent import Agent
from benchmarks.rl.network import Actor
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array
from fbl_gym.interface import Interface

DESCRIPTION, WEIGHTS = "agent.json", "weights.npz"


def write(folder: Path, actor: Actor, description: dict[str, Any]) -> None:
    """Write an agent to a folder.

    Args:
        folder: is created if it does not exist.
        actor: network of the agent.
        description: plain data; its entry `interface` holds the fields of the `AdapterSettings`.
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


@dataclass(frozen=True)
class SavedAgent(TorqueLaw):
    """An agent from a folder that `fbl-gym train` wrote.

    Args:
        folder: with `agent.json` and `weights.npz`.
        env: the environment in which an agent with context acts; None for all other agents.
    """

    folder: str
    env: Any = None

    needs: ClassVar[tuple[str, ...]] = SENSORS

    def validate(self) -> None:
        """Read the agent, so that a folder without an agent is an error now."""
        super().validate()
        _ = self.agent

    @cached_property
    def agent(self) -> Agent:
        """The agent of the folder."""
        return Agent(self.interface, *read(Path(self.folder)), self.env)

    @property
    def configuration(self) -> dict[str, str]:
        """A hash of the agent's files, which identifies it wherever its folder lies."""
        content = b"".join((Path(self.folder) / name).read_bytes() for name in (DESCRIPTION, WEIGHTS))
        return {"agent": hashlib.sha256(content).hexdigest()}

    def initial(self, observation: Array) -> State:
        """Return the state at the start of an episode; see `TorqueLaw.initial`."""
        return self.agent.initial(observation)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state; see `TorqueLaw.torque`."""
        return self.agent.torque(observation, state)


def saved_agent(env: Any, folder: str) -> SavedAgent:
    """Return the agent of a folder.

    Only an agent with context gets the environment; all others get its interface.

    Args:
        env: the environment, single or batched, wrapped or not; or its interface.
        folder: with `agent.json` and `weights.npz`.
    """
    if isinstance(env, Interface):
        return SavedAgent(env, folder)
    privileged = access_of(Path(folder)) == "privileged"
    return SavedAgent(env.unwrapped.interface, folder, env.unwrapped if privileged else None)
