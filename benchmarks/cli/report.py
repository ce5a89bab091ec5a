"""The command `fbl-gym report`."""

import argparse
import os
import sys
from pathlib import Path

from benchmarks.analysis.board import assemble
from benchmarks.cli.common import add_folder, add_store, add_trust, command_line, console
from benchmarks.cli.leaderboard import add_suite, counts, results_of, suite_of
from benchmarks.files import write_text
from benchmarks.report import markdown, terminal
from benchmarks.report.export import write_csv
from benchmarks.report.page import contents, write_page
from benchmarks.report.scenes import scene, selected
from benchmarks.run.runner import traces
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_suite(parser)
    add_trust(parser)
    add_store(parser)
    add_folder(parser, "--out", "results/report", "the report")
    parser.add_argument(
        "--readme", type=Path, metavar="FILE",
        help="put the first ten rows between the markers `<!-- leaderboard -->` of this file, "
        "and all rows into docs/board.md beside it",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Write the report; return 1 if results are missing."""
    cells, store = suite_of(arguments).cells, Store(arguments.store)
    results = results_of(cells, store)
    if not results:
        raise ValueError(
            f"the folder {store.folder} lacks these results: run `fbl-gym leaderboard` with the same arguments first"
        )
    board = assemble(results, cells)
    terminal.leaderboard(console(), board)
    write_text(arguments.out / "board.md", markdown.leaderboard(board))
    write_csv(arguments.out / "board.csv", results)
    tasks = {result.cell.scenario.name: result.cell.scenario for result in results}
    moving = {
        name: {
            board.policies[i]: Cell(board.specs[i], tasks[name], board.seeds[:1])
            for i in board.order
            if (i, board.scenarios.index(name)) not in board.failed
        }
        for name in selected(board.scenarios)
    }
    stored = traces([cell for cells in moving.values() for cell in cells.values()], store, os.cpu_count() or 1)
    scenes = [
        scene(tasks[name], board.seeds[0], {policy: stored[cell.id] for policy, cell in cells.items()})
        for name, cells in moving.items()
        if cells
    ]
    write_page(arguments.out / "board.html", contents(board, results, scenes, command_line()))
    if arguments.readme is not None:
        text = arguments.readme.read_text(encoding="utf-8")
        write_text(arguments.readme, markdown.replace_between(text, markdown.leaderboard(board, short=True)))
        command = f"fbl-gym leaderboard --suite {arguments.suite}"
        write_text(arguments.readme.parent / "docs" / "board.md", markdown.board_page(board, command))
    print(f"report: {arguments.out / 'board.html'}, board.md and board.csv beside it")
    if board.gaps:
        print("fbl-gym: the report is incomplete, see above; `fbl-gym leaderboard` computes the rest", file=sys.stderr)
    return 1 if board.lacking or any(map(counts, (*board.incomplete.values(), *board.failed.values()))) else 0
