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

#: NumPy and its linear algebra round otherwise on other processors. A number that differs by less
#: than this share of itself, or by less than 1e-9, differs by rounding.
ROUNDING = 1e-4


def run(arguments: argparse.Namespace) -> int:
    store, differs = Store(arguments.store), False
    for published in (result for row in arguments.rows for result in _find(store, row)):
        name = dataclasses.replace(published.cell.policy.parsed, trusted=arguments.trust)
        cell = dataclasses.replace(published.cell, policy=resolve(name))
        holds, verdict = compare(published, now := run_cell(cell))
        if not holds and not now.error:
            promise = cell.policy.call(broken, cell.policy, cell.scenario)
            verdict += f"; the policy {promise or 'keeps every promise that check-policy checks'}"
        differs |= not holds
        say(f"{published.cell.id}, {len(published.rows)} seeds: {verdict}")
    return int(differs)


def _find(store: Store, row: str) -> list[Result]:
    if Path(row).is_file():
        return [store.load(Path(row))]
    results = list(store.results())
    if same := [result for result in results if result.cell.id == row]:
        return same
    raise unknown(f"row of {store.folder}", row, {result.cell.id for result in results})


def compare(published: Result, now: Result) -> tuple[bool, str]:
    """Return whether a published result holds, and how far it differs, in words."""
    if now.error or published.error:
        same, failed = now.error == published.error, now.error or published.error
        return same, f"{'holds' if same else 'DIFFERS'}: it fails{'' if now.error else ' no more'}: {failed}"
    before, after = (np.array([[row[name] for name in METRICS] for row in result.rows]) for result in (published, now))
    if np.array_equal(before, after, equal_nan=True):
        return True, "holds, bit for bit"
    gap = np.where(np.isnan(before) & np.isnan(after), 0.0, np.abs(before - after))
    gap = np.nan_to_num(gap, nan=np.inf)  # where the metric applies to one of the two only
    times = gap / (ROUNDING * np.abs(np.nan_to_num(before)) + 1e-9)  # what rounding explains
    worst = int(times.max(axis=0).argmax())
    far = f"{[*METRICS][worst]} by up to {gap[:, worst].max():.3g}"
    if not (runs := int((times > 1.0).any(axis=1).sum())):
        return True, f"holds but for rounding, as on another processor: {far}"
    texts = [f"DIFFERS in {runs} of {len(gap)} runs: {far}"]
    if published.cell.key != now.cell.key:
        texts.append("the code or the gains of the policy changed since")
    old, new = published.provenance.get("packages", {}), provenance("", published.cell.packages)["packages"]
    changed = [f"{package} {old.get(package)} -> {new[package]}" for package in new if old.get(package) != new[package]]
    return False, "; ".join([*texts, *([", ".join(changed)] if changed else [])])
