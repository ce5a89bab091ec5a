"""`fbl-gym recommend`."""

import argparse
from collections.abc import Sequence
from functools import partial

import numpy as np
from rich.progress import Progress

from benchmarks.analysis.statistics import proportion, tail_mean
from benchmarks.cli.common import command_line, run_all
from benchmarks.report.terminal import Screen, show
from benchmarks.studies import recommend
from benchmarks.text import say
from benchmarks.tuning.brief import tune_briefly
from fbl_gym.records.checks import check_whole
from fbl_gym.scenarios import Scenario, as_scenario


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit status: 1 if no policy is safe."""
    if arguments.seeds < 2:
        raise ValueError(f"--seeds must be at least 2 for an interval, got {arguments.seeds}")
    trials = check_whole("--trials", arguments.trials, high=10_000)
    if trials:
        import optuna  # noqa: F401  of the extra `analysis`: now, not after minutes of work
    base, run_cells = as_scenario(arguments.scenario), partial(run_all, arguments=arguments)
    classes, text = recommend.likeness(base)
    policies = arguments.policies or recommend.candidates(tuple(dict.fromkeys((*classes, base.robot_class))))
    say(text)
    bounds = arguments.least_phase, arguments.least_delay
    tune = partial(_tune, base, trials, arguments.workers, bounds) if trials else None
    result = recommend.recommend(base, policies, arguments.seeds, run_cells, tune, bounds)
    _print(result)
    return 0 if result.safe else 1


def _tune(base: Scenario, trials: int, workers: int, bounds: tuple[float, float], policies: Sequence[str]) -> list[str]:
    """Tune the laws of some policies, and show the progress."""
    with Progress(console=Screen(stderr=True)) as progress:
        bar = progress.add_task("tuning", total=1.0)
        return tune_briefly(
            base, policies, trials, bounds, workers=workers, command=command_line(),
            report=lambda share, news: progress.update(bar, completed=share, description=f"tuning, {news}"),
        )  # fmt: skip


def _print(result: recommend.Recommendation) -> None:
    if not result.safe:
        Screen().print(f"No policy is safe on {result.scenario}. The best of those that are not:", style="bold")
    rows, columns = [], []
    for choice in result.choices:
        errors, lost = choice.errors_pct, choice.lost
        bound, unknown = 100 * proportion(lost.sum(), lost.size).high, np.isnan(choice.phase_deg)
        margins = ("unknown",) * 2 if unknown else (f"{choice.phase_deg:.0f}°", f"{choice.delay_samples:.2f}")
        rows.append((
            choice.policy + " (unsafe)" * (not choice.safe), f"{np.median(errors):.3g} %",
            f"{tail_mean(errors.ravel()):.3g} %", f"{lost.sum():.0f} of {lost.size} (< {bound:.1f} %)", f"{choice.effort:.2f}",
            *margins,
        ))  # fmt: skip
        cells = zip(np.exp(np.log(errors).mean(axis=-1)), lost.sum(axis=-1).tolist(), strict=True)
        columns.append([f"{error:.3g} %" + f", {n:.0f} diverged" * (n > 0) for error, n in cells])
    header = ("policy", "error", "worst 5 %", "diverged (bound)", "effort", "phase margin", "delay margin [samples]")
    show(f"{result.scenario}, {len(result.conditions)} conditions", header, rows)
    lines = zip(result.conditions, *columns, strict=True)
    show("error by condition", ("condition", *(choice.policy for choice in result.choices)), lines)
    for choice in result.choices:
        if choice.remark:
            say(f"margins of {choice.policy}: {choice.remark}")
        if choice.same:
            say(f"the same runs as {choice.policy}: {', '.join(choice.same)}")
    for reason in dict.fromkeys(result.failed.values()):
        without = ", ".join(policy for policy, why in result.failed.items() if why == reason)
        say(f"without {without}: {reason}")
    say(f"{recommend.RULE}.\nerror: median of the runs of all conditions.")
