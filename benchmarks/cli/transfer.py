"""`fbl-gym transfer`."""

from __future__ import annotations

import argparse
import os
import sys

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.analysis.transfer import FLOOR_PCT, compare_orders
from benchmarks.cli.common import (
    add_store,
    add_trust,
    command_line,
    console,
    count,
    episodes,
    policy_name,
    trust,
)
from benchmarks.run.runner import run as run_cells
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell, Suite
from fbl_gym import scenarios
from fbl_gym.arm import Array

_OWN = "package"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("policies", nargs="+", type=policy_name, metavar="POLICY", help="as for `fbl-gym evaluate`")
    parser.add_argument(
        "--scenario", nargs="+", default=["everything-2"], metavar="S", help="names of scenarios (everything-2)"
    )
    parser.add_argument(
        "--world", nargs="+", choices=scenarios.WORLDS, default=list(scenarios.WORLDS), metavar="W",
        help=f"out of {', '.join(scenarios.WORLDS)} (all)",
    )  # fmt: skip
    parser.add_argument("--seeds", type=episodes, default=16, metavar="N", help="test seeds 0 to N-1 (16)")
    parser.add_argument(
        "--workers", type=count, default=os.cpu_count() or 1, metavar="N", help="processes (one per core)"
    )
    add_trust(parser)
    add_store(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    trust(arguments)
    store = Store(arguments.store)
    tasks = [scenarios.get(name) for name in arguments.scenario]
    worlds = {_OWN: tasks} | {world: [scenarios.in_world(task, world) for task in tasks] for world in arguments.world}
    cells: dict[str, dict[str, list[Cell]]] = {}
    for world, members in worlds.items():
        cells[world] = {}
        for cell in Suite("transfer", tuple(arguments.policies), tuple(members), arguments.seeds).cells:
            cells[world].setdefault(cell.policy.name, []).append(cell)
    every = [cell for rows in cells.values() for row in rows.values() for cell in row]
    failures = set()
    for outcome in run_cells(every, store, workers=arguments.workers, command=command_line()):
        if outcome.error:
            failures.add(outcome.id)
            print(f"fbl-gym: {outcome.id} failed: {outcome.error}", file=sys.stderr)
    policies = [p for p in cells[_OWN] if not any(cell.id in failures for rows in cells.values() for cell in rows[p])]
    errors = {world: _column(store, [rows[p] for p in policies], "error_pct") for world, rows in cells.items()}
    lost = {world: _column(store, [rows[p] for p in policies], "diverged") for world, rows in cells.items()}

    title = f"error in %, and share of diverged runs; {' '.join(arguments.scenario)}, {arguments.seeds} seeds"
    table = Table(title=title, title_style="bold", box=SIMPLE_HEAD, show_footer=True)
    table.add_column("policy", footer="tau (pairs)")
    for world in cells:
        stays = ~((lost[_OWN] == 1).all(axis=1) & (lost[world] == 1).all(axis=1))  # a policy lost in both has no order
        agreement = compare_orders(errors[_OWN][stays], errors[world][stays])
        footer = "" if world == _OWN else f"{agreement.tau:.2f} ({agreement.pairs})"
        table.add_column(world, justify="right", footer=footer)
    means = {world: np.exp(np.log(np.maximum(rows, FLOOR_PCT)).mean(axis=1)) for world, rows in errors.items()}
    for i in np.argsort(means[_OWN]):
        numbers = []
        for world in cells:
            share = lost[world][i].mean()
            numbers.append(f"{means[world][i]:.3g}" + (f", {100 * share:.0f} %" if share else ""))
        table.add_row(policies[i], *numbers)
    console().print(table)
    print("error: geometric mean over runs; tau: of pairs of policies that both worlds separate")
    return 1 if failures else 0


def _column(store: Store, rows: list[list[Cell]], name: str) -> Array:
    """Return a metric of each policy's runs, [policies x runs]."""
    results = [[store.find(cell) for cell in row] for row in rows]
    return np.array([[run[name] for result in row if result for run in result.rows] for row in results])
