"""`fbl-gym leaderboard --world W`: boards of the package's arm and of MuJoCo's, and their tau."""

import argparse
import dataclasses

from benchmarks.analysis.board import assemble
from benchmarks.analysis.transfer import Agreement, Runs, compare_halves, compare_orders
from benchmarks.cli.common import results_by_id
from benchmarks.report.terminal import Screen, leaderboard, table
from benchmarks.run.suite import Suite
from fbl_gym import scenarios


def add_world(parser: argparse.ArgumentParser) -> None:
    orders = f"compare the orders on the package's arm and in MuJoCo's worlds {', '.join(scenarios.WORLDS)}"
    parser.add_argument("--world", nargs="+", choices=scenarios.WORLDS, metavar="W", help=orders)


def compare(suite: Suite, arguments: argparse.Namespace) -> int:
    """Run a suite in all worlds, print the boards and their agreement; return the exit status."""
    if suite.seeds < 4:
        raise ValueError(f"--seeds must be at least 4, two for each half, got {suite.seeds}")
    suites = {"package": suite}
    for world in arguments.world:
        tasks = tuple(scenarios.in_world(scenario, world) for scenario in suite.scenarios)
        suites[world] = dataclasses.replace(suite, scenarios=tasks)
    results = results_by_id([cell for side in suites.values() for cell in side.cells], arguments)
    failed = {result.cell.policy.name for result in results.values() if result.error}
    names = dict.fromkeys(cell.policy.name for cell in suite.cells if cell.policy.name not in failed)
    screen, runs = Screen(), {}
    for side, members in suites.items():
        screen.say(f"{side}:")
        leaderboard(screen, assemble([results[cell.id] for cell in members.cells], members.cells))
        runs[side] = Runs.of([[results[f"{name}/{task.name}"] for task in members.scenarios] for name in names])
    halves = {side: _tau(compare_halves(some)) for side, some in runs.items()}
    rows = [
        (world, _tau(compare_orders(runs["package"], runs[world])), f"{halves['package']} / {halves[world]}")
        for world in arguments.world
    ]
    screen.print(table("Kendall's tau (pairs) between the orders by the error", ("world", "tau", "halves"), rows))
    screen.say(
        "tau: of all pairs of rows, and of those that both sides separate. halves: the same between halves of the seeds, "
        "package's arm / world"
    )
    return 1 if failed else 0


def _tau(agreement: Agreement) -> str:
    return f"{agreement.tau:.2f} ({agreement.pairs}), {agreement.clear_tau:.2f} ({agreement.clear_pairs})"
