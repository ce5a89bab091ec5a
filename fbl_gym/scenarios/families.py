"""Declarations of a family and of a tier of scenarios."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

from fbl_gym.model.arm import ArmParameters
from fbl_gym.records.record import either


class Family(NamedTuple):
    """A family of scenarios: one kind of uncertainty, at severities 1 to 3.

    Attributes:
        text: its description, with the name of each number in braces.
        options: returns fields of `Scenario` as plain data, from the numbers of a severity, each by
            its name; in a class of robots, from the scales of an arm, too.
        numbers: the values of each number at severities 1 to 3, in the text's units; a value may be
            a pair, from - to.
    """

    text: str
    options: Callable[..., dict[str, Any]]
    numbers: Mapping[str, Sequence[Any]] = {}

    @property
    def description(self) -> str:
        """Return the description with its numbers."""
        return self.text.format(**{name: either([*map(_text, values)]) for name, values in self.numbers.items()})

    def at(self, severity: int, *scale: Any) -> dict[str, Any]:
        """Return the fields at a severity of 1 to 3."""
        return self.options(*scale, **{name: values[severity - 1] for name, values in self.numbers.items()})


class Member(NamedTuple):
    """The place of a scenario in the tiers.

    Attributes:
        family: its family.
        severity: 0 to 3.
        tier: one of `scenarios.TIERS`.
    """

    family: str
    severity: int
    tier: str


class Tier(NamedTuple):
    """A tier of scenarios.

    Attributes:
        text: one line.
        single: names of its families without severities.
        graded: of those with severities.
        severities: of the graded families.
        options: returns fields of `Scenario` for a family, a severity and an arm; None: the tier's.
    """

    text: str
    single: Collection[str]
    graded: Collection[str]
    severities: tuple[int, ...]
    options: Callable[[str, int, ArmParameters | None], dict[str, Any]]

    def members(self, tier: str) -> dict[str, Member]:
        """Return its scenarios by name; `tier` is its own name."""
        first = "" if tier == "ideal" else f"{tier}-"
        graded = [(family, severity) for family in self.graded for severity in self.severities]
        return {
            **{first + family: Member(family, 0, tier) for family in self.single},
            **{f"{first}{family}-{severity}": Member(family, severity, tier) for family, severity in graded},
        }


def _text(value: Any) -> str:
    return "-".join(f"{x:.3g}" if x < 1000 else f"{x:g}" for x in (value if isinstance(value, list) else [value]))
