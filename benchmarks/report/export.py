"""Results as rows: CSV, Parquet, and questions in SQL."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.analysis.board import Board
from benchmarks.analysis.generalization import RangeErrors
from benchmarks.run.metrics import METRICS
from benchmarks.run.store import Result, write_text

COLUMNS = ("policy", "scenario", "control_dt", "seed", *METRICS)


def rows(results: Iterable[Result]) -> Iterator[dict[str, Any]]:
    """One row for each policy, scenario and seed."""
    for result in results:
        cell = result.cell
        for seed, row in zip(cell.seeds, result.rows, strict=False):
            task = {"policy": cell.policy.name, "scenario": cell.scenario.name, "control_dt": cell.scenario.control_dt}
            yield {**task, "seed": seed, **row}


def _short(row: dict[str, Any]) -> dict[str, Any]:
    return {name: f"{value:.7g}" if isinstance(value, float) else value for name, value in row.items()}


def write_csv(path: Path, results: Iterable[Result]) -> None:
    """Write the rows as CSV, numbers with seven digits; the store has them all."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(_short, rows(results)))
    write_text(path, text.getvalue())


def write_splits(path: Path, board: Board, splits: Mapping[str, RangeErrors]) -> None:
    """Write as CSV each policy's error in % in each split, its interval's ends, and the share of runs that diverged."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["policy", *(f"{split}{part}" for split in splits for part in ("", ": low", ": high", ": diverged"))]
    )
    for i in board.order:
        numbers = (x[i] for s in splits.values() for x in (s.error.value, s.error.low, s.error.high, s.diverged))
        writer.writerow([board.policies[i], *(f"{x:.7g}" for x in numbers)])
    write_text(path, text.getvalue())


def query(results: Iterable[Result], sql: str) -> str | None:
    """DuckDB's answer to a question about the table `results`, whose columns are those of the CSV; None to a command.

    Args:
        results: what the table holds.
        sql: such as "SELECT policy, avg(error_pct) FROM results GROUP BY policy", or
            "COPY results TO 'board.parquet'".
    """
    import duckdb
    import pandas as pd

    connection = duckdb.connect()
    connection.register("results", pd.DataFrame.from_records(list(rows(results)), columns=list(COLUMNS)))
    try:
        answer = connection.sql(sql)
        return None if answer is None else str(answer)
    except duckdb.Error as problem:
        raise ValueError(f"{problem}\nThe table results has the columns {', '.join(COLUMNS)}") from None
