"""The command `fbl-gym report`."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from benchmarks.analysis.board import assemble
from benchmarks.analysis.generalization import measure_ranges
from benchmarks.analysis.learned import measure_learned
from benchmarks.analysis.robustness import stored_radii
from benchmarks.cli.common import command_line, console, count, trust
from benchmarks.cli.leaderboard import add_limits, add_suite, counts, results_of, suite_of
from benchmarks.files import write_text
from benchmarks.policies.apart import Limits, limit
from benchmarks.report import markdown, terminal
from benchmarks.report.export import write_csv, write_generalization
from benchmarks.report.page import contents, write_page
from benchmarks.report.scenes import selected
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell
from benchmarks.run.traces import trace_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_suite(parser)
    add_limits(parser)
    parser.add_argument(
        "--out", type=Path, default=Path("results/report"), metavar="DIR", help="folder of the report (results/report)"
    )
    parser.add_argument(
        "--radius", action="store_true", help="also measure the uncertainty radius of every policy (minutes)"
    )
    parser.add_argument(
        "--generalization",
        action="store_true",
        help="add columns of the error within and beyond the radius that agents are trained on (minutes)",
    )
    parser.add_argument(
        "--learned",
        action="store_true",
        help="also write learned.md, the agents over all their training seeds (minutes)",
    )
    parser.add_argument(
        "--readme",
        type=Path,
        metavar="FILE",
        help="put the first ten rows between the markers `<!-- leaderboard -->` of this file, "
        "and all rows into docs/board.md beside it",
    )
    parser.add_argument(
        "--workers",
        type=count,
        default=os.cpu_count() or 1,
        metavar="N",
        help="processes for --radius, --generalization and --learned (one per core)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    trust(arguments)
    limit(Limits(arguments.cell_timeout, arguments.cell_memory))
    store = Store(arguments.store)
    cells = suite_of(arguments).cells
    results = results_of(cells, store)
    if not results:
        raise ValueError(
            f"the folder {store.folder} lacks these results: run `fbl-gym leaderboard` with the same arguments first"
        )
    board = assemble(results, cells)
    like = results[0].cell.scenario
    radii = stored_radii(board.specs, like, store, arguments.workers) if arguments.radius else {}
    ranges = measure_ranges(board, store, arguments.workers) if arguments.generalization else {}
    terminal.leaderboard(console(), board)
    table = markdown.leaderboard(board, ranges)
    write_text(arguments.out / "board.md", table)
    write_csv(arguments.out / "board.csv", results)
    tasks = {result.cell.scenario.name: result.cell.scenario for result in results}
    traces = [
        {
            board.policies[i]: trace_of(Cell(board.specs[i], tasks[name], board.seeds[:1]), store)
            for i in board.order
            if (i, board.scenarios.index(name)) not in board.failed
        }
        for name in selected(board.scenarios)
    ]
    write_page(arguments.out / "board.html", contents(board, results, traces, radii, ranges, command_line()))
    if ranges:
        terminal.generalization(console(), board, ranges)
        write_generalization(arguments.out / "generalization.csv", board, ranges)
    if arguments.learned:
        rows = measure_learned(list(tasks.values()), board.seeds, store, arguments.workers)
        write_text(arguments.out / "learned.md", markdown.learned_table(rows))
    if arguments.readme is not None:
        text = arguments.readme.read_text(encoding="utf-8")
        write_text(arguments.readme, markdown.replace_between(text, markdown.leaderboard(board, short=True)))
        command = f"fbl-gym leaderboard --suite {arguments.suite}"
        write_text(arguments.readme.parent / "docs" / "board.md", markdown.board_page(board, command))
    print(f"report: {arguments.out / 'board.html'}, board.md and board.csv beside it")
    if board.gaps:
        print("fbl-gym: the report is incomplete, see above; `fbl-gym leaderboard` computes the rest", file=sys.stderr)
    return 1 if board.lacking or any(map(counts, (*board.incomplete.values(), *board.failed.values()))) else 0
