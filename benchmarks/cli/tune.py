"""The command `fbl-gym tune`."""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.cli.common import add, add_margins, add_option, command_line, count, refuse_judged
from benchmarks.policies.isolation import Failed, run_parallel
from benchmarks.policies.spec import resolve
from benchmarks.run.expansion import distinguish, expand
from benchmarks.text import say
from benchmarks.tuning import search
from benchmarks.tuning.search import Task
from controllers import name as naming
from fbl_gym import Scenario
from fbl_gym.scenarios.classes import CLASSES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add(parser, "policies")
    add_option(parser, "--trials", count, 10, "N", "trials for each gain, those of earlier runs counted")
    add_option(parser, "--seeds", count, 16, "N", "tuning seeds of each scenario")
    add_option(parser, "--candidates", count, 10, "N", "number of best trials to judge once more")
    add_option(parser, "--fresh-seeds", count, 128, "N", "tuning seeds to judge on, of each scenario")
    tasks = "scenarios of trials and judging: names, families, .toml files (the class's practice)"
    parser.add_argument("--scenarios", nargs="+", action="extend", metavar="S", help=tasks)
    practice = "tune on the practice of a class (servo)"
    parser.add_argument("--class", dest="robot", choices=tuple(CLASSES), default="servo", help=practice)
    add_margins(parser, "phase margin below which gains pay", "delay margin below which gains pay")
    shared = "database of the studies, as for Optuna, which processes and machines may share"
    add_option(parser, "--storage", str, search.STORAGE, "URL", shared)
    add(parser, "--workers", default=1, help="processes, a policy each (1)")
    target = parser.add_mutually_exclusive_group()
    out = "folder for the gains, which POLICY@DIR then names (results/gains)"
    target.add_argument("--out", type=Path, default=Path("results/gains"), metavar="DIR", help=out)
    ship = "write the gains of built-in policies into controllers/tuned/CLASS, for POLICY@tuned and POLICY@CLASS"
    target.add_argument("--ship", action="store_true", help=ship)


def run(arguments: argparse.Namespace) -> int:
    tried, fresh = search.seeds(arguments.seeds, arguments.fresh_seeds)
    pairs = []
    for policy in map(resolve, dict.fromkeys(arguments.policies)):
        if arguments.ship and (policy.external or policy.parsed.gains or policy.parsed.tuned):
            raise ValueError(f"--ship is for the laws that fbl-gym comes with, got {policy.name!r}: give --out instead")
        task, judging = (
            Task(policy, _scenarios(arguments, usual), numbers, (arguments.least_phase, arguments.least_delay))
            for usual, numbers in zip(search.scenarios_of(arguments.robot), (tried, fresh), strict=True)
        )
        search.open_study(task, arguments.storage)  # here, since no two processes may create a database at once
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
    starts = task.shipped(arguments.robot).values()
    study = search.tune(task, arguments.storage, starts, arguments.trials * len(task.ranges))
    best = search.summary(task, study, judging, search.judge(judging, study, arguments.candidates), command)
    path = search.write_gains(best, naming.TUNED / arguments.robot if arguments.ship else arguments.out)
    verdict, defaults = best["judged"]["best"], best["judged"]["defaults"]
    numbers = {gain: ",".join(f"{x:g}" for x in np.ravel(value)) for gain, value in best["gains"].items()}
    gains = " ".join(f"{gain}={text}" for gain, text in numbers.items()) or "the default gains are best"
    at_edge = search.at_edge(best).items()
    ends = [f"\n  {gain} ends at the edge of its range, {low:g} to {high:g}" for gain, (low, high) in at_edge]
    return (
        f"{name}: {gains}\n"
        f"  objective {verdict['objective']:.3f}, diverged {verdict['diverged_pct']:.2g} %; "
        f"of the default gains {defaults['objective']:.3f}, {defaults['diverged_pct']:.2g} %{''.join(ends)}\n"
        f"  {path}: use them as {name}@{arguments.robot if arguments.ship else arguments.out}"
    )
