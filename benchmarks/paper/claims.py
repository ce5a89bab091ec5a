"""All claims by name, in the paper's order, the rule of their verdicts, and their files."""

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from benchmarks.files import write_text
from benchmarks.paper import section_2, section_3, section_4
from benchmarks.paper.outcome import Outcome, Values
from benchmarks.report.markdown import table
from benchmarks.report.plot import plot_lines
from benchmarks.text import refusing
from fbl_gym.records.checks import unknown
from fbl_gym.scenarios.files import read_toml

#: The kinds of a case. Stated: the paper's values, with misprints corrected, or other readings of
#: them. Open: a value that the paper leaves open is not the project's first choice. Control: a
#: value contradicts the paper; it counts for no verdict.
STATED, OPEN, CONTROL = "stated", "open", "control"

#: Cases of a claim in the short form: the first values, and the most favourable ones.
SHORT = 2

#: A measured claim: its texts, both verdicts, and `cases`, each with kind, values, measured value,
#: seeds that meet the claim, and "yes" or "no".
Measured: TypeAlias = dict[str, Any]


class Claim(NamedTuple):
    """A claim of the paper.

    Attributes:
        texts: figure, claim, paper, bound, scenario, stated and open values, as in `claims.toml`.
        cases: kind, name and values of each; the first has the first values of all.
        measure: returns the outcome at some values.
    """

    texts: dict[str, str]
    cases: list[tuple[str, str, Values]]
    measure: Callable[[Values], Outcome]


def show(values: Values) -> str:
    """Return values as text."""
    return ", ".join(f"{name} {value}" for name, value in values.items())


def _claim(name: str, entry: Mapping[str, Any]) -> Claim:
    """Return the claim of an entry of `claims.toml`."""
    stated = {key: [value] if isinstance(value, str) else value for key, value in entry["stated"].items()}
    chosen = entry.get("open", {})
    texts = {key: entry.get(key, "nominal") for key in ("figure", "claim", "paper", "bound", "scenario")}
    texts |= {"stated": show({key: " | ".join(each) for key, each in stated.items()}), "chosen": show(chosen)}
    first = {key: each[0] for key, each in stated.items()} | chosen

    def kind(change: Values) -> str:
        if any(value not in stated.get(key, [value]) for key, value in change.items()):
            return CONTROL
        return OPEN if change.keys() & chosen.keys() else STATED

    cases = [(kind(change), show(change) or "first values", first | change) for change in ({}, *entry["cases"])]
    functions = vars(section_2) | vars(section_3) | vars(section_4)
    return Claim(texts, cases, functions[name.replace("-", "_")])


CLAIMS = {name: _claim(name, entry) for name, entry in read_toml(Path(__file__).with_name("claims.toml")).items()}


def judge(cases: Sequence[Sequence[str]]) -> tuple[str, str]:
    """Return the verdicts at stated and at the most favourable open values.

    At stated values, a claim is reproduced if it holds in all stated cases; at the most favourable
    open values, if it holds in any stated or open case.
    """
    stated = [case[-1] == "yes" for case in cases if case[0] == STATED]
    claimed = [case[-1] == "yes" for case in cases if case[0] != CONTROL]
    verdicts = (all(stated), stated), (any(claimed), claimed)
    at_stated, at_best = (f"{'' if held else 'not '}reproduced, {sum(each)} of {len(each)}" for held, each in verdicts)
    return at_stated, at_best


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


def measure_claim(name: str, number: int | None = None) -> tuple[Measured, Callable[[Path], None] | None]:
    """Measure the first cases of one of `CLAIMS`; None: all of them.

    Return the measured claim, and a function that draws its picture to a file if there is one.
    """
    claim = CLAIMS[name]
    cases = [(kind, title, claim.measure(values)) for kind, title, values in claim.cases[:number]]
    rows = [[kind, title, *outcome.texts] for kind, title, outcome in cases]
    measured = claim.texts | dict(zip(("at_stated", "at_best"), judge(rows), strict=True)) | {"cases": rows}
    if not (panels := [outcome.panel for *_, outcome in cases if outcome.panel]):
        return measured, None
    panel = dataclasses.replace(panels[0], lines=tuple(line for panel in panels for line in panel.lines))
    return measured, partial(plot_lines, claim.texts["claim"], [panel])


def load(folder: Path) -> dict[str, Measured]:
    """Return the claims of a folder's `claims.json`, by name; none if the file does not exist.

    Raises:
        ValueError: the file is not as `save` writes it.
    """
    path = folder / "claims.json"
    with refusing(f"{path} must be absent, or as `fbl-gym reproduce` writes it"):  # a list of claims is refused, too
        return {**json.loads(path.read_text(encoding="utf-8"))} if path.exists() else {}


def save(folder: Path, claims: Mapping[str, Measured]) -> None:
    """Write claims, in the paper's order, to `claims.json` and `claims.md` in a folder."""
    claims = {name: claims[name] for name in CLAIMS if name in claims}
    write_text(folder / "claims.json", json.dumps(claims, indent=1, ensure_ascii=False) + "\n")
    write_text(folder / "claims.md", page(claims))


def page(claims: Mapping[str, Measured]) -> str:
    """Return a table of claims and their verdicts in Markdown, and a section on each.

    `claims.json` has every case.
    """
    header = ("figure", "claim", "paper", "at stated values", "at the most favourable open values", "details")
    columns = ("figure", "claim", "paper", "at_stated", "at_best")
    rows = [(*(c[column] for column in columns), f"[{name}](#{name})") for name, c in claims.items()]
    sections = [
        f"\n### {name}\n\n{c['claim']} (the paper: {c['paper']}).\n\n- Bound: {c['bound']}\n"
        f"- Stated: {c['stated'] or '–'}\n- Open: {c['chosen'] or '–'}\n- Scenario: {c['scenario']}\n"
        f"- Measured in the first case, {c['cases'][0][1]}: {c['cases'][0][2]}\n"
        for name, c in claims.items()
    ]
    return table(header, rows) + "".join(sections)
