"""The settings of a training run, as plain data; imports neither torch nor stable-baselines3."""

import itertools
import json
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.agents import sb3
from benchmarks.agents.adapter import AdapterSettings, check_flag
from benchmarks.seeds import SPLITS
from fbl_gym import scenarios
from fbl_gym.options import FilteredSteps, FourierReference, Reward
from fbl_gym.records.checks import check_number, check_whole
from fbl_gym.records.record import Record, build, choice, declared, number, set_fields, whole
from fbl_gym.scenarios import Scenario

ALGORITHMS = ("ppo", *sb3.ALGORITHMS)

# Motions to train on beside those of the scenarios: a slow one, and moves with rests.
MOTIONS = (FourierReference(amplitude=(0.8, 1.0), frequency=0.1, harmonics=3), FilteredSteps(period=1.7, bandwidth=4.0))

# Starts with these motions, so far off that the agent learns to come back.
START = {"initial_error": {"uniform": (-0.2, 0.2)}, "initial_velocity": {"uniform": (-1.0, 1.0)}}

SEEDS_PER_RUN = 1000  # episode seeds that each training seed has, one for each lane of a scenario
LEAST_LANES = 16  # fewest lanes of each of several scenarios: with fewer, Python's share of the time grows


@dataclass(frozen=True)
class TrainingSettings(Record):
    """The settings of a training run. Two runs with equal settings learn the same.

    Args:
        algorithm: one of `ALGORITHMS`.
        adapter: observations and actions of the agent.
        scenarios: for training, side by side, and for validation with other seeds.
        moves: True if the agent trains on the scenarios, in turn, with their own motion and with
            those of `MOTIONS`.
        seed: of the training.
        steps: of all lanes together; None: those of the hyperparameters, if `minutes` is None too.
        minutes: processor time of the training, without validations; such a run does not repeat
            exactly. None: the run ends after `steps`.
        hyperparameters: `lanes`, `steps` and `arguments` of SB3's class, and `reward`, if it is not
            the default one; empty: the shipped ones.
    """

    algorithm: str = choice(MISSING, ALGORITHMS)
    adapter: AdapterSettings = field(default_factory=AdapterSettings)
    scenarios: tuple[Scenario, ...] = field(default_factory=lambda: (scenarios.get("everything-2"),))
    moves: bool = declared(False, check_flag, "True or False")
    seed: int = whole(0)
    steps: int | None = whole(None, low=1)
    minutes: float | None = number(None, unit="min", above=0)
    hyperparameters: dict[str, Any] = field(default_factory=dict)

    def validate(self) -> None:
        """Fill in the shipped hyperparameters and the number of steps."""
        most = SEEDS_PER_RUN * len(self.scenarios)  # more lanes would have the seeds of the next run
        if not self.hyperparameters:
            shipped = shipped_hyperparameters(self.algorithm, self.adapter.action)
            set_fields(self, hyperparameters={**shipped, "lanes": min(shipped["lanes"], most)})
        training_seeds(self.seed)
        for scenario in self.scenarios:
            if reason := scenarios.held_out_reason(scenario):
                raise ValueError(f"scenario must be one to train on, such as practice, got {scenario.name}: {reason}")
        check_hyperparameters(self.hyperparameters, most)
        if self.minutes is None and self.steps is None:
            set_fields(self, steps=self.hyperparameters["steps"])

    @property
    def practice(self) -> list[Scenario]:
        """Return the scenarios with the motions to train on."""
        if not self.moves:
            return [*self.scenarios]
        pairs = zip(self.scenarios, itertools.cycle((None, *MOTIONS)), strict=False)
        return [task.replace(reference=motion or task.reference, **START) for task, motion in pairs]

    @property
    def lanes(self) -> int:
        """Return the number of lanes of each scenario; of many scenarios each has `LEAST_LANES`."""
        lanes = self.hyperparameters["lanes"]
        return max(lanes // len(self.scenarios), min(lanes, LEAST_LANES))


def training_seeds(seed: int) -> range:
    """Return the episode seeds of a training seed."""
    if not 0 <= seed <= (last := len(SPLITS["training"]) // SEEDS_PER_RUN - 1):
        raise ValueError(f"seed must be 0 to {last}, since each has {SEEDS_PER_RUN} training seeds, got {seed}")
    return SPLITS["training"][seed * SEEDS_PER_RUN : (seed + 1) * SEEDS_PER_RUN]


def check_hyperparameters(given: Any, most_lanes: int) -> None:
    """Raise an error unless a training run can use these hyperparameters."""
    arguments = given.get("arguments") if isinstance(given, Mapping) and {"lanes", "steps"} <= given.keys() else None
    if not isinstance(arguments, Mapping) or "learning_rate" not in arguments:
        raise ValueError(f"hyperparameters must have lanes, steps and arguments with a learning_rate, got {given!r}")
    check_whole("hyperparameters.lanes", given["lanes"], low=1, high=most_lanes)
    check_whole("hyperparameters.steps", given["steps"], low=1)
    if "reward" in given:
        build("hyperparameters.reward", given["reward"], Reward)
    check_number("hyperparameters.arguments.learning_rate", arguments["learning_rate"], above=0)


def shipped_hyperparameters(algorithm: str, action: str = "") -> dict[str, Any]:
    """Return the hyperparameters of an algorithm, or those for a kind of action if it has some."""
    shipped = json.loads(Path(__file__).with_name("hyperparameters.json").read_text())
    return shipped.get(f"{algorithm}-{action}", shipped[algorithm])
