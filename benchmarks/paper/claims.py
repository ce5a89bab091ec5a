"""All claims by name, in the paper's order, and their files."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from benchmarks.files import write_text
from benchmarks.paper import section_2, section_3, section_4
from benchmarks.paper.claim import Claim, judge, show
from benchmarks.report.markdown import table
from benchmarks.report.plot import Panel, plot_lines
from fbl_gym.records.checks import unknown

CLAIMS: dict[str, Claim] = {
    name.replace("_", "-"): claim
    for section in (section_2, section_3, section_4)
    for name, claim in vars(section).items()
    if isinstance(claim, Claim)
}

Measured: TypeAlias = dict[str, Any]
"""A measured claim: its texts, the values that the paper states and leaves open, and both verdicts.

`cases` has kind, values, measured value, seeds that meet the claim, and "yes" or "no" of each.
"""

SHORT = 2
"""Cases of a claim in the short form: the first values, and the most favourable ones."""


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


def measure_claim(name: str, cases: int | None = None) -> tuple[Measured, Callable[[Path], None] | None]:
    """Measure the first cases of one of `CLAIMS`; None: all of them.

    Return the measured claim, and a function that draws its picture to a file if there is one.
    """
    claim = CLAIMS[name]
    kinds, titles, values = zip(*claim.cases()[:cases], strict=True)
    outcomes = [claim.measure(each) for each in values]
    at_stated, at_best = judge(kinds, outcomes)
    readings = {value: " | ".join(map(str, each)) for value, each in claim.stated.items()}
    measured = {
        **claim.texts, "stated": show(readings), "chosen": show(claim.chosen), "at_stated": at_stated, "at_best": at_best,
        "cases": [[kind, title, *each.texts] for kind, title, each in zip(kinds, titles, outcomes, strict=True)],
    }  # fmt: skip
    lines = tuple(line for outcome in outcomes for line in outcome.lines)
    if not lines:
        return measured, None
    panel = Panel("", lines=lines, **claim.panel)
    return measured, lambda path: plot_lines(claim.texts["claim"], [panel], path)


def load(folder: Path) -> dict[str, Measured]:
    """Return the claims of a folder's `claims.json`, by name; none if the file does not exist."""
    path = folder / "claims.json"
    rows = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
    return {row.pop("name"): row for row in rows}


def save(folder: Path, claims: Mapping[str, Measured]) -> None:
    """Write claims, in the paper's order, to `claims.json` and `claims.md` in a folder."""
    claims = {name: claims[name] for name in CLAIMS if name in claims}
    rows = [{"name": name, **claim} for name, claim in claims.items()]
    write_text(folder / "claims.json", json.dumps(rows, indent=1, ensure_ascii=False) + "\n")
    write_text(folder / "claims.md", page(claims))


def page(claims: Mapping[str, Measured]) -> str:
    """Return a table of claims and their verdicts in Markdown, and a section on each."""
    header = ("figure", "claim", "paper", "at stated values", "at the most favourable open values", "details")
    columns = ("figure", "claim", "paper", "at_stated", "at_best")
    rows = [(*(c[column] for column in columns), f"[{name}](#{name})") for name, c in claims.items()]
    sections = [table(header, rows)]
    for name, c in claims.items():
        sections.append(f"\n### {name}\n\n{c['claim']} (the paper: {c['paper']}).\n\n- Bound: {c['bound']}\n")
        sections.append(f"- Stated: {c['stated'] or '–'}\n- Open: {c['chosen'] or '–'}\n- Scenario: {c['scenario']}\n")
        verdicts = f"*{c['at_stated']}*; at the most favourable open ones: *{c['at_best']}*"
        sections.append(f"- Verdict at stated values: {verdicts}\n\n")
        sections.append(table(("kind", "case", "measured", "seeds that meet it", "holds"), c["cases"]))
    return "".join(sections)
