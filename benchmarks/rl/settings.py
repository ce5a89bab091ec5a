"""What a training run is, as plain data and on the command line. Light to import: neither torch nor SB3."""

from __future__ import annotations

import argparse
import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.rl.interface import ACTIONS, AgentInterface
from benchmarks.rl.policy import ALGORITHMS
from fbl_gym import scenarios
from fbl_gym.checks import check_choice, check_number, check_whole
from fbl_gym.records import set_fields
from fbl_gym.scenarios import Scenario
from fbl_gym.uncertainty import ParameterError


@dataclass(frozen=True)
class Settings:
    """What a run is. Two runs of equal settings learn the same.

    Args:
        algorithm: one of `ALGORITHMS`.
        interface: what the agent sees and does.
        scenario: the distribution that it is trained on, and validated on with other seeds.
        seed: of the training.
        steps: of all lanes together; None: as many as go into `minutes`.
        minutes: wall time instead; a run by the clock cannot be repeated exactly.
        hyperparameters: with `lanes`, `steps` and the `arguments` of SB3's class; empty: the package's own.
    """

    algorithm: str
    interface: AgentInterface = field(default_factory=AgentInterface)
    scenario: Scenario = field(default_factory=lambda: scenarios.get("everything-2"))
    seed: int = 0
    steps: int | None = None
    minutes: float | None = None
    hyperparameters: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_choice("algorithm", self.algorithm, ALGORITHMS)
        check_whole("seed", self.seed)
        if not self.hyperparameters:
            set_fields(self, hyperparameters=shipped_hyperparameters(self.algorithm))
        if self.minutes is not None:
            check_number("minutes", self.minutes, above=0)
        elif self.steps is None:
            set_fields(self, steps=self.hyperparameters["steps"])
        if self.steps is not None:
            check_whole("steps", self.steps, low=1)


def shipped_hyperparameters(algorithm: str) -> dict[str, Any]:
    """What the package's `hyperparameters.json` says of an algorithm."""
    return json.loads(Path(__file__).with_name("hyperparameters.json").read_text())[algorithm]


def at_radius(scenario: Scenario, radius: float) -> Scenario:
    """The scenario with another radius of the parameters' error; itself, if it has that one."""
    before = scenario.parameter_error or ParameterError()
    error = dataclasses.replace(before, radius=radius)
    if error == before:
        return scenario
    return scenario.replace(parameter_error=error, name=f"{scenario.name}, radius {radius:g}")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `fbl-gym train`."""
    parser.add_argument(
        "algorithm", choices=tuple(ALGORITHMS), help="the algorithm of stable-baselines3 or sb3-contrib"
    )
    parser.add_argument("--interface", choices=ACTIONS, default="torque", help="what the agent's actions mean (torque)")
    parser.add_argument("--history", type=int, default=0, metavar="N", help="earlier steps that the agent sees too (0)")
    parser.add_argument(
        "--context", action="store_true", help="the agent is told the true parameters (privileged access)"
    )
    parser.add_argument("--scenario", default="everything-2", metavar="S", help="to train on (everything-2)")
    parser.add_argument("--radius", type=float, metavar="R", help="of the parameters' error, instead of the scenario's")
    parser.add_argument("--seed", type=int, default=0, metavar="K", help="of the training (0)")
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--steps", type=int, metavar="N", help="of all arms together (as the hyper-parameters say)")
    length.add_argument("--minutes", type=float, metavar="M", help="wall time instead of steps")
    parser.add_argument("--hyperparameters", type=Path, metavar="FILE", help="JSON, instead of the package's own")
    parser.add_argument("--threads", type=int, default=1, metavar="N", help="of torch (1)")
    parser.add_argument("--wandb", metavar="PROJECT", help="report to this project of Weights & Biases too")
    parser.add_argument("--out", type=Path, metavar="DIR", help="of the run (runs/ALGORITHM-INTERFACE-SEED)")


def from_arguments(arguments: argparse.Namespace) -> Settings:
    """What the arguments of `fbl-gym train` mean."""
    scenario = scenarios.get(arguments.scenario)
    if arguments.radius is not None:
        scenario = at_radius(scenario, arguments.radius)
    own: dict[str, Any] = {}
    if arguments.hyperparameters is not None:
        own = json.loads(arguments.hyperparameters.read_text())[arguments.algorithm]
    return Settings(
        algorithm=arguments.algorithm,
        interface=AgentInterface(arguments.interface, history=arguments.history, context=arguments.context),
        scenario=scenario,
        seed=arguments.seed,
        steps=arguments.steps,
        minutes=arguments.minutes,
        hyperparameters=own,
    )
