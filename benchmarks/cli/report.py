"""The command `fbl-gym report`."""

import argparse
import sys
from pathlib import Path

from benchmarks.cli.common import add, add_option, command_line
from benchmarks.cli.leaderboard import add_suite, boards_of, counts, results_of, suites_of
from benchmarks.files import write_text
from benchmarks.report import markdown, terminal
from benchmarks.report.export import write_csv
from benchmarks.report.page import write_page
from benchmarks.report.plot import plot_errors
from benchmarks.run.store import Store
from benchmarks.text import say
from fbl_gym.reading import read_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_suite(parser)
    add(parser, "--trust", "--store")
    add_option(parser, "--out", Path, Path("results/report"), "DIR", "folder of the report")
    readme = (
        "put the first five rows of each board between the markers `<!-- leaderboard -->` of this file, all rows into "
    )
    readme += "docs/results/board.md beside it, and their errors into docs/pictures/errors.svg"
    parser.add_argument("--readme", type=Path, metavar="FILE", help=readme)


def run(arguments: argparse.Namespace) -> int:
    """Write the report; return 1 if results are missing."""
    suites, store, out = suites_of(arguments), Store(arguments.store), arguments.out
    if not results_of([cell for suite in suites for cell in suite.cells], store):
        raise ValueError(f"{store.folder} lacks these results: run `fbl-gym leaderboard` with the same arguments")
    boards = boards_of(suites, store)
    terminal.leaderboards(terminal.Screen(), boards)
    for suite in suites:
        board, results = boards[suite.name], results_of(suite.cells, store)
        folder = out / suite.name if len(suites) > 1 else out
        write_text(folder / "board.md", markdown.leaderboard(board))
        write_csv(folder / "board.csv", results)
        write_page(folder / "board.html", board, results, command_line())
        say(f"report: {folder / 'board.html'}, board.md and board.csv beside it")
        if board.gaps:
            print(
                "fbl-gym: the report is incomplete, see above; `fbl-gym leaderboard` computes the rest", file=sys.stderr
            )
    if arguments.readme is not None:
        text = read_text(arguments.readme)
        write_text(arguments.readme, markdown.replace_between(text, markdown.first_rows(boards)))
        docs = arguments.readme.parent / "docs"
        write_text(docs / "results" / "board.md", markdown.board_page(boards))
        plot_errors(boards, docs / "pictures" / "errors.svg")
    errors = [
        error for board in boards.values() for some in (board.incomplete, *board.failed.values()) for error in some.values()
    ]  # fmt: skip
    return 1 if any(board.lacking for board in boards.values()) or any(map(counts, errors)) else 0
