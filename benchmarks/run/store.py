"""Results on disk: a folder with one file for each finished cell.

A file's name says what was run and ends in the cell's key, a hash of all that the result depends
on. A file is written under a temporary name and then renamed, so it is complete or absent. A result
that is there is not computed again.

The checksum in a file finds damage. It is no signature: whoever writes a file can compute it, and
`fbl-gym verify` runs a result again.
"""

import datetime
import json
import math
import os
import platform
import re
import uuid
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.files import write_text
from benchmarks.policies.key import PINNED, data_digest
from benchmarks.policies.spec import PolicySpec
from benchmarks.run.cell import Cell, versions
from benchmarks.run.metrics import METRICS
from benchmarks.text import visible
from fbl_gym.reading import read_bytes

#: Layout of a result's file.
#:
#: The names in METRICS are part of the layout. Files of another layout are left alone and not read.
FORMAT = 6


class Damaged(ValueError):
    """A file of the store that is not as it was written, or belongs elsewhere."""


class OtherFormat(Damaged):
    """A file of the store that another version of fbl-gym wrote."""


@dataclass(frozen=True)
class Result:
    """The outcome of a cell.

    Args:
        cell: the cell.
        rows: the metrics of each seed, in the seeds' order; empty where the cell failed.
        decision_us: the policy's wall time for one decision of one lane [us].
        error: why the cell failed; empty: it did not.
        provenance: packages, machine, command and time, as plain data.
    """

    cell: Cell
    rows: tuple[dict[str, float], ...]
    decision_us: float
    error: str = ""
    provenance: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def failure(cls, cell: Cell, error: str, command: str = "") -> "Result":
        """Return the result of a cell that failed."""
        return cls(cell, (), math.nan, error, provenance(command))


def provenance(command: str, packages: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return Python, machine, time, the command that was typed, and the versions of packages."""
    return {
        "command": command,
        "python": platform.python_version(),
        "packages": versions(("fbl-gym", *PINNED, *packages)),
        "machine": f"{platform.node()}, {platform.machine()} {platform.system()}, {os.cpu_count()} cores",
        "time": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


@dataclass(frozen=True)
class Store:
    """A folder of results, shared by any number of processes; it is created with its first file."""

    folder: Path

    def __post_init__(self) -> None:
        folder = self.folder.absolute()
        first = next(path for path in (folder, *folder.parents) if os.path.lexists(path))
        if not first.is_dir():
            raise ValueError(f"store must be a folder, or the path of a new one, got {self.folder}: {first} is a file")

    def path(self, cell: Cell) -> Path:
        """Return the file of a cell's result."""
        name = re.sub(r"[^\w@.-]+", "_", f"{cell.policy.name}--{cell.scenario.name}")[-120:]
        # File systems count the bytes of a name, 255 at most.
        name = name.encode(errors="replace")[-180:].decode(errors="ignore").lstrip(".")  # hidden files are not read
        return self.folder / f"{name}--{cell.key}.json"

    def save(self, result: Result) -> Path:
        """Write a result into its file. A failed one does not count as finished."""
        path = self.path(result.cell)
        failed = path.with_suffix(".error")
        for place in (path, failed):
            if place.is_dir() and not place.is_symlink():  # no file can replace a folder
                place.rename(place.with_suffix(f".moved-{uuid.uuid4().hex}"))
        text = json.dumps(_document(result), separators=(",", ":"), allow_nan=False) + "\n"
        write_text(failed if result.error else path, text)
        if not result.error:
            failed.unlink(missing_ok=True)
        return path

    def find(self, cell: Cell) -> Result | None:
        """Return the result of a cell, or None; a damaged one has a warning."""
        return self._read(self.path(cell), cell)

    def find_any(self, cell: Cell) -> Result | None:
        """Return the result of a cell, also one that failed when it last ran, or None."""
        return self.find(cell) or self._read(self.path(cell).with_suffix(".error"), cell)

    def results(self) -> Iterator[Result]:
        """Yield every result, in the order of the files' names; a damaged one has a warning."""
        yield from filter(None, map(self._read, self.files()))

    def files(self) -> list[Path]:
        """Return the files of the results, sorted."""
        return sorted(path for path in self.folder.glob("*--*.json") if not path.name.startswith("."))

    def _read(self, path: Path, cell: Cell | None = None) -> Result | None:
        """Return the result in a file; None if it is absent, of another format, or damaged."""
        try:
            result = self.load(path, cell)
            if (right := self.path(result.cell)).stem != path.stem:
                raise Damaged(f"{path} is damaged (it holds the result {right.name})")
            return result
        except (FileNotFoundError, OtherFormat):
            return None
        except Damaged as problem:
            warnings.warn(visible(f"{problem}; `fbl-gym leaderboard` computes its cell again"), stacklevel=3)
            return None

    def load(self, path: Path, cell: Cell | None = None) -> Result:
        """Return the result in a file of a store, or in a copy of one.

        Args:
            path: of the file.
            cell: of the result; None: the one that the file describes.

        Raises:
            OtherFormat: another version of fbl-gym wrote the file.
            Damaged: the file is not as it was written.
        """
        try:
            document = json.loads(read_bytes(path))
            if document.get("format") != FORMAT:
                raise OtherFormat(f"{path} has format {document.get('format')}, this version reads {FORMAT}")
            if document.pop("sha256") != data_digest(document):
                raise ValueError("its checksum is wrong")
            if cell is None:
                policy = PolicySpec.from_dict(document["policy"])
                cell = Cell(policy, document["scenario"], tuple(document["seeds"]))
            old = document["provenance"].get("packages", {})
            if changed := [f"{x} {old[x]}" for x, now in versions(cell.packages).items() if old.get(x, now) != now]:
                raise OtherFormat(f"{path} was computed with {', '.join(changed)}, which is not installed")
            if cell.key != document["key"]:
                raise ValueError(f"it holds the result {document['id']} with the key {document['key']}, not {cell.key}")
            columns = document["rows"]
            if others := ", ".join(sorted(set(columns) ^ set(METRICS))):
                raise OtherFormat(f"{path} has other metrics than this version of fbl-gym (they differ in {others})")
            error = str(document["error"])
            numbers = [map(_number, columns[name]) for name in METRICS]
            rows = tuple(dict(zip(METRICS, row, strict=True)) for row in zip(*numbers, strict=True))
            if len(rows) != (0 if error else len(cell.seeds)):
                raise ValueError(f"it has {len(rows)} rows for {len(cell.seeds)} seeds")
            return Result(cell, rows, _number(document["decision_us"]), error, {**document["provenance"]})
        except (OtherFormat, FileNotFoundError, MemoryError):
            raise
        except Exception as problem:  # the file may hold anything
            raise Damaged(f"{path} is damaged ({problem})") from None


def _document(result: Result) -> dict[str, Any]:
    cell = result.cell
    document = {
        "format": FORMAT,
        "id": cell.id,
        "key": cell.key,
        "policy": cell.policy.to_dict(),
        "scenario": cell.scenario.to_dict(),
        "seeds": list(cell.seeds),
        "rows": {name: [_json(row[name]) for row in result.rows] for name in METRICS},
        "decision_us": _json(result.decision_us),
        "error": result.error,
        "provenance": result.provenance,
    }
    return {**document, "sha256": data_digest(document)}


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _json(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
