"""Trained agents as policies: a deterministic actor in NumPy, read from plain data. Neither torch nor SB3 is needed."""

from __future__ import annotations

import csv
import hashlib
import importlib
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from benchmarks.rl.interface import SENSORS, AgentInterface, Body
from controllers.policy import Policy, State, TorqueLaw
from fbl_gym.arm import Array
from fbl_gym.checks import check_choice, unknown
from fbl_gym.interface import Interface

SHIPPED = Path(__file__).parent / "agents"
"""The agents that the package ships: a folder for each, and in it one for each training seed."""

ALGORITHMS = {
    "ppo": "stable_baselines3:PPO",
    "sac": "stable_baselines3:SAC",
    "td3": "stable_baselines3:TD3",
    "tqc": "sb3_contrib:TQC",
    "crossq": "sb3_contrib:CrossQ",
}

_SAVED = {
    "stable_baselines3.sac.policies": "stable_baselines3:SAC",
    "stable_baselines3.td3.policies": "stable_baselines3:TD3",  # DDPG's archives too: it is a TD3
    "sb3_contrib.tqc.policies": "sb3_contrib:TQC",
    "sb3_contrib.crossq.policies": "sb3_contrib:CrossQ",
    "sb3_contrib.ars.policies": "sb3_contrib:ARS",
    "sb3_contrib.common.recurrent.policies": "sb3_contrib:RecurrentPPO",
}
"""Which class loads an archive, by the module of its network."""

_SHARED = "stable_baselines3.common.policies"
"""The module of the network that PPO, A2C and TRPO share; their settings tell them apart."""

_ACTIVATIONS: dict[str, Callable[[Array], Array]] = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0)}
_BLOCK = 16
_OUTPUTS: dict[str, Callable[[Array], Array]] = {"clip": lambda x: np.clip(x, -1.0, 1.0), "tanh": np.tanh}


@dataclass(frozen=True, eq=False)
class Actor:
    """A multilayer perceptron from what an agent sees to its action in [-1, 1].

    Args:
        layers: a weight [out x in] and a bias [out] each.
        activation: behind every layer but the last: "tanh" or "relu".
        output: behind the last: "clip" or "tanh".
    """

    layers: tuple[tuple[Array, Array], ...]
    activation: str
    output: str

    def __post_init__(self) -> None:
        check_choice("activation", self.activation, _ACTIVATIONS)
        check_choice("output", self.output, _OUTPUTS)

    def __call__(self, x: Array) -> Array:
        """[n x in] -> [n x 2], in double precision; a lane has the same bits alone and in a batch."""
        # Linear algebra rounds by the size of its matrices, so all that it is given are blocks of one size.
        blocks = np.zeros((-(-len(x) // _BLOCK), _BLOCK, x.shape[-1]))
        blocks.reshape(-1, x.shape[-1])[: len(x)] = x
        *hidden, (weight, bias) = self.layers
        for w, b in hidden:
            blocks = _ACTIVATIONS[self.activation](blocks @ w.T + b)
        return _OUTPUTS[self.output](blocks @ weight.T + bias).reshape(-1, len(bias))[: len(x)]


@dataclass(frozen=True, eq=False)
class Agent(TorqueLaw):
    """An actor in its body, as a policy: it takes the environment's plain observation and gives any kind of action.

    Args:
        agent: what it sees and does.
        actor: its network.
        env: the very environment that an agent with context acts in, whose truth it is told; else None.
    """

    agent: AgentInterface
    actor: Actor
    env: Any = None

    needs: ClassVar[tuple[str, ...]] = SENSORS

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.agent.context and self.env is None:
            raise ValueError("an agent with context is told the truth, so it needs the environment, got its interface")

    @cached_property
    def body(self) -> Body:
        return Body(self.agent, self.interface)

    def initial(self, observation: Array) -> State:
        return self.body.initial(observation)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        told = self.body.told(self.env, len(observation))
        action = self.actor(self.body.see(observation, state, told))
        return self.body.torque(action, observation, state)


@dataclass(frozen=True)
class SavedAgent(TorqueLaw):
    """The agent that lies in a folder, as `fbl-gym train` writes it.

    Args:
        folder: with its `agent.json` and `weights.npz`.
        env: see `Agent`; `saved_agent` gives it to those that need it.
    """

    folder: str
    env: Any = None

    needs: ClassVar[tuple[str, ...]] = SENSORS

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.agent  # read now, so that a folder without an agent is an error here

    @cached_property
    def agent(self) -> Agent:
        return Agent(self.interface, *read(Path(self.folder)), self.env)

    @property
    def configuration(self) -> dict[str, str]:
        """What tells this agent from others, wherever its folder lies: a hash of its files."""
        content = b"".join((Path(self.folder) / name).read_bytes() for name in ("agent.json", "weights.npz"))
        return {"agent": hashlib.sha256(content).hexdigest()}

    def initial(self, observation: Array) -> State:
        return self.agent.initial(observation)

    def torque(self, observation: Array, state: State) -> tuple[Array, State]:
        return self.agent.torque(observation, state)


def write(folder: Path, actor: Actor, description: dict[str, Any]) -> None:
    """Write an agent: `agent.json` says what it is, `weights.npz` holds its actor in single precision.

    Args:
        folder: made if it isn't there.
        actor: its network.
        description: plain data; its entry `interface` holds the fields of the `AgentInterface`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {}
    for i, (weight, bias) in enumerate(actor.layers):
        arrays[f"weight_{i}"], arrays[f"bias_{i}"] = np.float32(weight), np.float32(bias)
    np.savez(folder / ".weights.npz", **arrays)
    (folder / ".weights.npz").replace(folder / "weights.npz")
    network = {"layers": len(actor.layers), "activation": actor.activation, "output": actor.output}
    text = json.dumps({**description, "network": network}, indent=1)
    (folder / ".agent.json").write_text(text + "\n")
    (folder / ".agent.json").replace(folder / "agent.json")


def describe(folder: Path) -> dict[str, Any]:
    """What the `agent.json` of a folder says."""
    path = folder / "agent.json"
    if not path.exists():
        raise ValueError(f"folder must hold an agent.json, as `fbl-gym train` writes it, got {str(folder)!r}")
    return json.loads(path.read_text())


def read(folder: Path) -> tuple[AgentInterface, Actor]:
    """The agent in a folder; nothing of it is executed."""
    description = describe(folder)
    network = description["network"]
    with np.load(folder / "weights.npz", allow_pickle=False) as file:
        layers = tuple(
            (file[f"weight_{i}"].astype(float), file[f"bias_{i}"].astype(float)) for i in range(network["layers"])
        )
    return AgentInterface(**description["interface"]), Actor(layers, network["activation"], network["output"])


def access_of(folder: Path) -> str:
    """What the agent in a folder is told: the truth, if it was trained with context."""
    return "privileged" if describe(folder)["interface"].get("context") else "nominal"


def saved_agent(env: Any, folder: str) -> SavedAgent:
    """The agent in a folder; of the environment it gets no more than the interface, unless it is told the truth.

    Args:
        env: the environment, single or batched, wrapped or not; or its `interface`.
        folder: see `SavedAgent`.
    """
    if isinstance(env, Interface):
        return SavedAgent(env, folder)
    told = access_of(Path(folder)) == "privileged"
    return SavedAgent(env.unwrapped.interface, folder, env.unwrapped if told else None)


def shipped() -> dict[str, tuple[int, ...]]:
    """The names of the shipped agents, each with its training seeds."""
    found = sorted(SHIPPED.glob("*/*/agent.json"))
    names = sorted({path.parent.parent.name for path in found})
    return {n: tuple(sorted(int(path.parent.name) for path in found if path.parent.parent.name == n)) for n in names}


def curves(name: str) -> dict[int, Array]:
    """The learning curves of a shipped agent: for each training seed [n x 3], steps, wall time [s], validation error [mrad]."""
    if name not in shipped():
        raise unknown("agent", name, shipped())
    found = {}
    for seed in shipped()[name]:
        with (SHIPPED / name / str(seed) / "curve.csv").open() as file:
            found[seed] = np.array([[float(x) for x in row] for row in list(csv.reader(file))[1:]])
    return found


def best_seed(name: str) -> int:
    """The training seed of a shipped agent with the smallest error on the validation seeds."""
    return min(shipped()[name], key=lambda seed: describe(SHIPPED / name / str(seed))["validation_mrad"])


def shipped_agent(name: str, env: Any, seed: int | None = None) -> SavedAgent:
    """A shipped agent by its name.

    Args:
        name: one of `shipped()`.
        env: the environment, or its interface; see `saved_agent`.
        seed: of its training; None: the best one, as the validation seeds have it.
    """
    if name not in shipped():
        raise unknown("agent", name, shipped())
    if seed is not None and seed not in shipped()[name]:
        raise unknown("training seed", seed, map(str, shipped()[name]))
    return saved_agent(env, str(SHIPPED / name / str(best_seed(name) if seed is None else seed)))


def _factory(name: str, summary: str, access: str = "nominal") -> Callable[..., SavedAgent]:
    # The registry gives the environment to a factory with privileged access, and its interface to any other.
    def honest(interface: Interface, seed: int | None = None) -> SavedAgent:
        return shipped_agent(name, interface, seed)

    def told(env: Any, seed: int | None = None) -> SavedAgent:
        return shipped_agent(name, env, seed)

    factory: Any = told if access == "privileged" else honest
    factory.__doc__, factory.kind, factory.access = summary, "learned", access
    return factory


ppo_torque = _factory("ppo-torque", "PPO on torques, memoryless; trained on everything-2")
ppo_acceleration = _factory(
    "ppo-acceleration", "PPO on accelerations through the nominal mapping; trained on everything-2"
)
ppo_residual = _factory("ppo-residual", "PPO on top of cascade-flm; trained on everything-2")
ppo_memory = _factory("ppo-memory", "PPO on torques that sees its last steps and actions; trained on everything-2")
ppo_context = _factory(
    "ppo-context", "PPO on torques that is told the true parameters; trained on everything-2", "privileged"
)
sac = _factory("sac", "SAC on torques; trained on everything-2")
td3 = _factory("td3", "TD3 on torques; trained on everything-2")
tqc = _factory("tqc", "TQC on torques; trained on everything-2")
crossq = _factory("crossq", "CrossQ on torques; trained on everything-2")


def find_class(algorithm: str) -> Any:
    """SB3's class of an algorithm."""
    return _imported(algorithm, ALGORITHMS[check_choice("algorithm", algorithm, ALGORITHMS)])


def _imported(what: str, place: str) -> Any:
    module, name = place.split(":")
    try:
        return getattr(importlib.import_module(module), name)
    except ModuleNotFoundError as problem:
        raise ValueError(f"{what} needs {module}, which is not installed: pip install 'fbl-gym[rl]'") from problem


def _class_of(path: str | Path) -> Any:
    """SB3's class of the algorithm that wrote an archive; nothing of it is executed."""
    try:
        with zipfile.ZipFile(path) as archive:
            data = json.loads(archive.read("data"))
        module = data["policy_class"]["__module__"]
    except (zipfile.BadZipFile, KeyError, TypeError, ValueError) as problem:
        raise ValueError(f"{path} must be an archive that stable-baselines3's save wrote ({problem})") from None
    if module == _SHARED:
        algorithms = {"clip_range": "stable_baselines3:PPO", "cg_max_steps": "sb3_contrib:TRPO"}
        place = next((found for key, found in algorithms.items() if key in data), "stable_baselines3:A2C")
    elif module in _SAVED:
        place = _SAVED[module]
    elif "clip_range" in data and not module.startswith("sb3_contrib."):
        place = "stable_baselines3:PPO"  # with a network of somebody's own
    else:
        known = ", ".join(sorted({found.partition(":")[2] for found in _SAVED.values()} | {"PPO", "A2C", "TRPO"}))
        raise ValueError(f"{path} must hold a model of one of {known}, got one whose network is of {module}")
    return _imported(str(path), place)


def load_zip(path: str | Path, interface: Interface, trust: bool = False) -> Policy:
    """A stranger's SB3 model as a policy; it was trained on the environment's own observations and actions.

    Args:
        path: the .zip that SB3's `save` wrote.
        interface: of the environment that it is to act in.
        trust: a .zip of SB3 holds pickled code, which runs when it is loaded; True says that you trust where it came from.
    """
    if not trust:
        raise ValueError(
            f"loading {str(path)!r} runs the code in it: give trust=True if you trust its source, got {trust!r}"
        )
    model = _class_of(path).load(path, device="cpu")
    _check_spaces(model, interface)
    return model


def _check_spaces(model: Any, interface: Interface) -> None:
    """An error, unless a model was trained on the observations and actions of an interface, whatever their precision."""
    right = {
        "observation_space": "observations as the environment gives them, without a wrapper such as ErrorCoordinates",
        "action_space": f'action="{interface.action}"',
    }
    for what, trained in right.items():
        theirs, ours = getattr(model, what), getattr(interface, what)
        if theirs.shape != ours.shape:
            raise ValueError(f"the model's {what} must have the environment's shape {ours.shape}, got {theirs.shape}")
        if not all(np.allclose(getattr(theirs, end), getattr(ours, end), rtol=1e-5) for end in ("low", "high")):
            raise ValueError(
                f"the model's {what} must have the environment's bounds, {_bounds(ours)}, got {_bounds(theirs)}: "
                f"train it with {trained}"
            )


def _bounds(space: Any) -> str:
    """The bounds of a box's entries, each pair once, such as "-2000 to 2000, -800 to 800"."""
    ends = [f"{low:.6g} to {high:.6g}" for low, high in zip(space.low.ravel(), space.high.ravel(), strict=True)]
    return ", ".join(dict.fromkeys(ends))
