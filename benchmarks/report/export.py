"""Results as rows: CSV, Parquet, and questions in SQL."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.metrics import METRICS
from benchmarks.store import Result, write_text

COLUMNS = ("policy", "scenario", "control_dt", "seed", *METRICS)


def rows(results: Iterable[Result]) -> Iterator[dict[str, Any]]:
    """One row for each policy, scenario and seed."""
    for result in results:
        cell = result.cell
        for seed, row in zip(cell.seeds, result.rows, strict=False):
            task = {"policy": cell.policy, "scenario": cell.scenario.name, "control_dt": cell.scenario.control_dt}
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
