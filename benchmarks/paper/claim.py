"""The record of a claim, its cases, the rule of its verdicts, and numbers as text."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from benchmarks.analysis.statistics import Estimate, proportion
from benchmarks.report.plot import Line
from fbl_gym.model.arm import Array

REPRODUCED, NOT_REPRODUCED = "reproduced", "not reproduced"
"""The verdicts. Each claim has two. At stated values it is reproduced if it holds in all stated
cases; at the most favourable open values, if it holds in any stated or open case."""

STATED, OPEN, CONTROL = "stated", "open", "control"
"""The kinds of a case. Stated: the paper's values, with misprints corrected, or other readings of
them. Open: a value that the paper leaves open is not the project's first choice. Control: a value
contradicts the paper; it counts for no verdict."""

LEAST = 0.9
"""A claim holds in a case if the 95 % interval of the share of seeds that meet it lies above this.
A diverged run does not meet it."""

Values: TypeAlias = Mapping[str, Any]
"""The values of a case, by name, as texts such as "2 rad/s"; `number` reads them."""

Rows: TypeAlias = dict[str, Array]
"""The metrics of each seed, by name."""


class Outcome(NamedTuple):
    """The measurement of a case.

    Attributes:
        meets: whether each run meets the claim [n]; one flag for a measurement without chance.
        measured: value as text, the median over the seeds if not stated otherwise.
        lines: of the claim's picture.
    """

    meets: Any
    measured: str = ""
    lines: Sequence[Line] = ()

    @property
    def holds(self) -> bool:
        """True if the claim holds."""
        return bool(np.all(self.meets)) if np.size(self.meets) == 1 else bool(share(self.meets).low >= LEAST)

    @property
    def texts(self) -> tuple[str, ...]:
        """The last texts of a measured case."""
        count, n = np.sum(self.meets), np.size(self.meets)
        return self.measured, f"{count} of {n}" if n > 1 else "", "yes" if self.holds else "no"


def share(meets: Any) -> Estimate:
    """Return the share of True along the last axis, with Clopper and Pearson's 95 % interval."""
    return proportion(np.sum(meets, axis=-1), np.shape(meets)[-1])


def judge(kinds: Sequence[str], outcomes: Sequence[Outcome]) -> tuple[str, str]:
    """Return the verdicts at stated and at the most favourable open values, by the rule above."""
    holds = [(kind, outcome.holds) for kind, outcome in zip(kinds, outcomes, strict=True)]
    stated = [held for kind, held in holds if kind == STATED]
    claimed = [held for kind, held in holds if kind != CONTROL]
    return tuple(  # type: ignore[return-value]
        f"{REPRODUCED if held else NOT_REPRODUCED}, {sum(each)} of {len(each)}"
        for held, each in ((all(stated), stated), (any(claimed), claimed))
    )


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, with its cases.

    Args:
        texts: number of the figure, equation or section; the claim in one line; statement or value
            of the paper; how a run meets the claim; the scenario on which it is measured.
        stated: the values that the paper states, each with all its readings.
        chosen: the values that it leaves open, with the project's first choice.
        changes: of each case, to the first values of all; most favourable ones first.
        panel: fields of the picture's `Panel`, if its outcomes have lines.
        measure: returns the outcome at some values.
    """

    texts: dict[str, str]
    stated: Mapping[str, tuple[Any, ...]]
    chosen: Values
    changes: Sequence[Values]
    panel: dict[str, Any]
    measure: Callable[[Values], Outcome]

    def cases(self) -> list[tuple[str, str, Values]]:
        """Return kind, name and values of each case; the first has the first values of all."""
        first = {name: readings[0] for name, readings in self.stated.items()} | dict(self.chosen)
        return [
            (self.kind(change), show(change) or "first values", first | dict(change)) for change in ({}, *self.changes)
        ]

    def kind(self, change: Values) -> str:
        """Return the kind of the case with some changes."""
        if any(value not in self.stated.get(name, (value,)) for name, value in change.items()):
            return CONTROL
        return OPEN if change.keys() & self.chosen.keys() else STATED


def show(values: Values) -> str:
    """Return values as text."""
    return ", ".join(f"{name} {value}" for name, value in values.items())


def claim(
    figure: str, text: str, *, paper: str, bound: str, stated: Mapping[str, tuple[Any, ...]], chosen: Values,
    cases: Sequence[Values] = (), scenario: str = "nominal", panel: dict[str, Any] | None = None,
) -> Callable[[Callable[[Values], Outcome]], Claim]:  # fmt: skip
    """Declare a claim, which the decorated function measures; its name is the claim's."""
    texts = {"figure": figure, "claim": text, "paper": paper, "bound": bound, "scenario": scenario}
    return lambda measure: Claim(texts, stated, chosen, cases, panel or {}, measure)


def number(text: str) -> float:
    """Return the number at the beginning of a value, such as "5 ms"."""
    return float(text.split()[0])


def percents(*values: Array | float) -> str:
    """Return medians in per cent as text."""
    return " / ".join(f"{np.median(value):.3g} %" for value in values)


def diverged(rows: Rows) -> str:
    """Return the number of diverged seeds as text; empty if there is none."""
    count = int(rows["diverged"].sum())
    return f" ({count} of {len(rows['diverged'])} diverged)" if count else ""
