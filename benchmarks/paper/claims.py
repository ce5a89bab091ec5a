"""All claims by name, in the paper's order, and their files."""

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from benchmarks.files import write_text
from benchmarks.paper import section_2, section_3, section_4
from benchmarks.paper.claim import Claim, Declared, Effort, judge
from benchmarks.report.markdown import table
from fbl_gym.checks import unknown

CLAIMS: dict[str, Declared] = {
    name.replace("_", "-"): claim
    for section in (section_2, section_3, section_4)
    for name, claim in vars(section).items()
    if isinstance(claim, Declared)
}


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
    finding = measure(effort)
    verdict, holds = judge(finding.cases)
    claim = Claim(
        measured=finding.measured, verdict=verdict, holds=holds, cases=tuple(case.row for case in finding.cases),
        seed="0" if finding.seeds == 1 else f"0-{finding.seeds - 1}", command=f"fbl-gym reproduce --only {name}", **fields,
    )  # fmt: skip
    return claim, finding.draw


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
    write_text(folder / "claims.md", page(claims))


def page(claims: Mapping[str, Claim]) -> str:
    """Return a table of claims and their verdicts in Markdown, and a section on each."""
    header = ("figure", "claim", "paper", "verdict", "holds in cases", "details")
    rows = [(c.figure, c.claim, c.paper, c.verdict, c.holds, f"[{name}](#{name})") for name, c in claims.items()]
    sections = [table(header, rows)]
    for name, c in claims.items():
        sections.append(f"\n### {name}\n\n{c.claim} ({c.paper}): *{c.verdict}*. Measured: {c.measured}.\n\n")
        sections.append(f"Measured with: {c.assumptions}. Scenario `{c.scenario}`, seeds {c.seed}.\n")
        if len(c.cases) > 1:
            sections.append("\n" + table(("case", "measured", "seeds that meet it", "holds"), c.cases))
    return "".join(sections)
