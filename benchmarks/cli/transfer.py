"""`fbl-gym transfer`."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.analysis.transfer import Agreement, Runs, compare_halves, compare_orders, transfer_best
from benchmarks.cli.common import add_store, add_trust, command_line, console, count, episodes, policy_name, trust
from benchmarks.policies.spec import names
from benchmarks.report import markdown
from benchmarks.run.runner import run as run_cells
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell, Suite
from fbl_gym import Scenario, scenarios

_PACKAGE = "package"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "policies",
        nargs="*",
        type=policy_name,
        metavar="POLICY",
        help="as for `fbl-gym evaluate` (every policy but nmpc)",
    )
    parser.add_argument(
        "--scenario", nargs="+", default=scenarios.in_tier("hardware", [2]), metavar="S",
        help="names of scenarios (the tier hardware at severity 2)",
    )  # fmt: skip
    parser.add_argument(
        "--world", nargs="+", choices=scenarios.WORLDS, default=["mujoco-lab"], metavar="W",
        help=f"out of {', '.join(scenarios.WORLDS)} (mujoco-lab)",
    )  # fmt: skip
    parser.add_argument("--top", type=count, default=5, metavar="N", help="best policies to follow into the worlds (5)")
    parser.add_argument("--markdown", action="store_true", help="print the tables in Markdown")
    parser.add_argument("--seeds", type=episodes, default=16, metavar="N", help="test seeds 0 to N-1 (16)")
    parser.add_argument(
        "--workers", type=count, default=os.cpu_count() or 1, metavar="N", help="processes (one per core)"
    )
    add_trust(parser)
    add_store(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    if arguments.seeds < 4:
        raise ValueError(f"--seeds must be at least 4, two for each half, got {arguments.seeds}")
    trust(arguments)
    store = Store(arguments.store)
    policies = arguments.policies or [name for name in names() if not name.startswith("nmpc")]
    tasks = [scenarios.get(name) for name in arguments.scenario]
    sides = {_PACKAGE: tasks} | {
        world: [scenarios.in_world(task, world) for task in tasks] for world in arguments.world
    }
    cells = {side: _cells(policies, members, arguments.seeds) for side, members in sides.items()}
    every = [cell for rows in cells.values() for row in rows.values() for cell in row]
    failures: dict[str, str] = {}
    for outcome in run_cells(every, store, workers=arguments.workers, command=command_line()):
        if outcome.error:
            failures[outcome.id] = outcome.error
    ranked: dict[str, bool] = {}
    for name, row in cells[_PACKAGE].items():
        reasons = [failures[cell.id] for rows in cells.values() for cell in rows[name] if cell.id in failures]
        if reasons:
            print(f"fbl-gym: without {name}, which failed: {reasons[0]}", file=sys.stderr)
        else:
            ranked[name] = row[0].policy.ranked
    if not ranked:
        raise ValueError("every policy failed on a scenario, so no order can be compared")
    runs = {
        side: Runs.of([[result for cell in rows[name] if (result := store.find(cell))] for name in ranked])
        for side, rows in cells.items()
    }
    _print_orders(arguments, runs)
    _print_best(arguments, runs, list(ranked), np.array(list(ranked.values())))
    return 1 if failures else 0


def _cells(policies: Sequence[str], members: Sequence[Scenario], seeds: int) -> dict[str, list[Cell]]:
    """Return the cells of each policy, by name, in the order of the scenarios."""
    rows: dict[str, list[Cell]] = {}
    for cell in Suite("transfer", tuple(policies), tuple(members), seeds).cells:
        rows.setdefault(cell.policy.name, []).append(cell)
    return rows


def _print_orders(arguments: argparse.Namespace, runs: dict[str, Runs]) -> None:
    """Print Kendall's tau of each family, and of all scenarios together."""
    families: dict[str, list[int]] = {}
    for i, name in enumerate(arguments.scenario):
        member = scenarios.member(name)
        families.setdefault(member.family if member else name, []).append(i)
    if len(arguments.scenario) > 1:
        families["all"] = list(range(len(arguments.scenario)))
    header = ["family", *(f"{world}{part}" for world in arguments.world for part in ("", ", halves"))]
    lines = []
    for family, members in families.items():
        some = {side: Runs(r.error[:, members], r.diverged[:, members]) for side, r in runs.items()}
        line = [family]
        for world in arguments.world:
            halves = [compare_halves(some[side]) for side in (_PACKAGE, world)]
            line += [_tau(compare_orders(some[_PACKAGE], some[world])), " / ".join(map(_tau, halves))]
        lines.append(line)
    _print(
        arguments,
        f"tau (pairs) between the orders on the package's arm and in a world, {arguments.seeds} seeds",
        header,
        lines,
    )
    print("pairs: both sides separate them. halves: the same between halves of the seeds, package's arm / world")


def _print_best(arguments: argparse.Namespace, runs: dict[str, Runs], policies: list[str], ranked: np.ndarray) -> None:
    """Print the best policies on the package's arm, in each world."""
    header = ["policy", "world", "error", "diverged", "x best there", "worst scenario: x best there"]
    lines = []
    for world in arguments.world if ranked.any() else ():
        total = runs[world].diverged[0].size
        for best in transfer_best(runs[_PACKAGE], runs[world], ranked, arguments.top):
            place = f"{arguments.scenario[best.scenario]}: {best.worst:.2f}"
            lost = f"{best.diverged} of {total}"
            lines.append([policies[best.policy], world, f"{best.error:.3g} %", lost, f"{best.ratio:.2f}", place])
    _print(arguments, f"the best {arguments.top} on the package's arm over all scenarios", header, lines)
    print("error: geometric mean over runs. The order is that of the score: diverged runs have a price.")


def _print(arguments: argparse.Namespace, title: str, header: Sequence[str], lines: Sequence[Sequence[str]]) -> None:
    if arguments.markdown:
        print(markdown.table(header, lines))
        return
    table = Table(title=title, title_style="bold", box=SIMPLE_HEAD)
    for i, name in enumerate(header):
        table.add_column(name, justify="right" if i else "left")
    for line in lines:
        table.add_row(*line)
    console().print(table)


def _tau(agreement: Agreement) -> str:
    return f"{agreement.tau:.2f} ({agreement.pairs})"
