"""Benchmarks of policies: runs, analysis, reports, the paper's claims, and the command line.

`evaluate` runs a policy on a scenario and returns a table of its metrics. `animate` returns a film.
"""

from importlib import import_module
from pkgutil import extend_path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from benchmarks.report.film import animate
    from benchmarks.run.evaluation import evaluate

__all__ = ["animate", "evaluate"]

__path__ = extend_path(__path__, __name__)  # modules in a user's folder of this name can be imported, too


def __getattr__(name: str) -> Any:
    """Import on demand: a command that runs nothing starts faster."""
    places = {"animate": "benchmarks.report.film", "evaluate": "benchmarks.run.evaluation"}
    if name not in places:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(places[name]), name)
