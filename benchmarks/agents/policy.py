"""The shipped agents by name and training seed, and their factories."""

import math
from collections.abc import Callable
from pathlib import Path

from benchmarks.agents.agent import Agent, describe, files, read, settings_of
from fbl_gym.interface import Interface
from fbl_gym.records.checks import unknown

#: Folder of the shipped agents: NAME/TRAINING_SEED, or NAME/CLASS/TRAINING_SEED for each class.
SHIPPED = Path(__file__).parent / "shipped"


def shipped() -> dict[str, tuple[int, ...]]:
    """Return the training seeds of each shipped agent, by name."""
    seeds: dict[str, set[int]] = {}
    for path in SHIPPED.rglob("agent.json"):
        seeds.setdefault(path.relative_to(SHIPPED).parts[0], set()).add(int(path.parent.name))
    return {name: tuple(sorted(seeds[name])) for name in sorted(seeds)}


def folders(name: str, seed: int) -> list[Path]:
    """Return the folders of a shipped agent's training seed: one, or one for each class."""
    return sorted(path.parent for path in (SHIPPED / name).rglob(f"{seed}/agent.json"))


def best_seed(name: str) -> int:
    """Return the training seed of a shipped agent with the smallest validation error.

    Of an agent with classes, it is the geometric mean over these.
    """
    errors = {k: [describe(each)["validation_mrad"] for each in folders(name, k)] for k in shipped()[name]}
    return min(errors, key=lambda seed: math.prod(errors[seed]))


def folder_factory(folder: Path) -> Callable[..., Agent]:
    """Return the factory of the agent in a folder."""
    return _declare(lambda interface: Agent(interface, *read(folder)), folder, files(folder))


def _factory(name: str, summary: str) -> Callable[..., Agent]:
    """Return the factory of a shipped agent; without a seed, of that which validated best."""
    known = {seed: {path.parent.name: path for path in folders(name, seed)} for seed in shipped()[name]}

    def factory(interface: Interface, seed: int | None = None) -> Agent:
        if seed is not None and seed not in known:
            raise unknown("training seed", seed, map(str, known))
        of_class = known[best_seed(name) if seed is None else seed]
        folder = of_class.get(name) or of_class.get(interface.robot_class)
        if folder is None:
            given = f"a robot like {interface.robot_class}"
            raise ValueError(f"not applicable: {name} was trained for {', '.join(of_class)}, got {given}")
        return Agent(interface, *read(folder))

    factory.__doc__ = summary
    every = [path for of_class in known.values() for path in of_class.values()]
    return _declare(factory, every[0], [path for folder in every for path in files(folder)])


def _declare(factory: Callable[..., Agent], folder: Path, data_files: list[Path]) -> Callable[..., Agent]:
    """Return a factory with what agents of the settings in a folder declare, and their files."""
    needs, preview, uses = (getattr(settings_of(folder), name) for name in ("sensors", "preview", "uses"))
    vars(factory).update(kind="learned", needs=needs, preview=preview, uses=uses, data_files=data_files)
    return factory


ppo = _factory("ppo", "PPO on torques, without a law; trained for each of the three classes")
ppo_blend = _factory("ppo-blend", "PPO that mixes a careful and a fast setting of LQG; trained for all three classes")
sac = _factory("sac", "SAC on torques; trained on everything-2")
td3 = _factory("td3", "TD3 on torques; trained on everything-2")
tqc = _factory("tqc", "TQC on torques; trained on everything-2")
crossq = _factory("crossq", "CrossQ on torques; trained on everything-2")
