"""The command `fbl-gym query`."""

import argparse
import sys

from benchmarks.cli.common import add_store
from benchmarks.report.export import query
from benchmarks.run.store import Store
from benchmarks.text import visible


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "sql", metavar="SQL",
        help="a question about the table `results`, such as \"SELECT policy, avg(error_pct) FROM results GROUP BY policy\", "
        "or, with --files, \"COPY results TO 'board.parquet'\"; the table `all_results` has results of older code too, "
        "and `test_accesses` counts the configurations that were tried on scenarios for judging",
    )  # fmt: skip
    parser.add_argument("--files", action="store_true", help="let the question read and write files, as COPY does")
    add_store(parser)


def run(arguments: argparse.Namespace) -> int:
    store = Store(arguments.store)
    answer = query(store.results(), arguments.sql, arguments.files, store.test_accesses(), short=sys.stdout.isatty())
    if answer is not None:
        print(visible(answer) if sys.stdout.isatty() else answer)
    return 0
