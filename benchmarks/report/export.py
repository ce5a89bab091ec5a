"""Results as rows: CSV, Parquet, and questions in SQL."""

import contextlib
import csv
import io
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.files import replacing
from benchmarks.run.current import current_keys, current_runs
from benchmarks.run.metrics import METRICS
from benchmarks.run.store import Result

COLUMNS = ("policy", "scenario", "control_dt", "seed", *METRICS)
"""Columns of every table of runs. Those of external metrics follow."""

FURTHER = ("key", "current", "seeds", "code", "time")
"""Columns that only the table `all_results` has."""

TEXTS = ("policy", "scenario", "key", "code", "time")
"""Columns of text."""


def _row(result: Result, i: int) -> dict[str, Any]:
    cell = result.cell
    task = {"policy": cell.policy.name, "scenario": cell.scenario.name, "control_dt": cell.scenario.control_dt}
    return {**task, "seed": cell.seeds[i], **result.rows[i]}


def _columns(results: Sequence[Result]) -> list[str]:
    """Return `COLUMNS`, and the names of external metrics."""
    return [*COLUMNS, *dict.fromkeys(metric.name for result in results for metric in result.cell.metrics)]


@contextlib.contextmanager
def csv_file(path: Path, columns: Sequence[str], metrics: Sequence[str]) -> Iterator[Callable[..., None]]:
    """Yield a function `append(values, seeds, rows)` that writes the runs of a cell to a CSV file.

    Numbers have seven digits; the store has all digits. One cell at a time needs memory.

    Args:
        path: of the file, which is complete or absent.
        columns: names of the `values`, which come before the seed.
        metrics: the metrics that follow the seed.
    """
    with replacing(path) as beside, beside.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*columns, "seed", *metrics])

        def append(values: Sequence[Any], seeds: Sequence[int], rows: Sequence[Mapping[str, float]]) -> None:
            for seed, row in zip(seeds, rows, strict=False):  # a failed cell has no rows
                writer.writerow([*values, seed, *(f"{row[name]:.7g}" if name in row else "" for name in metrics)])

        yield append


def write_csv(path: Path, results: Sequence[Result]) -> None:
    """Write all runs as CSV."""
    with csv_file(path, COLUMNS[:3], _columns(results)[4:]) as append:
        for result in results:
            task = result.cell.scenario
            values = (result.cell.policy.name, task.name, f"{task.control_dt:.7g}")
            append(values, result.cell.seeds, result.rows)


def query(
    results: Iterable[Result],
    sql: str,
    files: bool = False,
    test_accesses: Mapping[tuple[str, str], int] | None = None,
    short: bool = False,
) -> str | None:
    """Return DuckDB's answer to a question about stored results as CSV; None for a command.

    A short answer is a table that fits into a terminal instead.

    The table `results` has each run of the current results once, with the columns of the CSV. The
    table `all_results` has every stored run, those of older code and other sets of seeds among
    them, and the columns `FURTHER` too. A question is "SELECT policy, avg(error_pct) FROM results
    GROUP BY policy", a command "COPY results TO 'board.parquet'". With `files`, it may read and
    write files, and load extensions. The table `test_accesses` counts the configurations of each
    policy that were run on each scenario for judging.
    """
    import duckdb  # the extra `analysis`

    stored = list(results)
    keys = current_keys(stored)
    every = [
        {**_row(result, i), "key": result.cell.key, "current": result.cell.key in keys, "seeds": len(result.rows),
         "code": result.cell.policy.digest[:12], "time": result.provenance.get("time", "")}
        for result in stored for i in range(len(result.rows))
    ]  # fmt: skip
    counts = [{"policy": law, "scenario": task, "test_accesses": n} for (law, task), n in (test_accesses or {}).items()]
    columns = _columns(stored)
    tables = {
        "results": ([_row(result, i) for result, i in current_runs(stored)], columns),
        "all_results": (every, [*columns, *FURTHER]),
        "test_accesses": (counts, ["policy", "scenario", "test_accesses"]),
    }
    connection = duckdb.connect()
    for name, (rows, names) in tables.items():
        connection.register(name, {column: _values(rows, column) for column in names})
    try:
        if not files:
            connection.execute("SET enable_external_access = false")
        connection.execute("SET lock_configuration = true")
        answer = connection.sql(sql)
        if answer is None or short:
            return None if answer is None else str(answer)
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([answer.columns, *answer.fetchall()])
        return text.getvalue().rstrip("\n")
    except duckdb.Error as problem:
        known = f"The table results has the columns {', '.join(columns)}; all_results has {', '.join(FURTHER)} too"
        raise ValueError(f"{problem}\n{known}") from None


def _values(rows: Sequence[Mapping[str, Any]], column: str) -> Any:
    """Return a column of some rows as an array, NaN where a row lacks it."""
    return np.array([row.get(column, math.nan) for row in rows], dtype=object if column in TEXTS else None)
