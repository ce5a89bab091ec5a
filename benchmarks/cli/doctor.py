"""`fbl-gym doctor`."""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from importlib import metadata
from importlib.util import find_spec

import numpy as np

import controllers
from benchmarks.cli.parser import EXTRAS
from fbl_gym import TwoLinkArmVectorEnv, __version__

PACKAGES = ("gymnasium", "numpy", "scipy", "numba", "filterpy")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """None."""


def run(_arguments: argparse.Namespace) -> int:
    print(f"fbl-gym {__version__}, Python {platform.python_version()} ({sys.executable})")
    print(f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores")
    print("  ".join(f"{name} {metadata.version(name)}" for name in PACKAGES))
    for extra, modules in EXTRAS.items():
        lacking = [module for module in modules if find_spec(module) is None]
        print(f"extra {extra:<8} {'installed' if not lacking else 'lacks ' + ', '.join(lacking)}")
    print(f"compiled code is kept in {_cache()}")
    return _self_check()


def _cache() -> str:
    """Where Numba keeps what it compiled."""
    from fbl_gym.kernel import api

    return str(api.step._cache.cache_path or "memory alone: no folder can be written")


def _self_check() -> int:
    """A second of a controller that is known to track."""
    begin = time.perf_counter()
    env = TwoLinkArmVectorEnv(16, "nominal")
    policy = controllers.make("pid-flm", env, kp=400.0, kd=40.0)
    observation, _ = env.reset(seed=0)
    first = time.perf_counter() - begin
    state = None
    begin = time.perf_counter()
    for _ in range(100):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
    wall = time.perf_counter() - begin
    error = float(np.abs(env.truth.reference - env.truth.position).max())
    good = error < 1e-2
    print(
        f"self-check: first step after {first:.2f} s, then {1600 / wall:,.0f} steps/s in the loop, error {error:.1e} rad"
    )
    print("all is well" if good else "something is wrong: the error should be below 1e-2 rad")
    return 0 if good else 1
