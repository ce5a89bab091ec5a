"""Results on disk: one CSV row per policy, scenario and seed, and a JSON file that says how they came about."""

from __future__ import annotations

import csv
import json
import os
import platform
import sys
from collections.abc import Sequence
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any

from benchmarks.metrics import METRICS, summarize
from benchmarks.paper import Claim
from benchmarks.runner import Result

PACKAGES = ("fbl-gym", "gymnasium", "numpy", "scipy", "numba")
COLUMNS = ("policy", "scenario", "seed", *METRICS)


def write(folder: Path, results: Sequence[Result], command: str) -> None:
    """Write `leaderboard.csv` and `leaderboard.json` into `folder`, each beside its name and then renamed into place."""
    folder.mkdir(parents=True, exist_ok=True)
    _replace(folder / "leaderboard.csv", _csv(results))
    _replace(folder / "leaderboard.json", json.dumps(_document(results, command), indent=1, allow_nan=False) + "\n")


def _replace(path: Path, text: str) -> None:
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def _csv(results: Sequence[Result]) -> str:
    lines: list[str] = []
    writer = csv.DictWriter(_Lines(lines), COLUMNS, lineterminator="\n")
    writer.writeheader()
    for result in results:
        for seed, row in zip(result.cell.seeds, result.rows, strict=False):
            writer.writerow({"policy": result.cell.policy, "scenario": result.cell.scenario, "seed": seed, **row})
    return "".join(lines)


class _Lines:
    def __init__(self, lines: list[str]) -> None:
        self.write = lines.append


def _document(results: Sequence[Result], command: str) -> dict[str, Any]:
    return {
        "command": command,
        "python": platform.python_version(),
        "packages": {name: metadata.version(name) for name in PACKAGES},
        "machine": f"{platform.machine()} {platform.system()}, {os.cpu_count()} cores",
        "metrics": METRICS,
        "cells": [
            {
                "id": result.cell.id,
                "policy": result.cell.policy,
                "scenario": result.cell.scenario,
                "seeds": list(result.cell.seeds),
                "mean": _plain(summarize(list(result.rows))) if result.rows else None,
                "decision_us": None if result.error else result.decision_us,
                "wall_s": result.wall_s,
                "error": result.error or None,
            }
            for result in results
        ],
    }


def _plain(summary: dict[str, float]) -> dict[str, float | None]:
    return {name: None if value != value else value for name, value in summary.items()}


def write_claims(folder: Path, claims: Sequence[Claim]) -> None:
    """Write the claims of the paper and their verdicts to `claims.json` in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    _replace(
        folder / "claims.json", json.dumps([asdict(claim) for claim in claims], indent=1, ensure_ascii=False) + "\n"
    )


def command_line() -> str:
    """The command that this process was started with, as one could type it."""
    return " ".join(["fbl-gym", *sys.argv[1:]])
