"""The command `fbl-gym leaderboard`."""

import argparse
import dataclasses
import sys
from collections.abc import Mapping, Sequence

from benchmarks.analysis.board import Board, assemble
from benchmarks.analysis.transfer import Agreement, compare_halves, compare_orders
from benchmarks.cli.common import command_line, limits_of, run_all, write
from benchmarks.report import terminal
from benchmarks.report.latex import write_board
from benchmarks.run.cell import Cell
from benchmarks.run.expansion import expand
from benchmarks.run.store import Result
from benchmarks.run.suite import Suite, load
from benchmarks.text import say
from fbl_gym import scenarios
from fbl_gym.scenarios.classes import CLASSES

#: Policies of a board that the short form prints, and those of `--policy`.
SHOWN = 10


def suites_of(arguments: argparse.Namespace) -> list[Suite]:
    """Return the suites that the arguments describe, each of which makes a board."""
    names = arguments.suite or [*CLASSES]
    if arguments.scenarios and not arguments.suite:
        classes = {scenario.robot_class for scenario in expand(arguments.scenarios)}
        names = [classes.pop() if len(classes) == 1 else "servo"]
    suites = [
        load(name, arguments.trust).build(
            arguments.policies, arguments.scenarios, arguments.seeds,
            short=arguments.short, more=arguments.policy, limits=limits_of(arguments),
        )
        for name in names
    ]  # fmt: skip
    taken = [suite.name for suite in suites]
    if len(set(taken)) < len(taken):
        raise ValueError(f"--suite must give suites of different names, got {', '.join(taken)}")
    return suites


def run(arguments: argparse.Namespace) -> int:
    """Run the suite's cells, print the board, and return the exit status."""
    suites = suites_of(arguments)
    if arguments.tex and (arguments.world or len(suites) > 1):
        raise ValueError("--tex is for one board, such as that of --suite servo, and without --world")
    if arguments.world:
        return max(compare_worlds(suite, arguments) for suite in suites)
    results = run_all([cell for suite in suites for cell in suite.cells], arguments)
    if not any(result.rows for result in results.values()):
        failed = results[suites[0].cells[0]]
        say(f"fbl-gym: no cell has a result; {failed.cell.id} failed: {failed.error}", sys.stderr)
        return 1
    boards = boards_of(suites, results)
    asked = {*map(str, arguments.policy)}
    every = [
        (row, {row, *(spec.name for spec in specs)}) for board in boards.values() for row, specs in board.rows.items()
    ]
    some = (SHOWN, [row for row, names in every if names & asked]) if arguments.short else ()
    terminal.leaderboards(terminal.Screen(), boards, *some)
    write(arguments.tex, "table", lambda path: write_board(path, boards[suites[0].name], command_line()))
    first = f"the first {SHOWN} of each board; " if arguments.short else ""
    say(f"{first}results: {arguments.store}; a page of them: fbl-gym report, of the same suite, policies and seeds")
    return int(any(counts(result.error) for result in results.values()))


def boards_of(suites: Sequence[Suite], results: Mapping[Cell, Result]) -> dict[str, Board]:
    """Return the board of each suite, by its name, from the results of `run_all`."""
    boards = {}
    for suite in suites:
        some = [results[cell] for cell in suite.cells]
        if len(suites) == 1 or any(result.rows for result in some):
            boards[suite.name] = assemble(some, suite.cells)
        else:
            say(f"fbl-gym: {suite.name} has no result: {some[0].error}", sys.stderr)
    return boards


def counts(error: str) -> bool:
    """Return True if an error counts as a failure. An absent extra, sensor or drive does not."""
    expected = ("DependencyNotInstalled", "needs a sensor of", "needs both drives", "needs an arm that hangs")
    return bool(error) and not any(each in error for each in (*expected, "not applicable"))


def compare_worlds(suite: Suite, arguments: argparse.Namespace) -> int:
    """Run a suite in all worlds, print the boards and their agreement; return the exit status."""
    if suite.seeds < 4:
        raise ValueError(f"--seeds must be at least 4, two for each half, got {suite.seeds}")
    sides, worlds = [dataclasses.replace(suite, name="package")], [*dict.fromkeys(arguments.world)]
    for world in worlds:
        tasks = tuple(scenarios.in_world(task, world) for task in suite.scenarios)
        sides.append(dataclasses.replace(suite, name=world, scenarios=tasks))
    results = run_all([cell for side in sides for cell in side.cells], arguments)
    if len(boards := boards_of(sides, results)) < len(sides):
        raise ValueError("--world must be one in which some policy has results")
    for side, board in boards.items():
        say(f"{side}:")
        terminal.leaderboard(terminal.Screen(), board)
    say(terminal.MEANING)
    complete = [{*board.policies} - {*board.failed} for board in boards.values()]
    names = [name for name in boards["package"].policies if all(name in some for some in complete)]
    own, *halves = (_tau(compare_halves(board, names)) for board in boards.values())
    taus = (_tau(compare_orders(boards["package"], boards[world], names)) for world in worlds)
    rows = [(world, tau, f"{own} / {half}") for world, tau, half in zip(worlds, taus, halves, strict=True)]
    terminal.show("Kendall's tau (pairs) between the orders by the error", ("world", "tau", "halves"), rows)
    say("tau: of all pairs of rows, and of those that both sides separate.")
    say("halves: the same between halves of the seeds, package's arm / world")
    return int(any(counts(result.error) for result in results.values()))


def _tau(agreement: Agreement) -> str:
    return f"{agreement.tau:.2f} ({agreement.pairs}), {agreement.clear_tau:.2f} ({agreement.clear_pairs})"
