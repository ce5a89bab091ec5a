"""`fbl-gym recommend`."""

import argparse
import importlib
from collections.abc import Sequence
from functools import partial

import numpy as np
from rich.progress import Progress

from benchmarks.cli.common import RUN, add, add_margins, add_option, command_line, episodes, results_by_id, trust
from benchmarks.report.terminal import Screen, table
from benchmarks.studies import recommend
from benchmarks.studies.recommend import RULE, Likeness, Recommendation
from benchmarks.tuning.brief import tune_briefly
from fbl_gym.records.checks import check_whole
from fbl_gym.scenarios import Scenario, as_scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    arm = "a scenario with your arm: a name or a TOML file (servo-nominal)"
    parser.add_argument("scenario", nargs="?", default="servo-nominal", metavar="SCENARIO", help=arm)
    candidates = "to choose from (the laws, with tuned gains where there are some, and the agents)"
    parser.add_argument("--policies", nargs="+", metavar="POLICY", help=candidates)
    meaning = "trials of each of the best laws in each of three rounds, into results/gains/SCENARIO; 0: none"
    add_option(parser, "--trials", int, 20, "N", meaning)
    add_margins(parser, "least phase margin of a safe policy", "least delay margin of a safe policy")
    add_option(parser, "--seeds", episodes, 16, "N", "test seeds 0 to N-1")
    add(parser, *RUN)


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit status: 1 if no policy is safe."""
    if arguments.seeds < 2:
        raise ValueError(f"--seeds must be at least 2 for an interval, got {arguments.seeds}")
    trials = check_whole("--trials", arguments.trials, high=10_000)
    trust(arguments)
    if trials:
        importlib.import_module("optuna")  # of the extra `analysis`: now, not after minutes of work
    base, run_cells = as_scenario(arguments.scenario), partial(results_by_id, arguments=arguments)
    likeness = Likeness.of(base)
    policies = arguments.policies or recommend.candidates(tuple(dict.fromkeys((*likeness.classes, base.robot_class))))
    Screen().say(likeness.text)
    bounds = arguments.least_phase, arguments.least_delay
    tune = partial(_tune, base, trials, arguments.workers, bounds) if trials else None
    result = recommend.recommend(base, policies, arguments.seeds, run_cells, tune, bounds)
    _print(result)
    return 0 if result.safe else 1


def _tune(base: Scenario, trials: int, workers: int, bounds: tuple[float, float], policies: Sequence[str]) -> list[str]:
    """Tune the laws of some policies, and show the progress."""
    with Progress(*Progress.get_default_columns(), console=Screen(stderr=True)) as progress:
        bar = progress.add_task("tuning", total=1.0)
        return tune_briefly(
            base, policies, trials, bounds, workers=workers, command=command_line(),
            report=lambda share, news: progress.update(bar, completed=share, description=f"tuning, {news}"),
        )  # fmt: skip


def _print(result: Recommendation) -> None:
    screen = Screen()
    if not result.safe:
        screen.print(f"No policy is safe on {result.scenario}. The best of those that are not:", style="bold")
    rows = [
        (
            choice.policy + " (unsafe)" * (not choice.safe), f"{choice.median_pct:.3g} %", f"{choice.worst_pct:.3g} %",
            f"{choice.diverged} of {choice.runs} (< {100 * choice.diverged_bound:.1f} %)", f"{choice.effort:.2f}",
            *(["unknown"] * 2 if np.isnan(choice.phase_deg) else [f"{choice.phase_deg:.0f}°", f"{choice.delay_samples:.2f}"]),
        )
        for choice in result.choices
    ]  # fmt: skip
    header = ("policy", "error", "worst 5 %", "diverged (bound)", "effort", "phase margin", "delay margin [samples]")
    screen.print(table(f"{result.scenario}, {len(result.conditions)} conditions", header, rows))
    columns = [
        [
            f"{error:.3g} %" + f", {lost} diverged" * (lost > 0)
            for error, lost in zip(each.errors_pct, each.lost, strict=True)
        ]
        for each in result.choices
    ]
    lines = zip(result.conditions, *columns, strict=True)
    screen.print(table("error by condition", ("condition", *(choice.policy for choice in result.choices)), lines))
    for choice in result.choices:
        if choice.remark:
            screen.say(f"margins of {choice.policy}: {choice.remark}")
        if choice.same:
            screen.say(f"the same runs as {choice.policy}: {', '.join(choice.same)}")
    for reason in dict.fromkeys(result.failed.values()):
        without = ", ".join(policy for policy, why in result.failed.items() if why == reason)
        screen.say(f"without {without}: {reason}")
    screen.say(f"{RULE}.\nerror: median of the runs of all conditions.")
