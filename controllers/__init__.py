"""Policies that know the nominal model, the layout of the observation and the rates, and nothing of the plant.

`make("pid-flm", env)` builds one, `names()` lists them.
"""

from controllers.policy import Policy, TorqueLaw, access, factory, kind, make, names, register, summary, tuned

__all__ = ["Policy", "TorqueLaw", "access", "factory", "kind", "make", "names", "register", "summary", "tuned"]
