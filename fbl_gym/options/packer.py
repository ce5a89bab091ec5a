"""The interface through which an option writes its numbers; `kernel/program.py` implements it."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class Packer(Protocol):
    """The numbers of a scenario that is being packed.

    Attributes:
        settings: a record of the type `kernel.memory.SETTINGS`.
        tables: arrays that the scenario contains, one after the other.
        scenario: the whole `Scenario`, for its rates and for what options mean to each other.
    """

    settings: NDArray[np.void]
    tables: list[float]
    scenario: Any

    def vary(self, field: str, value: Any, path: str, *, scale: float = 1.0, first: int = 0) -> None:
        """Set a field of `kernel.memory.VARIED`, from its number `first` on, to a scaled value.

        The value is a number, a distribution, or a pair of them. The option's path names the random
        stream.
        """

    def vary_row(self, row: int, value: Any, path: str, scale: float = 1.0) -> None:
        """Set a row of a block, or the rows of both joints, as `vary` does."""
