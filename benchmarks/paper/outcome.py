"""The outcome of a case, and its values and numbers as texts."""

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from benchmarks.analysis.statistics import Estimate, proportion
from benchmarks.report.plot import Panel
from fbl_gym.model.arm import Array

#: The values of a case, by name, as texts such as "2 rad/s"; `number` reads them.
Values: TypeAlias = Mapping[str, Any]

#: The metrics of each seed, by name.
Rows: TypeAlias = dict[str, Array]

#: A claim holds in a case if the 95 % interval of the share of seeds that meet it lies above this.
#: A diverged run does not meet it.
LEAST = 0.9


class Outcome(NamedTuple):
    """The measurement of a case.

    Attributes:
        meets: whether each run meets the claim [n]; one flag for a measurement without chance.
        measured: value as text, the median over the seeds if not stated otherwise.
        panel: the claim's picture, with the lines of this case; None without a picture.
    """

    meets: Any
    measured: str = ""
    panel: Panel | None = None

    @property
    def texts(self) -> tuple[str, str, str]:
        """Measured value, number of seeds that meet the claim, and "yes" if the claim holds."""
        n = np.size(self.meets)
        holds = np.all(self.meets) if n == 1 else share(self.meets).low >= LEAST
        return self.measured, f"{np.sum(self.meets)} of {n}" if n > 1 else "", "yes" if holds else "no"


def share(meets: Any) -> Estimate:
    """Return the share of True along the last axis, with Clopper and Pearson's 95 % interval."""
    return proportion(np.sum(meets, axis=-1), np.shape(meets)[-1])


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
