"""Every claim by name, in the paper's order."""

from __future__ import annotations

import dataclasses
import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from benchmarks.paper import adaptive, leakage, robust
from benchmarks.paper.claim import ARMS, Claim, Effort, Measured
from benchmarks.paper.radius import adaptive_radius, robust_radius
from benchmarks.report import markdown
from benchmarks.run.store import write_text
from fbl_gym.checks import unknown


def _on_both_arms(name: str, function: Callable[..., Measured]) -> dict[str, Callable[[Effort], Measured]]:
    return {f"{name}-{arm}": partial(function, arm=arm) for arm in ARMS}


CLAIMS: dict[str, Callable[[Effort], Measured]] = {
    **_on_both_arms("figure-2", leakage.figure_2),
    "leakage-of-parameters": leakage.leakage_parameters,
    "leakage-of-disturbance": leakage.leakage_disturbance,
    **_on_both_arms("figure-3a", leakage.figure_3a),
    "figure-3a-as-printed": leakage.figure_3a_as_printed,
    **_on_both_arms("figure-3b", leakage.figure_3b),
    "equation-10": robust.error_dynamics,
    **_on_both_arms("figure-4a", robust.figure_4a),
    **_on_both_arms("figure-4b-filter", robust.figure_4_filter),
    **_on_both_arms("figure-4b-error", robust.figure_4b_error),
    **_on_both_arms("figure-4b-settling", robust.figure_4b_settling),
    "noise-of-1-db": robust.one_decibel,
    **_on_both_arms("robust-radius", robust_radius),
    "figure-6a": adaptive.figure_6a,
    "figure-6b": adaptive.figure_6b,
    "figure-6b-at-1-khz": adaptive.figure_6b_slow,
    "estimation-under-noise": adaptive.least_squares,
    **_on_both_arms("adaptive-radius", adaptive_radius),
    "figure-7": adaptive.figure_7,
    **_on_both_arms("figure-8", adaptive.figure_8),
    "leakage-of-stiction": leakage.leakage_stiction,
    "figure-9": adaptive.figure_9,
    "figure-10": adaptive.figure_10,
    "figure-10-with-noise": adaptive.figure_10_noise,
}


def listed() -> dict[str, str]:
    """Every claim's name, with a line on what is measured."""
    return {name: (inspect.getdoc(getattr(f, "func", f)) or "").partition("\n")[0] for name, f in CLAIMS.items()}


def select(names: Sequence[str]) -> list[str]:
    """The claims meant, in the paper's order; an error if a name means none.

    Args:
        names: of claims, or their beginnings, such as "figure-4b" for all "figure-4b-..."; empty: all claims.
    """
    chosen: set[str] = set()
    for name in names:
        meant = [name] if name in CLAIMS else [claim for claim in CLAIMS if claim.startswith(f"{name}-")]
        if not meant:
            raise ValueError(f"{unknown('claim', name, CLAIMS)}; all of them: fbl-gym list claims")
        chosen.update(meant)
    return [name for name in CLAIMS if name in chosen or not names]


def measure_claim(name: str, effort: Effort) -> Measured:
    """What became of a claim, and what draws its figure.  name: one of `CLAIMS`."""
    claim, draw = CLAIMS[name](effort)
    return dataclasses.replace(claim, command=f"fbl-gym reproduce --only {name}"), draw


def load(folder: Path) -> dict[str, Claim]:
    """The claims that an earlier run left in `folder`, by name; none if there is no `claims.json`."""
    path = folder / "claims.json"
    if not path.exists():
        return {}
    try:
        found = {row.pop("name"): Claim(**row) for row in json.loads(path.read_text(encoding="utf-8"))}
        if not found.keys() <= CLAIMS.keys():
            raise ValueError(f"no claim is named {min(found.keys() - CLAIMS.keys())!r}")
        if not all(isinstance(text, str) for claim in found.values() for text in vars(claim).values()):
            raise ValueError("what is said of a claim must be text")
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        raise ValueError(
            f"{path} is damaged, or not from `fbl-gym reproduce` ({problem}); move it away, or give another --out"
        ) from None
    return found


def save(folder: Path, found: Mapping[str, Claim]) -> None:
    """Write claims by name, in the paper's order, with their verdicts, to `claims.json` and `claims.md` in `folder`."""
    found = {name: found[name] for name in CLAIMS if name in found}
    rows = [{"name": name, **dataclasses.asdict(claim)} for name, claim in found.items()]
    write_text(folder / "claims.json", json.dumps(rows, indent=1, ensure_ascii=False) + "\n")
    write_text(folder / "claims.md", markdown.claims(found.values()))
