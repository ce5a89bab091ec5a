"""A cell as data: one policy on one scenario over a batch of seeds, and its key."""

import contextlib
import functools
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata
from typing import Any

from benchmarks.policies.key import data_digest
from benchmarks.policies.spec import PolicySpec, resolve
from fbl_gym import Scenario
from fbl_gym.records.record import set_fields
from fbl_gym.scenarios import as_scenario


@dataclass(frozen=True)
class Cell:
    """One policy on one scenario over a batch of seeds.

    Args:
        policy: its specification, or the text that names it.
        scenario: a Scenario, its name, or the plain data that makes one.
        seeds: every policy meets the same ones, so comparisons are paired.
    """

    policy: PolicySpec
    scenario: Scenario
    seeds: tuple[int, ...]

    def __post_init__(self) -> None:
        set_fields(self, policy=resolve(self.policy), scenario=as_scenario(self.scenario), seeds=tuple(self.seeds))

    @property
    def id(self) -> str:
        """Policy and scenario, such as "cascade-flm/mass-error-2"."""
        return f"{self.policy.name}/{self.scenario.name}"

    @cached_property
    def identity(self) -> dict[str, Any]:
        """All that the cell's numbers depend on, as plain data."""
        robot = self.policy.parsed.robot_of(self.scenario.robot_class)
        return self.policy.identity | {
            "tuned": self.policy.tuned.get(robot, {}),
            "scenario": plain_options(self.scenario, "description"),
            "seeds": list(self.seeds),
            "packages": versions(self.packages),
        }

    @property
    def packages(self) -> tuple[str, ...]:
        """Names of the packages of extras that compute its numbers."""
        return (*self.policy.packages, *(("mujoco",) if self.scenario.plant is not None else ()))

    @cached_property
    def key(self) -> str:
        """Hash of the cell's identity, 20 hexadecimal digits."""
        return data_digest(self.identity)[:20]


@functools.cache
def versions(packages: tuple[str, ...]) -> dict[str, str]:
    """Return the version of each package, or "absent"."""
    known = dict.fromkeys(packages, "absent")
    for package in packages:
        with contextlib.suppress(metadata.PackageNotFoundError):
            known[package] = metadata.version(package)
    return known


def plain_options(scenario: Scenario, *without: str) -> dict[str, Any]:
    """Return a scenario's options as plain data, without some of them."""
    return {name: value for name, value in scenario.to_dict().items() if name not in without}
