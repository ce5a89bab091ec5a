"""A closed loop of a passivity-based law on a wrong model, as the tests of Slotine and Li's and Spong's laws run it."""

import numpy as np

import controllers
from fbl_gym import TwoLinkArmVectorEnv, scenarios

EXCITING = {"kind": "fourier", "centre": (-np.pi / 2, 0.0), "frequency": 0.2}


def closed_loop(name, scenario, lanes=8, **gains):
    """Return the law, the real lumped parameters, and by sample: the estimates or None, s, q and the error."""
    env = TwoLinkArmVectorEnv(lanes, scenario, action="torque")
    policy = controllers.make(name, env, **gains)
    observation, _ = env.reset(seed=0)
    state, log = policy.initial(observation), []
    for _ in range(scenario.steps - 1):
        before = state.estimate if state else None
        q, v = policy.read(observation, "position", "velocity")
        r, dr = policy.read(observation, "reference_position", "reference_velocity")
        s = dr - v + np.array(policy.slope) * (r - q)
        action, state = policy.predict(observation, state)
        log.append((before, s, q, r - q))
        observation = env.step(action)[0]
    return policy, env.truth.lumped, [np.array(x) for x in zip(*log, strict=True)]


def wrong(radius=0.5, **changes):
    return scenarios.get("nominal").replace(
        parameter_error={"radius": radius}, actuator=None, control_dt=5e-4, physics_dt=5e-4, duration=2.0,
        initial_error=(0.1, -0.1), reference=EXCITING, **changes,
    )  # fmt: skip
