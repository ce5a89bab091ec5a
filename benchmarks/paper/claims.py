"""All claims by name, in the paper's order, and their files."""

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from benchmarks.files import write_text
from benchmarks.paper import section_2, section_3, section_4
from benchmarks.paper.claim import Claim, Declared, judge, show
from benchmarks.report.markdown import table
from benchmarks.report.plot import Panel, plot_lines
from fbl_gym.checks import unknown

CLAIMS: dict[str, Declared] = {
    name.replace("_", "-"): claim
    for section in (section_2, section_3, section_4)
    for name, claim in vars(section).items()
    if isinstance(claim, Declared)
}

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


def measure_claim(name: str, cases: int | None = None) -> tuple[Claim, Callable[[Path], None] | None]:
    """Measure the first cases of one of `CLAIMS`; None: all of them.

    Return the claim, and a function that draws its picture to a file if there is one.
    """
    declared = CLAIMS[name]
    kinds, titles, values = zip(*declared.cases()[:cases], strict=True)
    outcomes = [declared.measure(each) for each in values]
    at_stated, at_best = judge(kinds, outcomes)
    readings = {value: " | ".join(map(str, each)) for value, each in declared.stated.items()}
    claim = Claim(
        stated=show(readings), chosen=show(declared.chosen), at_stated=at_stated, at_best=at_best,
        cases=tuple((kind, title, *each.texts) for kind, title, each in zip(kinds, titles, outcomes, strict=True)),
        **declared.texts,
    )  # fmt: skip
    lines = tuple(line for outcome in outcomes for line in outcome.lines)
    if not lines:
        return claim, None
    panel = Panel("", lines=lines, **declared.panel)
    return claim, lambda path: plot_lines(claim.claim, [panel], path)


def load(folder: Path) -> dict[str, Claim]:
    """Return the claims of a folder's `claims.json`, by name; none if the file does not exist."""
    path = folder / "claims.json"
    if not path.exists():
        return {}
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        return {row.pop("name"): Claim(**row | {"cases": tuple(map(tuple, row["cases"]))}) for row in rows}
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        raise ValueError(
            f"{path} is damaged, or not from `fbl-gym reproduce` ({problem}); move it away, or give another --out"
        ) from None


def save(folder: Path, claims: Mapping[str, Claim]) -> None:
    """Write claims, in the paper's order, to `claims.json` and `claims.md` in a folder."""
    claims = {name: claims[name] for name in CLAIMS if name in claims}
    rows = [{"name": name, **dataclasses.asdict(claim)} for name, claim in claims.items()]
    write_text(folder / "claims.json", json.dumps(rows, indent=1, ensure_ascii=False) + "\n")
    write_text(folder / "claims.md", page(claims))


def page(claims: Mapping[str, Claim]) -> str:
    """Return a table of claims and their verdicts in Markdown, and a section on each."""
    header = ("figure", "claim", "paper", "at stated values", "at the most favourable open values", "details")
    rows = [(c.figure, c.claim, c.paper, c.at_stated, c.at_best, f"[{name}](#{name})") for name, c in claims.items()]
    sections = [table(header, rows)]
    for name, c in claims.items():
        sections.append(f"\n### {name}\n\n{c.claim} (the paper: {c.paper}).\n\n- Bound: {c.bound}\n")
        sections.append(f"- Stated: {c.stated or '–'}\n- Open: {c.chosen or '–'}\n- Scenario: {c.scenario}\n")
        sections.append(
            f"- Verdict at stated values: *{c.at_stated}*; at the most favourable open ones: *{c.at_best}*\n\n"
        )
        sections.append(table(("kind", "case", "measured", "seeds that meet it", "holds"), c.cases))
    return "".join(sections)
