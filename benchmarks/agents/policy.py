"""The shipped agents by name and training seed, and their factories."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from benchmarks.agents.agent import Agent, describe, files, read, settings_of
from fbl_gym.interface import Interface
from fbl_gym.records.checks import unknown

SHIPPED = Path(__file__).parent / "shipped"
"""Folder of the shipped agents: shipped/NAME/TRAINING_SEED."""


def shipped() -> dict[str, tuple[int, ...]]:
    """Return the training seeds of each shipped agent, by name."""
    seeds: dict[str, list[int]] = {}
    for path in sorted(SHIPPED.glob("*/*/agent.json")):
        seeds.setdefault(path.parent.parent.name, []).append(int(path.parent.name))
    return {name: tuple(sorted(seeds[name])) for name in sorted(seeds)}


def best_seed(name: str) -> int:
    """Return the training seed of a shipped agent with the smallest validation error."""
    return min(shipped()[name], key=lambda seed: describe(SHIPPED / name / str(seed))["validation_mrad"])


def folder_factory(folder: Path) -> Callable[..., Agent]:
    """Return the factory of the agent in a folder."""

    def factory(interface: Interface) -> Agent:
        return Agent(interface, *read(folder))

    return _declare(factory, folder, files(folder))


def _factory(name: str, summary: str) -> Callable[..., Agent]:
    """Return the factory of a shipped agent; without a seed, of that which validated best."""
    folders = {seed: SHIPPED / name / str(seed) for seed in shipped()[name]}

    def factory(interface: Interface, seed: int | None = None) -> Agent:
        if seed is not None and seed not in folders:
            raise unknown("training seed", seed, map(str, folders))
        return Agent(interface, *read(folders[best_seed(name) if seed is None else seed]))

    factory.__doc__ = summary
    return _declare(factory, folders[0], [path for folder in folders.values() for path in files(folder)])


def _declare(factory: Callable[..., Agent], folder: Path, data_files: list[Path]) -> Callable[..., Agent]:
    """Return a factory with what agents of the settings in a folder declare, and their files."""
    settings = settings_of(folder)
    declared = {"kind": "learned", "needs": settings.sensors, "preview": settings.preview, "uses": settings.uses}
    vars(factory).update(declared, data_files=data_files)
    return factory


ppo_torque = _factory("ppo-torque", "PPO on torques, without memory; trained on everything-2")
ppo_blend = _factory("ppo-blend", "PPO that mixes a careful and a fast setting of LQG; trained for all three classes")
ppo_memory = _factory("ppo-memory", "PPO on torques that observes its last steps and actions; trained on everything-2")
sac = _factory("sac", "SAC on torques; trained on everything-2")
td3 = _factory("td3", "TD3 on torques; trained on everything-2")
tqc = _factory("tqc", "TQC on torques; trained on everything-2")
crossq = _factory("crossq", "CrossQ on torques; trained on everything-2")
