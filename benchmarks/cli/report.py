"""The command `fbl-gym report`."""

import argparse
import sys
from pathlib import Path

from benchmarks.analysis.board import assemble
from benchmarks.cli.common import add_folder, add_store, add_trust, command_line
from benchmarks.cli.leaderboard import add_suite, counts, results_of, suite_of
from benchmarks.files import write_text
from benchmarks.report import markdown, terminal
from benchmarks.report.export import write_csv
from benchmarks.report.page import contents, write_page
from benchmarks.run.store import Store
from benchmarks.text import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_suite(parser)
    add_trust(parser)
    add_store(parser)
    add_folder(parser, "--out", "results/report", "the report")
    parser.add_argument(
        "--readme", type=Path, metavar="FILE",
        help="put the first five rows between the markers `<!-- leaderboard -->` of this file, "
        "and all rows into docs/results/board.md beside it",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Write the report; return 1 if results are missing."""
    cells, store = suite_of(arguments).cells, Store(arguments.store)
    results = results_of(cells, store)
    if not results:
        raise ValueError(_lacking(store))
    board = assemble(results, cells)
    terminal.leaderboard(terminal.Screen(), board)
    write_text(arguments.out / "board.md", markdown.leaderboard(board))
    write_csv(arguments.out / "board.csv", results)
    accesses = [f"{law},{scenario},{count}\n" for (law, scenario), count in store.test_accesses().items()]
    write_text(arguments.out / "test_accesses.csv", "".join(["policy,scenario,test_accesses\n", *accesses]))
    write_page(arguments.out / "board.html", contents(board, results, command_line()))
    if arguments.readme is not None:
        text = arguments.readme.read_text(encoding="utf-8")
        write_text(arguments.readme, markdown.replace_between(text, markdown.leaderboard(board, short=True)))
        command = f"fbl-gym leaderboard --suite {arguments.suite}"
        write_text(arguments.readme.parent / "docs" / "results" / "board.md", markdown.board_page(board, command))
    say(f"report: {arguments.out / 'board.html'}, board.md, board.csv and test_accesses.csv beside it")
    if board.gaps:
        print("fbl-gym: the report is incomplete, see above; `fbl-gym leaderboard` computes the rest", file=sys.stderr)
    return 1 if board.lacking or any(map(counts, (*board.incomplete.values(), *board.failed.values()))) else 0


def _lacking(store: Store) -> str:
    """Return the error of a store without a result of the suite, which names what it has."""
    cells = [result.cell for result in store.results()]
    policies = " ".join(sorted({cell.policy.name for cell in cells}))
    tasks = " ".join(sorted({cell.scenario.name for cell in cells}))
    seeds = ", ".join(map(str, sorted({len(cell.seeds) for cell in cells})))
    stored = f"; it has --policies {policies} --scenarios {tasks} --seeds {seeds}" if cells else ""
    return f"the folder {store.folder} lacks these results: run `fbl-gym leaderboard` with the same arguments first{stored}"
