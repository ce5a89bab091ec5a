"""The settings of a training run, as plain data; imports neither torch nor stable-baselines3."""

import contextlib
import dataclasses
import itertools
import json
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.agents import sb3
from benchmarks.agents.adapter import AdapterSettings
from benchmarks.seeds import SPLITS
from fbl_gym import scenarios
from fbl_gym.model.arm import stretched_inertia
from fbl_gym.options import FilteredSteps, FourierReference, Reward
from fbl_gym.records.checks import check_choices, check_number, check_whole
from fbl_gym.records.record import Distribution, Record, build, choice, number, set_fields, whole
from fbl_gym.scenarios import Scenario
from fbl_gym.scenarios.class_families import BOX

ALGORITHMS = ("ppo", *sb3.ALGORITHMS)

# Motions to train on beside those of the scenarios: a slow one; moves with rests, in a part and in
# the whole of the boards' box; and moves faster than weak drives can follow.
MOTIONS = (
    FourierReference(amplitude=(0.8, 1.0), frequency=0.1, harmonics=3),
    FilteredSteps(period=1.7, bandwidth=4.0),
    FilteredSteps(*BOX, period=1.7, bandwidth=Distribution(uniform=(3.0, 5.5))),
    FilteredSteps(*BOX, period=1.0, bandwidth=Distribution(uniform=(4.0, 9.0))),
)

# Starts with these motions, so far off that the agent learns to come back.
START = {"initial_error": {"uniform": (-0.2, 0.2)}, "initial_velocity": {"uniform": (-1.0, 1.0)}}

# Ends of the factors by which drawn arms differ from a scenario's: of both links' mass, length and
# rotor, and of both torque limits.
FACTORS = np.repeat([(0.2, 5.0), (0.6, 5.0), (0.1, 1.5), (0.8, 2.0)], 2, axis=0)

SEEDS_PER_RUN = 1000  # episode seeds that each training seed has, one for each lane of a scenario
LEAST_LANES = 16  # fewest lanes of each of several scenarios: with fewer, Python's share of the time grows


@dataclass(frozen=True)
class TrainingSettings(Record):
    """The settings of a training run. Two runs with equal settings learn the same.

    Args:
        algorithm: one of `ALGORITHMS`.
        adapter: observations and actions of the agent.
        scenarios: for training, side by side, and for validation with other seeds.
        moves: number of `MOTIONS` that take turns with the scenarios' own motion: each arm in each
            scenario has one of them.
        arms: number of drawn arms, with drives of other strength, on which the agent trains in
            each scenario beside its own arm; only in those of a tier.
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
    moves: int = whole(0, high=len(MOTIONS))
    arms: int = whole(0, high=100)
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
            if self.arms and (scenarios.member(scenario.name) is None or scenario != scenarios.get(scenario.name)):
                raise ValueError(f"arms must be 0 for a scenario that is of no tier, got {self.arms}: {scenario.name}")
        check_hyperparameters(self.hyperparameters, most)
        if self.minutes is None and self.steps is None:
            set_fields(self, steps=self.hyperparameters["steps"])

    @property
    def practice(self) -> list[Scenario]:
        """Return the scenarios with the arms and motions to train on."""
        random = np.random.default_rng(self.seed)
        tasks = [*self.scenarios, *(_on_drawn_arm(task, random) for _ in range(self.arms) for task in self.scenarios)]
        if not self.moves:
            return tasks
        pairs = zip(tasks, itertools.cycle((None, *MOTIONS[: self.moves])), strict=False)
        return [task.replace(reference=motion or task.reference, **START) for task, motion in pairs]

    @property
    def lanes(self) -> int:
        """Return the number of lanes of each arm in each scenario.

        They share those of the hyperparameters; each has at least one, with PPO `LEAST_LANES`.
        """
        lanes, least = self.hyperparameters["lanes"], LEAST_LANES if self.algorithm in ("ppo", "sb3-ppo") else 1
        return max(lanes // (len(self.scenarios) * (1 + self.arms)), min(lanes, least))


def _on_drawn_arm(task: Scenario, random: np.random.Generator) -> Scenario:
    """Return a scenario of a tier with another arm and other torque limits.

    An arm is drawn again if its springs are too fast for the physics step.
    """
    arm = task.arm
    for _ in range(100):
        mass, length, rotor, strength = np.exp(random.uniform(*np.log(FACTORS.T))).reshape(4, 2)
        factors = zip(("m1", "m2", "L1", "L2"), (*mass, *length), strict=True)
        links = dataclasses.replace(arm, **{name: getattr(arm, name) * factor for name, factor in factors})
        rotor = rotor * arm.rotor * stretched_inertia(links) / stretched_inertia(arm)
        drawn = dataclasses.asdict(dataclasses.replace(links, rotor=tuple(rotor)))
        with contextlib.suppress(ValueError):
            other = scenarios.as_scenario({"base": task.name, "arm": drawn})
            if (limit := other.actuator.torque_limit) is None:
                return other
            drive = dataclasses.replace(other.actuator, torque_limit=tuple(strength * np.array(limit)))
            return other.replace(actuator=drive)
    raise ValueError(f"scenario must be one whose arm can be another one, got {task.name}")


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
    check_choices("hyperparameters", tuple(given), ("lanes", "steps", "arguments", "reward", "tuned"))
    check_whole("hyperparameters.lanes", given["lanes"], low=1, high=most_lanes)
    check_whole("hyperparameters.steps", given["steps"], low=1)
    if "reward" in given:
        build("hyperparameters.reward", given["reward"], Reward)
    check_number("hyperparameters.arguments.learning_rate", arguments["learning_rate"], above=0)


def shipped_hyperparameters(algorithm: str, action: str = "") -> dict[str, Any]:
    """Return the hyperparameters of an algorithm, or those for a kind of action if it has some."""
    shipped = json.loads(Path(__file__).with_name("hyperparameters.json").read_text())
    return shipped.get(f"{algorithm}-{action}", shipped[algorithm])
