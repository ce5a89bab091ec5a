"""The command `fbl-gym verify`."""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from benchmarks.policies.spec import resolve
from benchmarks.run.contract import broken
from benchmarks.run.metrics import METRICS
from benchmarks.run.runner import run_cell
from benchmarks.run.store import Result, Store, provenance
from benchmarks.text import say
from fbl_gym.records.checks import unknown


def run(arguments: argparse.Namespace) -> int:
    store, differs = Store(arguments.store), False
    for published in (result for row in arguments.rows for result in _find(store, row)):
        name = dataclasses.replace(published.cell.policy.parsed, trusted=arguments.trust)
        cell = dataclasses.replace(published.cell, policy=resolve(name))
        difference = compare(published, now := run_cell(cell))
        if difference and not now.error:
            promise = cell.policy.call(broken, cell.policy, cell.scenario)
            difference += f"; the policy {promise or 'keeps every promise that check-policy checks'}"
        differs |= bool(difference)
        say(f"{published.cell.id}, {len(published.rows)} seeds: {difference or 'holds, bit for bit'}")
    return int(differs)


def _find(store: Store, row: str) -> list[Result]:
    if Path(row).is_file():
        return [store.load(Path(row))]
    results = list(store.results())
    if same := [result for result in results if result.cell.id == row]:
        return same
    raise unknown(f"row of {store.folder}", row, {result.cell.id for result in results})


def compare(published: Result, now: Result) -> str:
    """Return the difference of a result from a published one in words; empty: there is none."""
    if now.error:
        return f"DIFFERS: it fails now: {now.error}"
    before, after = (np.array([[row[name] for name in METRICS] for row in result.rows]) for result in (published, now))
    if np.array_equal(before, after, equal_nan=True):
        return ""
    gap = np.where(np.isnan(before) & np.isnan(after), 0.0, np.abs(before - after))
    worst = np.nan_to_num(gap, nan=np.inf).max(axis=0)  # infinite where the metric applies to one of the two only
    texts = [f"DIFFERS: {[*METRICS][int(worst.argmax())]} by up to {worst.max():.3g}"]
    if published.cell.key != now.cell.key:
        texts.append("the code or the gains of the policy changed since")
    old, new = published.provenance.get("packages", {}), provenance("", published.cell.packages)["packages"]
    changed = [f"{package} {old.get(package)} -> {new[package]}" for package in new if old.get(package) != new[package]]
    return "; ".join([*texts, *([", ".join(changed)] if changed else [])])
