"""The command `fbl-gym doctor`."""

import argparse
import os
import platform
import sys
import time
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import benchmarks
import controllers
import fbl_gym
from benchmarks.cli.parser import EXTRAS
from fbl_gym import TwoLinkArmVectorEnv, __version__

PACKAGES = ("gymnasium", "numpy", "scipy", "numba", "filterpy")


def run(_arguments: argparse.Namespace) -> int:
    print(f"fbl-gym {__version__}, Python {platform.python_version()} ({sys.executable})")
    print(f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores")
    print("  ".join(f"{name} {metadata.version(name)}" for name in PACKAGES))
    for extra, modules in EXTRAS.items():
        lacking = [module for module in modules if find_spec(module) is None]
        print(f"extra {extra:<8} {'installed' if not lacking else 'lacks ' + ', '.join(lacking)}")
    print(f"compiled code is kept in {_cache()}")
    for line in origins():
        print(line)
    return _self_check()


def origins() -> list[str]:
    """Return the place of each package of fbl-gym, and a warning for each other of its name."""
    lines = []
    for package in (fbl_gym, controllers, benchmarks):
        name, folder = package.__name__, Path(str(package.__file__)).resolve().parent
        lines.append(f"{name} is imported from {folder}")
        if folder.parent != Path(fbl_gym.__file__).resolve().parent.parent:
            lines.append(f"warning: {folder} is another package, not the {name} of fbl-gym: rename or move it")
        for entry in dict.fromkeys(Path(entry or ".").resolve() for entry in sys.path):
            places = (entry / name / "__init__.py", entry / f"{name}.py")
            other = next((place for place in places if place.is_file() and place.parent != folder), None)
            if other is not None:
                lines.append(f"warning: {other} has the same name and may be imported in its place: rename or move it")
    return lines


def _cache() -> str:
    """Return the folder of Numba's compiled code."""
    from fbl_gym.kernel import api

    return str(api.STEPS[0]._cache.cache_path or "memory alone: no folder can be written")


def _self_check() -> int:
    """Run a controller that tracks well for one second."""
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
    tracks = error < 1e-2
    print(
        f"self-check: first step after {first:.2f} s, then {1600 / wall:,.0f} steps/s in the loop, error {error:.1e} rad"
    )
    print("all is well" if tracks else "something is wrong: the error should be below 1e-2 rad")
    return 0 if tracks else 1
