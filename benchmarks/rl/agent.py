"""An agent as a policy, which is an adapter and an actor network, and the folder that holds it.

In the folder, `agent.json` describes the agent and names the file of its network, which has single
precision. Both are plain data: reading them runs no code.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from benchmarks.files import replacing, write_text
from benchmarks.rl.adapter import SENSORS, AdapterSettings, AgentAdapter
from benchmarks.rl.network import Actor
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array
from fbl_gym.interface import Interface

DESCRIPTION, WEIGHTS = "agent.json", "weights.npz"
_ZIP = (zipfile.BadZipFile, zlib.error, RuntimeError)  # the errors of damaged archives


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

    needs: ClassVar[tuple[str, ...]] = ("position",)

    def validate(self) -> None:
        """Refuse an interface without the agent's sensors, and context without an environment."""
        present = [name for name in SENSORS if name in self.interface.layout]
        if any(name not in present for name in self.settings.sensors):
            raise ValueError(
                f"not applicable: the agent was trained on sensors of {', '.join(self.settings.sensors)}, "
                f"got {', '.join(present)}"
            )
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
    arrays: dict[str, Any] = {}
    for i, (weight, bias) in enumerate(actor.layers):
        arrays[f"weight_{i}"], arrays[f"bias_{i}"] = np.float32(weight), np.float32(bias)
    content = io.BytesIO()
    np.savez(content, **arrays)
    # The weights of an earlier agent stay until the description, in one step, names the new ones.
    weights = f"weights-{hashlib.sha256(content.getvalue()).hexdigest()[:12]}.npz"
    with replacing(folder / weights) as beside:
        beside.write_bytes(content.getvalue())
    network = {"layers": len(actor.layers), "activation": actor.activation, "output": actor.output}
    write_text(
        folder / DESCRIPTION, json.dumps({**description, "weights": weights, "network": network}, indent=1) + "\n"
    )
    for file in folder.glob("weights*.npz"):
        if file.name != weights:
            file.unlink(missing_ok=True)


def describe(folder: Path) -> dict[str, Any]:
    """Return the content of a folder's `agent.json`."""
    path = folder / DESCRIPTION
    if not path.exists():
        raise ValueError(f"folder must hold an agent.json, as `fbl-gym train` writes it, got {str(folder)!r}")
    with _reading(path):
        description: dict[str, Any] = {"weights": WEIGHTS, **json.loads(path.read_text(encoding="utf-8"))}
        _ = description["interface"].items(), (folder / description["weights"]).name
    return description


def files(folder: Path) -> list[Path]:
    """Return the files of the agent in a folder."""
    return [folder / DESCRIPTION, folder / describe(folder)["weights"]]


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn each error of reading a malformed file into one that names the file."""
    try:
        yield
    except (ArithmeticError, AttributeError, EOFError, LookupError, OSError, TypeError, ValueError, *_ZIP) as problem:
        reason = f"it lacks {problem}" if isinstance(problem, KeyError) else problem
        raise ValueError(f"{path} must be as `fbl-gym train` wrote it: {reason}") from None


def read(folder: Path) -> tuple[AdapterSettings, Actor]:
    """Return the adapter's settings and the network of the agent in a folder."""
    description = describe(folder)
    weights = folder / description["weights"]
    with _reading(weights), weights.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        arrays = {name: file[name].astype(float) for name in file}
    with _reading(folder / DESCRIPTION):
        network, settings = description["network"], AdapterSettings(**description["interface"])
        layers = tuple((arrays[f"weight_{i}"], arrays[f"bias_{i}"]) for i in range(network["layers"]))
        return settings, Actor(layers, network["activation"], network["output"])


def access_of(folder: Path) -> str:
    """Return the access of a folder's agent: "privileged" with context, else "nominal"."""
    return "privileged" if describe(folder)["interface"].get("context") else "nominal"


def needs_of(folder: Path) -> tuple[str, ...]:
    """Return the sensors that a folder's agent observes."""
    sensors = describe(folder)["interface"].get("sensors", SENSORS)
    return tuple(name for name in SENSORS if name in sensors)


def saved_agent(env: Any, folder: str) -> Agent:
    """Return the agent of a folder; only one with context gets the environment itself."""
    settings, actor = read(Path(folder))
    if isinstance(env, Interface):
        return Agent(env, settings, actor)
    return Agent(env.unwrapped.interface, settings, actor, env.unwrapped if settings.context else None)
