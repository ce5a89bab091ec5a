"""The leaderboard and the evaluation of one policy, as tables on a terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

import controllers
from benchmarks.metrics import describe, summarize
from benchmarks.paper import Claim
from benchmarks.runner import Result
from benchmarks.speed import Speed


def leaderboard(console: Console, results: Sequence[Result]) -> None:
    """A table per arm, one row per scenario and one column per policy, the best first; side by side as far as they fit."""
    order = ranking(results)
    across = max((console.width - 14) // 11, 1)
    for arm in dict.fromkeys(_arm(result.cell.scenario) for result in results):
        ours = [result for result in results if _arm(result.cell.scenario) == arm]
        for first in range(0, len(order), across):
            console.print(_table(arm, order, order[first : first + across], ours))
    console.print(
        "The best ranked policy of a row is green. Red: share of runs that diverged; such a run counts as half a turn of error "
        "from then on. In brackets: knows the truth, not ranked. All policies met the same seeds."
    )
    for error in dict.fromkeys(f"{r.cell.policy}: {r.error}" for r in results if r.error):
        console.print(f"[red]failed[/red] {escape(error)}")


def ranking(results: Sequence[Result]) -> list[str]:
    """The policies by their mean error over all cells, best first; then those that know the truth, then the failed ones."""
    policies = dict.fromkeys(result.cell.policy for result in results)
    return sorted(
        policies, key=lambda p: (not _rows(p, results), controllers.tier(p) == "truth", _mean_error(p, results))
    )


def _arm(scenario: str) -> str:
    return scenario.rpartition("/")[0] or "table-1"


def _rows(policy: str, results: Sequence[Result]) -> list[dict[str, float]]:
    return [row for result in results if result.cell.policy == policy for row in result.rows]


def _mean_error(policy: str, results: Sequence[Result]) -> float:
    return summarize(_rows(policy, results))["error_pct"]


def _table(arm: str, policies: Sequence[str], shown: Sequence[str], results: Sequence[Result]) -> Table:
    by_cell = {(result.cell.policy, result.cell.scenario): result for result in results}
    title = f"Arm {arm}: mean absolute tracking error, % of the reference's amplitude"
    table = Table(title=title, title_style="bold", box=SIMPLE_HEAD, padding=(0, 0, 0, 1), pad_edge=False)
    table.add_column("scenario", no_wrap=True)
    for policy in shown:
        unranked = controllers.tier(policy) == "truth"
        name = f"({policy})" if unranked else policy
        table.add_column(name.replace("-", "-\n"), justify="right", style="dim" if unranked else "", no_wrap=True)
    before = ""
    for scenario in dict.fromkeys(result.cell.scenario for result in results):
        name = scenario.rpartition("/")[2]
        family = name.rpartition("-")[0] or name
        if before and family != before:
            table.add_section()
        before = family
        best = _best(policies, [by_cell.get((policy, scenario)) for policy in policies])
        cells = [by_cell.get((policy, scenario)) for policy in shown]
        table.add_row(name, *(_cell(result, result is best) for result in cells))
    table.add_section()
    means = [_number(_mean_error(p, results)) if _rows(p, results) else "failed" for p in shown]
    table.add_row("mean", *means, style="bold")
    table.add_row("us/decision", *(_decision(policy, results) for policy in shown))
    return table


def _best(policies: Sequence[str], cells: Sequence[Result | None]) -> Result | None:
    ranked = [
        (summarize(list(result.rows))["error_pct"], i, result)
        for i, (policy, result) in enumerate(zip(policies, cells, strict=True))
        if result is not None and result.rows and controllers.tier(policy) != "truth"
    ]
    return min(ranked)[2] if ranked else None


def _cell(result: Result | None, best: bool) -> str:
    if result is None:
        return ""
    if not result.rows:
        return "[red]failed[/red]"
    mean = summarize(list(result.rows))
    text = _number(mean["error_pct"])
    text = f"[green]{text}[/green]" if best else text
    return text + (f" [red]{100 * mean['diverged']:.0f}%[/red]" if mean["diverged"] else "")


def _number(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def _decision(policy: str, results: Sequence[Result]) -> str:
    times = [result.decision_us for result in results if result.cell.policy == policy and not result.error]
    return f"{np.median(times):.2g}" if times else ""


def evaluation(console: Console, title: str, rows: list[dict[str, float]], decision_us: float) -> None:
    """The metrics of one policy on one scenario: mean over the seeds, and the spread."""
    table = Table(title=title, title_style="bold")
    for name, justify in (("metric", "left"), ("mean", "right"), ("worst seed", "right"), ("meaning", "left")):
        table.add_column(name, justify=justify, overflow="fold")  # type: ignore[arg-type]
    for name, value, meaning in describe(summarize(rows)):
        known = [row[name] for row in rows if not np.isnan(row[name])]
        table.add_row(name, value, f"{max(known):.4g}" if known else "-", escape(meaning))
    table.add_row("decision_us", f"{decision_us:.3g}", "", escape("wall time of one decision of one lane [us]"))
    console.print(table)


def claims(console: Console, found: Sequence[Claim]) -> None:
    """The paper's claims: what it says, what was measured, and the verdict."""
    table = Table(title="The paper's claims, measured", title_style="bold", box=SIMPLE_HEAD)
    for name in ("figure", "claim", "paper", "measured", "verdict"):
        table.add_column(name, overflow="fold")
    colour = {"reproduced": "green", "under a reading": "yellow", "not reproduced": "red"}
    for claim in found:
        verdict = f"[{colour[claim.verdict]}]{claim.verdict}[/]"
        table.add_row(claim.figure, escape(claim.claim), escape(claim.paper), escape(claim.measured), verdict)
    console.print(table)


def speed(console: Console, rows: Sequence[Speed]) -> None:
    """Steps per second, and how many times its peer's."""
    table = Table(title="Environment steps per second, one thread, median of the rounds", title_style="bold")
    table.add_column("environment", no_wrap=True)
    for name in ("median", "spread", "x Acrobot"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        ratio = f"{row.ratio:.1f}" if row.peer else ""
        table.add_row(row.name, f"{row.median:,.0f}", f"{100 * (row.high - row.low) / row.median:.0f} %", ratio)
    console.print(table)
    console.print(
        "x Acrobot: to Acrobot-v1 through gym.make for a single environment, to SyncVectorEnv of 256 for a batch. busy: "
        "stick-slip friction, noise on every sensor and a disturbance. One step is ten Runge-Kutta steps of 1 ms."
    )
