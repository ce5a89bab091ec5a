"""`fbl-gym verify`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.cli.common import add_store
from benchmarks.policies import resolve
from benchmarks.run.metrics import METRICS
from benchmarks.run.runner import run_cell
from benchmarks.run.store import Result, Store, provenance
from fbl_gym.checks import unknown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("rows", nargs="+", metavar="ROW", help="a policy/scenario of the store, or a file of a result")
    parser.add_argument("--trust", action="store_true", help="load archives of stable-baselines3, which run their code")
    add_store(parser)


def run(arguments: argparse.Namespace) -> int:
    store = Store(arguments.store)
    differs = 0
    for row in arguments.rows:
        for published in _find(store, row):
            if arguments.trust:
                resolve.trust(published.cell.policy)
            told = compare(published, run_cell(published.cell))
            differs += bool(told)
            print(f"{published.cell.id}, {len(published.rows)} seeds: {told or 'holds, bit for bit'}")
    return 1 if differs else 0


def _find(store: Store, row: str) -> list[Result]:
    if Path(row).is_file():
        return [store.load(Path(row))]
    found = list(store.results())
    if not found:
        raise ValueError(f"there are no results in {store.folder}")
    mine = [result for result in found if result.cell.id == row]
    if not mine:
        raise unknown("row", row, sorted({result.cell.id for result in found}))
    return mine


def compare(published: Result, now: Result) -> str:
    """In what a result differs from a published one; empty: in nothing."""
    if now.error:
        return f"DIFFERS: it failed now: {now.error}"
    before, after = ([[row[name] for name in METRICS] for row in result.rows] for result in (published, now))
    if np.array_equal(before, after, equal_nan=True):
        return ""
    # Where a metric applied to one of the two only, it differs by any measure; where to neither, by nothing.
    apart = np.abs(np.subtract(before, after))
    apart = np.where(np.isnan(apart), np.where(np.isnan(before) & np.isnan(after), 0.0, np.inf), apart)
    worst = apart.max(axis=0)
    name = max(METRICS, key=lambda m: worst[list(METRICS).index(m)])
    text = f"DIFFERS: {name} by up to {worst[list(METRICS).index(name)]:.3g}"
    if published.identity != now.identity:
        text += "; the policy, the scenario or the results' version changed since"
    old, new = published.provenance.get("packages", {}), provenance("")["packages"]
    changed = [f"{package} {old.get(package)} -> {new[package]}" for package in new if old.get(package) != new[package]]
    return text + ("; " + ", ".join(changed) if changed else "")
