"""Policies: laws on the nominal model, the oracle, an arm that stays, and shipped agents by name.

`make("pid-flm", env)` builds one, and `names()` lists them. `TorqueLaw` is the base for a new law.
"""

from controllers.policy import Policy, TorqueLaw
from controllers.registry import access, factory, kind, make, names, register, summary, tuned

__all__ = ["Policy", "TorqueLaw", "access", "factory", "kind", "make", "names", "register", "summary", "tuned"]
