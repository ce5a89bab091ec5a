"""The command `fbl-gym tune`."""

import argparse
from collections.abc import Sequence
from functools import partial

import numpy as np

from benchmarks.cli.common import command_line
from benchmarks.policies.isolation import Failed, run_parallel
from benchmarks.policies.spec import resolve
from benchmarks.run.expansion import distinguish, expand
from benchmarks.text import say
from benchmarks.tuning import search
from controllers import name as naming
from fbl_gym import Scenario, scenarios


def run(arguments: argparse.Namespace) -> int:
    if arguments.robot and arguments.scenarios and not arguments.ship:
        raise ValueError(f"--class must be left out with --scenarios, got {arguments.robot!r}")
    arguments.robot = arguments.robot or "servo"
    tried, fresh = search.seeds(arguments.seeds, arguments.fresh_seeds)
    pairs = []
    for policy in map(resolve, dict.fromkeys(arguments.policies)):
        if arguments.ship and (policy.external or policy.parsed.gains or policy.parsed.tuned):
            raise ValueError(f"--ship is for the laws that fbl-gym comes with, got {policy.name!r}: give --out instead")
        if policy.parsed.tuned:
            raise ValueError(f"policy must be a law without tuned gains, got {policy.name!r}")
        task, judging = (
            search.Task(policy, _scenarios(arguments, usual), numbers, (arguments.least_phase, arguments.least_delay))
            for usual, numbers in zip(search.scenarios_of(arguments.robot), (tried, fresh), strict=True)
        )
        if fixed := task.ranges.keys() & policy.parsed.given_gains.keys():
            raise ValueError(f"{min(fixed)} of {policy.name} would be tuned: leave out its value")
        search.open_study(task, arguments.storage)  # here, since no two processes may create a database at once
        pairs.append((task, judging))
    work = partial(tune_one, arguments, command_line())
    for _, answer in run_parallel(work, pairs, min(arguments.workers, len(pairs))):
        if isinstance(answer, Failed):
            raise answer
        say(answer)
    return 0


def _scenarios(arguments: argparse.Namespace, usual: Sequence[str]) -> tuple[Scenario, ...]:
    """Return the scenarios that the arguments name, or the usual ones; refuse those of judging."""
    tasks = distinguish(expand(arguments.scenarios or usual))
    for task in tasks:
        if reason := scenarios.held_out_reason(task):
            raise ValueError(f"{task.name} is for judging alone: {reason}; change that, or leave out --scenarios")
    return tasks


def tune_one(arguments: argparse.Namespace, command: str, tasks: tuple[search.Task, search.Task]) -> str:
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
