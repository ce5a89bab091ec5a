"""All claims by name, in the paper's order, and their files."""

import dataclasses
import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from benchmarks.files import write_text
from benchmarks.paper import adaptive, leakage, robust
from benchmarks.paper.claim import Claim, Effort, Measured
from benchmarks.paper.radius import adaptive_radius, robust_radius
from benchmarks.report import markdown
from fbl_gym.checks import unknown

CLAIMS: dict[str, Callable[[Effort], Measured]] = {
    "figure-2": leakage.figure_2,
    "leakage-of-parameters": leakage.leakage_of_parameters,
    "leakage-of-disturbance": leakage.leakage_of_disturbance,
    "figure-3a": leakage.figure_3a,
    "figure-3a-as-printed": leakage.figure_3a_as_printed,
    "figure-3b": leakage.figure_3b,
    "equation-10": robust.equation_10,
    "figure-4a": robust.figure_4a,
    "figure-4b-filter": robust.figure_4b_filter,
    "figure-4b-error": robust.figure_4b_error,
    "figure-4b-settling": robust.figure_4b_settling,
    "kalman-filter": robust.kalman_filter,
    "robust-radius": robust_radius,
    "equation-22": adaptive.equation_22,
    "figure-5": adaptive.figure_5,
    "figure-6a": adaptive.figure_6a,
    "figure-6b": adaptive.figure_6b,
    "estimation-under-noise": adaptive.estimation_under_noise,
    "adaptive-radius": adaptive_radius,
    "figure-7": adaptive.figure_7,
    "figure-8": adaptive.figure_8,
    "leakage-of-stiction": leakage.leakage_of_stiction,
    "figure-9": adaptive.figure_9,
    "soft-scheduling": adaptive.soft_scheduling,
    "figure-10": adaptive.figure_10,
    "figure-10-with-noise": adaptive.figure_10_with_noise,
}


def listed() -> dict[str, str]:
    """Return one line on each claim, by name: the summary of its function without the verb."""
    summaries = {name: inspect.getdoc(f) or "" for name, f in CLAIMS.items()}
    return {name: text.partition("\n")[0].removeprefix("Measure ") for name, text in summaries.items()}


def select(names: Sequence[str]) -> list[str]:
    """Return the names of the selected claims, in the paper's order; without names, all.

    A name may be the beginning of others, such as "figure-4b" for all "figure-4b-...".
    """
    chosen: set[str] = set()
    for name in names:
        matches = [name] if name in CLAIMS else [claim for claim in CLAIMS if claim.startswith(f"{name}-")]
        if not matches:
            raise ValueError(f"{unknown('claim', name, CLAIMS)}; all of them: fbl-gym list claims")
        chosen.update(matches)
    return [name for name in CLAIMS if name in chosen or not names]


def measure_claim(name: str, effort: Effort) -> Measured:
    """Measure one of `CLAIMS`; return it and the function that draws its figure."""
    claim, draw = CLAIMS[name](effort)
    return dataclasses.replace(claim, command=f"fbl-gym reproduce --only {name}"), draw


def load(folder: Path) -> dict[str, Claim]:
    """Return the claims of a folder's `claims.json`, by name; none if the file does not exist."""
    path = folder / "claims.json"
    if not path.exists():
        return {}
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        claims = {row.pop("name"): Claim(**row | {"cases": tuple(map(tuple, row["cases"]))}) for row in rows}
        if not claims.keys() <= CLAIMS.keys():
            raise ValueError(f"no claim is named {min(claims.keys() - CLAIMS.keys())!r}")
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        raise ValueError(
            f"{path} is damaged, or not from `fbl-gym reproduce` ({problem}); move it away, or give another --out"
        ) from None
    return claims


def save(folder: Path, claims: Mapping[str, Claim]) -> None:
    """Write claims, in the paper's order, to `claims.json` and `claims.md` in a folder."""
    claims = {name: claims[name] for name in CLAIMS if name in claims}
    rows = [{"name": name, **dataclasses.asdict(claim)} for name, claim in claims.items()]
    write_text(folder / "claims.json", json.dumps(rows, indent=1, ensure_ascii=False) + "\n")
    write_text(folder / "claims.md", markdown.claims(claims))
