"""Policies by name: laws on the nominal model, the oracles, and shipped agents.

`make("pid-flm", env)` builds one, and `names()` lists them. `TorqueLaw` is the base for a new
law. `Runner` runs a policy on a robot.
"""

from pkgutil import extend_path

from controllers.base import Policy, TorqueLaw
from controllers.registry import access, factory, kind, make, names, register, summary, tuned
from controllers.runner import Runner

__all__ = [
    "Policy", "Runner", "TorqueLaw", "access", "factory", "kind", "make", "names", "register", "summary", "tuned",
]  # fmt: skip

__path__ = extend_path(__path__, __name__)  # modules in a user's folder of this name can be imported, too
