"""Results as CSV, one row for each run."""

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from benchmarks.files import replacing
from benchmarks.run.metrics import METRICS
from benchmarks.text import visible

#: The runs of a cell: values of its columns, seeds, and metrics of each seed; none if it failed.
Runs: TypeAlias = tuple[Sequence[Any], Sequence[int], Sequence[Mapping[str, float]]]


def write_runs(path: Path, columns: Sequence[str], cells: Iterable[Runs]) -> None:
    """Write runs to a CSV file, whose numbers have seven digits; the store has all digits.

    Args:
        path: of the file, which is complete or absent.
        columns: names of the values, which come before the seed.
        cells: to be written.
    """
    with replacing(path) as beside, beside.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*columns, "seed", *METRICS])
        for values, seeds, rows in cells:
            for seed, row in zip(seeds, rows, strict=False):
                writer.writerow([*map(_cell, values), seed, *(f"{row[name]:.7g}" for name in METRICS)])


def _cell(value: Any) -> Any:
    """Return a value; a name without control characters, and one that no spreadsheet computes."""
    if not isinstance(value, str):
        return value
    return "'" * value.lstrip().startswith(("=", "+", "-", "@")) + visible(value)
