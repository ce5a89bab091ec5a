"""The command `fbl-gym report`."""

import argparse
import sys

from benchmarks.analysis.board import assemble
from benchmarks.cli.common import command_line
from benchmarks.cli.leaderboard import counts, suites_of
from benchmarks.files import write_text
from benchmarks.report import markdown, terminal
from benchmarks.report.export import write_runs
from benchmarks.report.page import write_page
from benchmarks.report.plot import plot_errors
from benchmarks.run.store import Store
from benchmarks.text import say
from fbl_gym.reading import read_text


def run(arguments: argparse.Namespace) -> int:
    """Write the report; return 1 if results are missing."""
    suites, store, out = suites_of(arguments), Store(arguments.store), arguments.out
    results = {suite.name: [*filter(None, map(store.find_any, suite.cells))] for suite in suites}
    if not any(results.values()):
        raise ValueError(
            f"{store.folder} lacks these results: run `fbl-gym leaderboard` of the same suite, policies and seeds"
        )
    some = [suite for suite in suites if any(result.rows for result in results[suite.name])]
    boards = {suite.name: assemble(results[suite.name], suite.cells) for suite in some or suites}
    for name in [suite.name for suite in suites if suite.name not in boards]:
        say(f"fbl-gym: {name} has no results, and no report", sys.stderr)
    terminal.leaderboards(terminal.Screen(), boards)
    for name, board in boards.items():
        folder = out / name if len(suites) > 1 else out
        write_text(folder / "board.md", markdown.leaderboard(board))
        tasks = ((result, result.cell.scenario) for result in results[name])
        runs = (((x.cell.policy.name, task.name, f"{task.control_dt:.7g}"), x.cell.seeds, x.rows) for x, task in tasks)
        write_runs(folder / "board.csv", ("policy", "scenario", "control_dt"), runs)
        write_page(folder / "board.html", board, results[name], command_line())
        say(f"report: {folder / 'board.html'}, board.md and board.csv beside it")
        if board.gaps:
            say("fbl-gym: the report is incomplete, see above; `fbl-gym leaderboard` computes the rest", sys.stderr)
    if arguments.readme is not None:
        text = read_text(arguments.readme)
        write_text(arguments.readme, markdown.replace_between(text, markdown.first_rows(boards)))
        docs = arguments.readme.parent / "docs"
        write_text(docs / "results" / "board.md", markdown.board_page(boards))
        plot_errors(boards, docs / "pictures" / "errors.svg")
    failures = [some for board in boards.values() for some in (board.incomplete, *board.failed.values())]
    lacking = len(boards) < len(suites) or any(board.lacking for board in boards.values())
    return int(lacking or any(counts(error) for some in failures for error in some.values()))
