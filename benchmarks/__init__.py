"""Benchmarks of policies: runs, analysis, reports, the paper's claims, and the command line.

`evaluate` runs a policy on a scenario and returns a table of its metrics.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from benchmarks.run.evaluation import evaluate

__all__ = ["evaluate"]


def __getattr__(name: str) -> Any:
    """Import on demand: a command that runs nothing starts faster."""
    if name != "evaluate":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from benchmarks.run.evaluation import evaluate

    return evaluate
