"""The command `fbl-gym tune`."""

import argparse
import dataclasses
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.cli.common import add_policies, command_line, count, refuse_judged
from benchmarks.policies.isolation import Failed, run_parallel
from benchmarks.policies.spec import resolve
from benchmarks.run.suite import distinguish, expand
from benchmarks.text import say
from benchmarks.tuning.search import (
    STORAGE,
    Task,
    at_edge,
    judge,
    open_study,
    scenarios_of,
    seeds,
    summary,
    tune,
    write_gains,
)
from controllers import registry
from fbl_gym import Scenario
from fbl_gym.scenarios.classes import CLASSES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_policies(parser)
    parser.add_argument(
        "--trials", type=count, default=10, metavar="N", help="trials for each gain, those of earlier runs counted (10)"
    )
    parser.add_argument("--seeds", type=count, default=16, metavar="N", help="tuning seeds of each scenario (16)")
    parser.add_argument(
        "--candidates", type=count, default=10, metavar="N", help="number of best trials to judge once more (10)"
    )
    parser.add_argument(
        "--fresh-seeds", type=count, default=128, metavar="N", help="tuning seeds to judge on, of each scenario (128)"
    )
    parser.add_argument(
        "--scenarios", nargs="+", action="extend", metavar="S",
        help="scenarios of trials and judging: names, families, .toml files (the class's practice)",
    )  # fmt: skip
    parser.add_argument(
        "--class", dest="robot", choices=tuple(CLASSES), default="servo", help="tune on the practice of a class (servo)"
    )
    parser.add_argument(
        "--storage", default=STORAGE, metavar="URL",
        help=f"database of the studies, as for Optuna, which processes and machines may share ({STORAGE})",
    )  # fmt: skip
    parser.add_argument("--workers", type=count, default=1, metavar="N", help="processes, a policy each (1)")
    target = parser.add_mutually_exclusive_group()
    target.add_argument(
        "--out", type=Path, default=Path("results/gains"), metavar="DIR",
        help="folder for the gains, which POLICY@DIR then names (results/gains)",
    )  # fmt: skip
    target.add_argument(
        "--ship",
        action="store_true",
        help="write the gains of built-in policies into controllers/tuned/CLASS, for POLICY@tuned and POLICY@CLASS",
    )


def run(arguments: argparse.Namespace) -> int:
    tried, fresh = seeds(arguments.seeds, arguments.fresh_seeds)
    pairs = []
    for policy in map(resolve, dict.fromkeys(arguments.policies)):
        if arguments.ship and (policy.external or policy.parsed.gains or policy.parsed.tuned):
            raise ValueError(f"--ship is for the laws that fbl-gym comes with, got {policy.name!r}: give --out instead")
        task, judging = (
            Task(policy, _scenarios(arguments, usual), numbers)
            for usual, numbers in zip(scenarios_of(arguments.robot), (tried, fresh), strict=True)
        )
        open_study(task, arguments.storage)  # here, since no two processes may create a database at once
        pairs.append((task, judging))
    work = partial(tune_one, arguments, command_line())
    for _, answer in run_parallel(work, pairs, min(arguments.workers, len(pairs))):
        if isinstance(answer, Failed):
            raise answer
        say(answer)
    return 0


def _scenarios(arguments: argparse.Namespace, usual: Sequence[str]) -> tuple[Scenario, ...]:
    """Return the scenarios that the arguments name, or the usual ones."""
    tasks = distinguish(expand(arguments.scenarios or usual))
    for task in tasks:
        refuse_judged(task)
    return tasks


def tune_one(arguments: argparse.Namespace, command: str, tasks: tuple[Task, Task]) -> str:
    """Tune one policy, write its gains, and return the verdict in words."""
    task, judging = tasks
    name = task.policy.name
    study = tune(task, arguments.trials * len(task.ranges), arguments.storage)
    best = summary(task, study, judging, judge(judging, study, arguments.candidates), command)
    best["arms"] = [dataclasses.asdict(arm) for arm in dict.fromkeys(scenario.arm for scenario in task.scenarios)]
    path = write_gains(best, registry.TUNED / arguments.robot if arguments.ship else arguments.out)
    verdict, defaults = best["judged"]["best"], best["judged"]["defaults"]
    numbers = {gain: ",".join(f"{x:g}" for x in np.ravel(value)) for gain, value in best["gains"].items()}
    gains = " ".join(f"{gain}={text}" for gain, text in numbers.items()) or "the default gains are best"
    edges = [
        f"\n  {gain} ends at the edge of its range, {ends[0]:g} to {ends[1]:g}" for gain, ends in at_edge(best).items()
    ]
    return (
        f"{name}: {gains}\n"
        f"  objective {verdict['objective']:.3f}, diverged {verdict['diverged_pct']:.2g} %; "
        f"of the default gains {defaults['objective']:.3f}, {defaults['diverged_pct']:.2g} %{''.join(edges)}\n"
        f"  {path}: use them as {name}@{arguments.robot if arguments.ship else arguments.out}"
    )
