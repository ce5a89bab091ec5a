"""All claims by name, in the paper's order, and their files."""

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from benchmarks.files import write_text
from benchmarks.paper import section_2, section_3, section_4
from benchmarks.paper.claim import Claim, Declared, Effort, judge
from benchmarks.report import markdown
from benchmarks.report.plot import plot_lines, plot_trace
from benchmarks.run.rollout import Trace
from fbl_gym.checks import unknown

CLAIMS: dict[str, Declared] = {
    name.replace("_", "-"): claim
    for section in (section_2, section_3, section_4)
    for name, claim in vars(section).items()
    if isinstance(claim, Declared)
}


def listed() -> dict[str, str]:
    """Return one line on each claim, by name."""
    return {name: claim.fields["claim"] for name, claim in CLAIMS.items()}


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


def measure_claim(name: str, effort: Effort) -> tuple[Claim, Callable[[Path], None]]:
    """Measure one of `CLAIMS`; return it and a function that draws its figure to a file."""
    fields, measure = CLAIMS[name]
    cases, measured, title, drawn, seeds = measure(effort)
    verdict, holds = judge(cases)
    seed, command = "0" if seeds == 1 else f"0-{seeds - 1}", f"fbl-gym reproduce --only {name}"
    rows = tuple(case.row for case in cases)

    def draw(path: Path) -> None:
        if isinstance(drawn, Trace):
            plot_trace(drawn, title, path)
        else:
            plot_lines(title, drawn, path)

    claim = Claim(
        measured=measured, verdict=verdict, holds=holds, seed=seed, cases=rows, command=command, **fields
    )  # fmt: skip
    return claim, draw


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
