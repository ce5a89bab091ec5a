"""Results on disk: a folder with one file for each finished cell.

A file's name says what was run and ends in a hash of all that the result depends on. It is written beside its place and
renamed into it, so it is there whole or not at all, on a cluster's shared file system too; and whoever finds it need not run
the cell again.
"""

from __future__ import annotations

import datetime
import hashlib
import json
import math
import os
import platform
import re
import uuid
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from benchmarks.policies import resolve
from benchmarks.run.metrics import METRICS
from benchmarks.run.rollout import make_env
from benchmarks.run.suite import Cell

VERSION = 2
"""Raised when the same cell gives other numbers than before: results of older versions are then computed anew."""

PACKAGES = ("fbl-gym", "gymnasium", "numpy", "scipy", "numba")


class Damaged(ValueError):
    """A file of the store that is not what was written."""


@dataclass(frozen=True)
class Result:
    """What a cell gave.

    Args:
        cell: which one.
        rows: the metrics of each seed, in the seeds' order; empty where it failed.
        decision_us: the policy's wall time for one decision of one lane [us].
        wall_s: time that the cell took [s].
        error: what went wrong; empty: nothing.
        identity: all that the numbers depend on, as plain data; see `identity`.
        provenance: packages, machine, command and time, as plain data.
    """

    cell: Cell
    rows: tuple[dict[str, float], ...]
    decision_us: float
    wall_s: float
    error: str = ""
    identity: dict[str, Any] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)


def identity(cell: Cell) -> dict[str, Any]:
    """All that a cell's numbers depend on, as plain data.  cell: its policy is made for this, so its errors come through."""
    made = resolve.make(cell.policy, make_env(cell.policy, cell.scenario, 1))
    scenario = cell.scenario.to_dict()
    del scenario["description"]
    return {
        "policy": "joined" if resolve.foreign(cell.policy) else cell.policy,
        "configuration": _plain(resolve.configuration(cell.policy, made)),
        "scenario": scenario,
        "seeds": list(cell.seeds),
        "version": VERSION,
    }


def key(identity: dict[str, Any]) -> str:
    """A hash, 20 hexadecimal digits.  identity: from `identity`."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:20]


def _plain(value: Any) -> Any:
    return json.loads(json.dumps(value, default=str))


def provenance(command: str) -> dict[str, Any]:
    """Where and how a result came about: packages, Python, machine, time.  command: the line that was typed."""
    return {
        "command": command,
        "python": platform.python_version(),
        "packages": {name: metadata.version(name) for name in PACKAGES},
        "machine": f"{platform.node()}, {platform.machine()} {platform.system()}, {os.cpu_count()} cores",
        "time": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
    }


@dataclass(frozen=True)
class Store:
    """A folder of results, shared by any number of processes.

    Args:
        folder: made when something is first written.
    """

    folder: Path

    def path(self, cell: Cell, identity: dict[str, Any]) -> Path:
        """Where the result of a cell belongs.  cell: which; identity: from `identity(cell)`."""
        name = re.sub(r"[^\w@.-]+", "_", f"{cell.policy}--{cell.scenario.name}")[-120:]
        return self.folder / f"{name}--{key(identity)}.json"

    def save(self, result: Result) -> Path:
        """Write a result into its place, whole or not at all.  result: a failed one does not count as finished."""
        path = self.path(result.cell, result.identity)
        failed = path.with_suffix(".error")
        _write(failed if result.error else path, _document(result))
        if not result.error:
            failed.unlink(missing_ok=True)
        return path

    def find(self, cell: Cell) -> Result | None:
        """The result of a cell, if there is one.  cell: which."""
        path = self.path(cell, identity(cell))
        return self.load(path) if path.exists() else None

    def load(self, path: Path) -> Result:
        """The result in a file.  path: one of `files()`, or a copy.

        Raises:
            Damaged: if the file is not what was written.
        """
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            if document.pop("sha256") != _digest(document):
                raise ValueError("its checksum is wrong")
            cell = document["cell"]
            names, columns = list(METRICS), document["rows"]
            rows = [
                {name: math.nan if (value := columns[name][i]) is None else value for name in names}
                for i in range(len(columns["error_pct"]))
            ]
            return Result(
                Cell(cell["policy"], cell["scenario"], tuple(cell["seeds"])), tuple(rows),
                math.nan if document["decision_us"] is None else document["decision_us"], document["wall_s"],
                document["error"], document["identity"], document["provenance"],
            )  # fmt: skip
        except (ValueError, KeyError, TypeError) as problem:
            raise Damaged(f"{path} is damaged ({problem}); delete it, and its cell is computed again") from None

    def results(self, failed: bool = False) -> Iterator[Result]:
        """Every result, in the order of the files' names.  failed: True: those that failed too.

        Raises:
            Damaged: at a file that is not what was written; the others can still be read.
        """
        for path in self.files(failed):
            yield self.load(path)

    def files(self, failed: bool = False) -> list[Path]:
        """The files of the results, sorted.  failed: True: of those that failed too."""
        found = [*self.folder.glob("*.json"), *(self.folder.glob("*.error") if failed else ())]
        return sorted(path for path in found if "--" in path.name and not path.name.startswith("."))


def _document(result: Result) -> dict[str, Any]:
    rows = {name: [_json(row[name]) for row in result.rows] for name in METRICS}
    document = {
        "id": result.cell.id,
        "cell": {
            "policy": result.cell.policy,
            "scenario": result.cell.scenario.to_dict(),
            "seeds": list(result.cell.seeds),
        },
        "rows": rows,
        "decision_us": _json(result.decision_us),
        "wall_s": result.wall_s,
        "error": result.error,
        "identity": result.identity,
        "provenance": result.provenance,
    }
    return {**document, "sha256": _digest(document)}


def _json(value: float) -> float | None:
    return None if math.isnan(value) else float(value)


def _digest(document: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _write(path: Path, document: dict[str, Any]) -> None:
    write_text(path, json.dumps(document, indent=None, separators=(",", ":"), allow_nan=False) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all: beside its place, flushed to the disk, and renamed into it.

    Args:
        path: of the file; its folder is made.
        text: all of it, written as UTF-8.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name[:80]}.{uuid.uuid4().hex}")
    try:
        with beside.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
