"""Results as rows: CSV, Parquet, and questions in SQL."""

import contextlib
import csv
import io
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.files import replacing
from benchmarks.run.current import current_keys, current_runs
from benchmarks.run.metrics import METRICS
from benchmarks.run.store import Result

COLUMNS = ("policy", "scenario", "control_dt", "seed", *METRICS)
"""Columns of every table of runs. Those of external metrics follow."""

APART = ("key", "current", "seeds", "code", "time")
"""Columns that only the table `all_results` has."""


def _row(result: Result, i: int) -> dict[str, Any]:
    cell = result.cell
    task = {"policy": cell.policy.name, "scenario": cell.scenario.name, "control_dt": cell.scenario.control_dt}
    return {**task, "seed": cell.seeds[i], **result.rows[i]}


def _columns(results: Sequence[Result]) -> list[str]:
    """Return `COLUMNS`, and the names of external metrics."""
    return [*COLUMNS, *dict.fromkeys(metric.name for result in results for metric in result.cell.metrics)]


@contextlib.contextmanager
def csv_file(path: Path, columns: Sequence[str], metrics: Sequence[str]) -> Iterator[Callable[..., None]]:
    """Yield a function `append(values, result)` that writes the runs of a result to a CSV file.

    Numbers have seven digits; the store has all digits. One result at a time needs memory.

    Args:
        path: of the file, which is complete or absent.
        columns: names of the `values`, which come before the seed.
        metrics: the metrics that follow the seed.
    """
    with replacing(path) as beside, beside.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*columns, "seed", *metrics])

        def append(values: Sequence[Any], result: Result) -> None:
            text = io.StringIO()
            csv.writer(text, lineterminator="").writerow(values)
            known = set(result.cell.columns)
            form = ",".join(
                [text.getvalue().replace("%", "%%"), "%d", *("%.7g" if m in known else "" for m in metrics)]
            )
            numbers = operator.itemgetter(*(m for m in metrics if m in known))
            pairs = zip(result.cell.seeds, result.rows, strict=False)  # a failed cell has no rows
            file.writelines(form % (seed, *numbers(row)) + "\n" for seed, row in pairs)

        yield append


def write_csv(path: Path, results: Sequence[Result]) -> None:
    """Write all runs as CSV."""
    with csv_file(path, COLUMNS[:3], _columns(results)[4:]) as append:
        for result in results:
            task = result.cell.scenario
            append((result.cell.policy.name, task.name, f"{task.control_dt:.7g}"), result)


def query(
    results: Iterable[Result],
    sql: str,
    files: bool = False,
    looks: Mapping[tuple[str, str], int] | None = None,
    short: bool = False,
) -> str | None:
    """Return DuckDB's answer to a question about stored results as CSV; None for a command.

    A short answer is a table that fits into a terminal instead.

    The table `results` has each run of the current results once, with the columns of the CSV. The
    table `all_results` has every stored run, those of older code and other sets of seeds among
    them, and the columns `APART` too. A question is "SELECT policy, avg(error_pct) FROM results
    GROUP BY policy", a command "COPY results TO 'board.parquet'". With `files`, it may read and
    write files, and load extensions. The table `looks` counts the configurations of each policy
    that were run on each scenario for judging.
    """
    import duckdb
    import pandas as pd

    stored = list(results)
    keys = current_keys(stored)
    current = [_row(result, i) for result, i in current_runs(stored)]
    every = [
        {**_row(result, i), "key": result.cell.key, "current": result.cell.key in keys, "seeds": len(result.rows),
         "code": result.cell.policy.digest[:12], "time": result.provenance.get("time", "")}
        for result in stored for i in range(len(result.rows))
    ]  # fmt: skip
    columns = _columns(stored)
    connection = duckdb.connect()
    connection.register("results", pd.DataFrame.from_records(current, columns=columns))
    connection.register("all_results", pd.DataFrame.from_records(every, columns=[*columns, *APART]))
    counts = [(*names, number) for names, number in (looks or {}).items()]
    connection.register("looks", pd.DataFrame.from_records(counts, columns=["policy", "scenario", "looks"]))
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
        known = f"The table results has the columns {', '.join(columns)}; all_results has {', '.join(APART)} too"
        raise ValueError(f"{problem}\n{known}") from None
