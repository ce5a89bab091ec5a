"""An agent as a policy, which is an adapter and an actor network, and the folder that holds it.

In the folder, `agent.json` describes the agent, and `weights.npz` (or the file that `agent.json`
names) has its network in single precision. Both are plain data: reading them runs no code.
"""

import io
import json
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from benchmarks.agents.adapter import AdapterSettings, AgentAdapter
from benchmarks.agents.network import Actor
from benchmarks.files import replacing, write_text
from benchmarks.text import refusing
from controllers.base import State, TorqueLaw
from fbl_gym.model.arm import Array
from fbl_gym.reading import LARGEST, read_bytes
from fbl_gym.records.checks import check_whole

DESCRIPTION, WEIGHTS = "agent.json", "weights.npz"
_WRITTEN = "must be as `fbl-gym train` wrote it"


@dataclass(frozen=True, eq=False)
class Agent(TorqueLaw):
    """An agent as a policy of the environment, for any kind of action.

    Args:
        settings: of the adapter.
        actor: network of the agent.
    """

    settings: AdapterSettings
    actor: Actor = field(repr=False)

    needs: ClassVar[tuple[str, ...]] = ("position",)

    def validate(self) -> None:
        """Refuse an interface without the agent's sensors, torque limits or preview."""
        _ = self.adapter

    @property
    def uses(self) -> tuple[str, ...]:
        """The law under the residual, which the agent's numbers depend on."""
        return self.settings.uses

    @cached_property
    def adapter(self) -> AgentAdapter:
        """The adapter between the environment and the network."""
        return AgentAdapter(self.settings, self.interface)

    def initial(self, observation: Array) -> State:
        """Return the state at the start of an episode."""
        return self.adapter.initial(observation)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        """Return the torque [n x 2] N m and the next state."""
        action = state.action
        if self.adapter.decides(state).any():
            action = self.actor(self.adapter.observe(observation, state))
        return self.adapter.torque(action, observation, state)


def write(folder: Path, actor: Actor, description: dict[str, Any]) -> None:
    """Write an agent to a folder.

    The description is plain data; its entry `interface` holds the fields of the `AdapterSettings`.
    """
    names = [name for i in range(len(actor.layers)) for name in (f"weight_{i}", f"bias_{i}")]
    with replacing(folder / WEIGHTS) as beside:
        np.savez(beside, **dict(zip(names, map(np.float32, chain(*actor.layers)), strict=True)))  # type: ignore[arg-type]
    network = {"layers": len(actor.layers), "activation": actor.activation, "output": actor.output}
    write_text(folder / DESCRIPTION, json.dumps({**description, "network": network}, indent=1) + "\n")


def describe(folder: Path) -> dict[str, Any]:
    """Return the content of a folder's `agent.json`."""
    path = folder / DESCRIPTION
    if not path.exists():
        raise ValueError(f"folder must hold an agent.json, as `fbl-gym train` writes it, got {str(folder)!r}")
    with refusing(f"{path} {_WRITTEN}"):  # errors of json, zipfile, zlib, NumPy or the records
        description: dict[str, Any] = {"weights": WEIGHTS, **json.loads(read_bytes(path))}
        _ = description["interface"].items(), (folder / description["weights"]).resolve()
    return description


def files(folder: Path) -> list[Path]:
    """Return the files of the agent in a folder."""
    return [folder / DESCRIPTION, folder / describe(folder)["weights"]]


def read(folder: Path) -> tuple[AdapterSettings, Actor]:
    """Return the adapter's settings and the network of the agent in a folder."""
    description = describe(folder)
    weights = folder / description["weights"]
    with refusing(f"{weights} {_WRITTEN}"), np.load(io.BytesIO(read_bytes(weights)), allow_pickle=False) as file:
        if (size := sum(part.file_size for part in file.zip.infolist())) > LARGEST:
            raise ValueError(f"its arrays must have at most {LARGEST} bytes, got {size}")
        arrays = {name: file[name].astype(float) for name in file}
    with refusing(f"{folder / DESCRIPTION} {_WRITTEN}"):
        network = description["network"]
        number = check_whole("layers", network["layers"], low=1)
        layers = tuple((arrays[f"weight_{i}"], arrays[f"bias_{i}"]) for i in range(number))
        return AdapterSettings(**description["interface"]), Actor(layers, network["activation"], network["output"])


def settings_of(folder: Path) -> AdapterSettings:
    """Return the adapter's settings of the agent in a folder."""
    with refusing(f"{folder / DESCRIPTION} {_WRITTEN}"):
        return AdapterSettings(**describe(folder)["interface"])
