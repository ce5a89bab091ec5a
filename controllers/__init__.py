"""Policies by name: laws on the nominal model, the oracles, and shipped agents.

`make("pid-flm", env)` builds one, and `names()` lists them. `TorqueLaw` is the base for a new law.
"""

from controllers.policy import Policy, TorqueLaw
from controllers.registry import access, factory, kind, make, names, register, summary, tuned

__all__ = ["Policy", "TorqueLaw", "access", "factory", "kind", "make", "names", "register", "summary", "tuned"]
