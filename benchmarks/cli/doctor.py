"""The command `fbl-gym doctor`."""

import argparse
import sys
import time
from importlib.util import find_spec
from typing import Any

import numpy as np

from benchmarks.cli.parser import EXTRAS
from benchmarks.run.rollout import rollout
from benchmarks.run.store import provenance
from fbl_gym import TwoLinkArmVectorEnv, scenarios
from fbl_gym.kernel.step import api
from fbl_gym.neighbours import ROOT


def run(arguments: argparse.Namespace) -> int:
    about = provenance("")
    print(f"Python {about['python']} ({sys.executable}) on {about['machine']}")
    print("  ".join(f"{name} {version}" for name, version in about["packages"].items()))
    for extra, modules in EXTRAS.items():
        lacking = [module for module in modules if find_spec(module) is None]
        print(f"extra {extra:<8} {'installed' if not lacking else 'lacks ' + ', '.join(lacking)}")
    print(f"compiled code is kept in {api.STEPS[0]._cache.cache_path or 'memory alone: no folder can be written'}")
    print(f"fbl_gym, controllers and benchmarks are imported from {ROOT}")
    if arguments.compile:
        _compile()
    return max(_check_readings(), _self_check())


#: A scenario of each class, which has a compiled step of its own, and readings without errors.
CLASSES: dict[str, dict[str, Any]] = {
    "plain": {},
    "friction": {"friction": {"coulomb": 1.0}},
    "events": {"events": [{"kind": "drop", "time": 1.0}]},
    "springs": {"joint": {"stiffness": 4000.0, "rotor_inertia": 0.5}},
    "bending": {"link": 10.0},
}


def _compile() -> None:
    """Compile all code that the kernel and the laws use."""
    begin = time.perf_counter()
    for options in CLASSES.values():
        TwoLinkArmVectorEnv(1, **options)
    TwoLinkArmVectorEnv(128, threads=2)
    moving = scenarios.get("nominal").replace(duration=3.0)  # until the arms have moved enough to be estimated
    for name in ("adaptive-flm", "computed-torque-dob+predictor", "lqg-elastic", "td3"):  # they use all compiled code
        rollout(name, moving, range(32))
    print(f"arm and laws are compiled, after {time.perf_counter() - begin:.1f} s")


def _check_readings() -> int:
    """Compare the sensors with the true motion in each class, with the compiled code as kept."""
    worst = {}
    for name, options in CLASSES.items():
        env = TwoLinkArmVectorEnv(2, action="torque", **options)
        env.reset(seed=0)
        for k in range(50):
            observation = env.step(np.full((2, 2), (80.0, -40.0)) * np.sin(k))[0]
        truth = env.truth
        motion = np.concatenate([truth.motor_position, truth.motor_velocity, truth.acceleration], axis=1)
        worst[name] = float(np.abs(observation[:, :6] - motion).max())
    wrong = [name for name, error in worst.items() if not error < 1e-9]
    errors = ", ".join(f"{name} {error:.0e}" for name, error in worst.items())
    print(f"readings less the true motion [rad, rad/s, rad/s^2]: {errors}")
    if wrong:
        print(f"something is wrong with {', '.join(wrong)}: remove the compiled code and run this again")
    return int(bool(wrong))


def _self_check() -> int:
    """Run a controller that tracks well for one second."""
    begin = time.perf_counter()
    scenario = scenarios.get("nominal").replace(duration=1.0)
    trace = rollout("pid-flm", scenario, range(16), {"kp": 400.0, "kd": 40.0})
    error = float(np.abs(trace.reference[-1] - trace.position[-1]).max())
    print(f"self-check: 16 runs of one second took {time.perf_counter() - begin:.2f} s, error {error:.1e} rad")
    print("all is well" if error < 1e-2 else "something is wrong: the error should be below 1e-2 rad")
    return 0 if error < 1e-2 else 1
