"""`fbl-gym warm-up`."""

import argparse
import time

import controllers
from benchmarks.cli import doctor
from fbl_gym import TwoLinkArmVectorEnv


def run(_arguments: argparse.Namespace) -> int:
    begin = time.perf_counter()
    for options in (
        {"friction": {"coulomb": 1.0}},
        {"events": [{"kind": "drop", "time": 1.0}]},
        {"joint": {"stiffness": 4000.0, "rotor_inertia": 0.5}},
    ):
        TwoLinkArmVectorEnv(1, **options)  # a class of scenarios has a step of its own
    env = TwoLinkArmVectorEnv(32, threads=2)
    observation, _ = env.reset(seed=0)
    _ = env.truth
    for name in ("adaptive-flm", "adaptive-flm-ls", "ppo-memory"):  # together they use all compiled code
        policy, state = controllers.make(name, env), None
        for _ in range(300):  # until the arms have moved enough to be estimated
            action, state = policy.predict(observation, state)
            observation = env.step(action)[0]
    print(f"compiled code is kept in {doctor._cache()}, ready after {time.perf_counter() - begin:.1f} s")
    return 0
