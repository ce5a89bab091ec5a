"""The command `fbl-gym report`."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from benchmarks.analysis.board import assemble
from benchmarks.analysis.generalization import measure_ranges
from benchmarks.analysis.robustness import stored_radii
from benchmarks.cli.common import command_line, console, count, trust
from benchmarks.cli.leaderboard import add_suite, results_of, suite_of
from benchmarks.report import markdown, terminal
from benchmarks.report.contents import contents
from benchmarks.report.export import write_csv, write_splits
from benchmarks.report.learned import learned, learned_table
from benchmarks.report.page import write_page
from benchmarks.run.store import Store, write_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_suite(parser)
    parser.add_argument(
        "--out", type=Path, default=Path("results/report"), metavar="DIR", help="folder of the report (results/report)"
    )
    parser.add_argument(
        "--radius", action="store_true", help="also measure the uncertainty radius of every policy (minutes)"
    )
    parser.add_argument(
        "--splits",
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
        help="put the table, without the families, between the markers `<!-- leaderboard -->` of this file",
    )
    parser.add_argument(
        "--workers", type=count, default=os.cpu_count() or 1, metavar="N", help="processes for --radius (one per core)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    trust(arguments)
    store = Store(arguments.store)
    results = results_of(suite_of(arguments).cells, store)
    if not results:
        raise ValueError(
            f"the folder {store.folder} lacks these results: run `fbl-gym leaderboard` with the same arguments first"
        )
    board = assemble(results)
    radii = stored_radii(board.specs, store, arguments.workers) if arguments.radius else {}
    splits = measure_ranges(board, store, arguments.workers) if arguments.splits else {}
    terminal.leaderboard(console(), board)
    table = markdown.leaderboard(board, splits)
    write_text(arguments.out / "board.md", table)
    write_csv(arguments.out / "board.csv", results)
    write_page(arguments.out / "board.html", contents(board, results, radii, splits, command_line()))
    if splits:
        terminal.splits(console(), board, splits)
        write_splits(arguments.out / "splits.csv", board, splits)
    if arguments.learned:
        tasks = {result.cell.scenario.name: result.cell.scenario for result in results}
        write_text(arguments.out / "learned.md", learned_table(learned(list(tasks.values()), board.seeds)))
    if arguments.readme is not None:
        short = markdown.leaderboard(board, families=False)
        write_text(arguments.readme, markdown.replace_between(arguments.readme.read_text(encoding="utf-8"), short))
    print(f"report: {arguments.out / 'board.html'}, board.md and board.csv beside it")
    return 0
