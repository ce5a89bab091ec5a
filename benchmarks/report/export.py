"""Results as CSV, one row for each run."""

import contextlib
import csv
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.files import replacing
from benchmarks.run.metrics import METRICS
from benchmarks.run.store import Result


@contextlib.contextmanager
def csv_file(path: Path, columns: Sequence[str]) -> Iterator[Callable[..., None]]:
    """Yield a function `append(values, seeds, rows)` that writes the runs of a cell to a CSV file.

    Numbers have seven digits; the store has all digits. One cell at a time needs memory.

    Args:
        path: of the file, which is complete or absent.
        columns: names of the `values`, which come before the seed.
    """
    with replacing(path) as beside, beside.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*columns, "seed", *METRICS])

        def append(values: Sequence[Any], seeds: Sequence[int], rows: Sequence[Mapping[str, float]]) -> None:
            for seed, row in zip(seeds, rows, strict=False):  # a failed cell has no rows
                writer.writerow([*values, seed, *(f"{row[name]:.7g}" for name in METRICS)])

        yield append


def write_csv(path: Path, results: Sequence[Result]) -> None:
    """Write all runs of some results as CSV."""
    with csv_file(path, ("policy", "scenario", "control_dt")) as append:
        for result in results:
            task = result.cell.scenario
            values = (result.cell.policy.name, task.name, f"{task.control_dt:.7g}")
            append(values, result.cell.seeds, result.rows)
