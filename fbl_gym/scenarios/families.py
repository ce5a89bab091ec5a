"""A family of scenarios: one kind of uncertainty, declared once with its numbers."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from fbl_gym.records.checks import Pair
from fbl_gym.records.record import either, merged


class Family(NamedTuple):
    """A family.

    Attributes:
        text: its description, with `{}` for each column of numbers.
        columns: numbers in the text's units, each a number or a pair for severities 1 to 3.
        options: returns fields of `Scenario` as plain data, from an arm and a number of each
            column.
    """

    text: str
    columns: tuple[tuple[float | Pair, ...], ...]
    options: Callable[..., dict[str, Any]]

    @property
    def description(self) -> str:
        """Return the description with its numbers."""
        return self.text.format(*(either([_text(number) for number in column]) for column in self.columns))

    def at(self, severity: int, *arm: Any) -> dict[str, Any]:
        """Return the fields at a severity of 1 to 3 on an arm."""
        return self.options(*arm, *(column[severity - 1] for column in self.columns))


class Member(NamedTuple):
    """The place of a scenario in the families.

    Attributes:
        family: its family.
        severity: 0 to 3.
        tier: one of `scenarios.TIERS`.
    """

    family: str
    severity: int
    tier: str = "ideal"


def combined(families: Mapping[str, Family], names: tuple[str, ...], severity: int, *arm: Any) -> dict[str, Any]:
    """Return the fields of several families at once."""
    options: dict[str, Any] = {}
    for name in names:
        options = merged(options, families[name].at(severity, *arm))
    return options


def _text(number: float | Pair) -> str:
    return "-".join(f"{x:.3g}" if x < 1000 else f"{x:g}" for x in (number if isinstance(number, tuple) else (number,)))
