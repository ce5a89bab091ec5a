"""Policies that know the nominal model, the layout of the observation and the rates, and nothing of the plant.

`make("pid-flm", env)` builds one, `names()` lists them.
"""

from controllers.policy import Policy, TorqueLaw, factory, kind, make, names, register, summary, tier, tuned

__all__ = ["Policy", "TorqueLaw", "factory", "kind", "make", "names", "register", "summary", "tier", "tuned"]
