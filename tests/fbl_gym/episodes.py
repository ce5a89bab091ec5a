"""Episodes of environments with many options, for tests of what holds whatever the options are."""

import numpy as np

from fbl_gym import (
    Actuator,
    Friction,
    Noise,
    ParameterError,
    SensorError,
    SineDisturbance,
    TwoLinkArmEnv,
    TwoLinkArmVectorEnv,
)  # fmt: skip

ID = "fbl_gym/TwoLinkArm-v0"
TRACKING = "fbl_gym/TwoLinkArmTracking-v0"
MUJOCO = "fbl_gym/TwoLinkArmMuJoCo-v0"
TIGHT = {"low": (-2.2, -0.9), "high": (-1.2, 0.6), "velocity": (1.0, 1.5)}
"""Constraints that an arm exceeds now and then."""

RECORDS = {
    "parameter_error": ParameterError(ratio={"m2": 2.0}, radius=0.5, payload={"mass": 3.0, "pick_up": 0.2}),
    "noise": Noise(position=SensorError(sigma=0.01, bias=1e-3, quantization=1e-3), velocity=0.02),
    "friction": Friction(coulomb=5.0, stiction=(3.0, 2.0)), "disturbance": SineDisturbance(amplitude=10.0),
    "actuator": Actuator(delay=0.015, lag=0.02), "reference": {"kind": "filtered-steps", "bandwidth": 6.0},
    "preview": 2, "duration": 1.0,
}  # fmt: skip
"""One of each kind of option, as records where there is one."""

EVENTFUL = {
    "scenario": "everything-3", "duration": 0.3, "limits": {"velocity": 9.0}, "actuator": {"delay": 0.013, "lag": 0.01},
    "preview": 1,
}  # fmt: skip
"""Everything at once, in episodes that end soon and often, by time or by divergence."""


def started(*arguments, seed=0, **options):
    """Return an environment at the start of an episode."""
    env = TwoLinkArmEnv(*arguments, **options)
    env.reset(seed=seed)
    return env


def started_batch(*arguments, seed=0, **options):
    """Return a vector environment at the start of an episode."""
    env = TwoLinkArmVectorEnv(*arguments, **options)
    env.reset(seed=seed)
    return env


def truths_of(env, actions):
    """Return the truth before and after each of the actions."""
    truths = [env.truth]
    for action in actions:
        env.step(action)
        truths.append(env.truth)
    return truths


def episode(env, steps=60, seed=5):
    """Everything a run returns, as one array."""
    rng = np.random.default_rng(0)
    rows = [np.append(env.reset(seed=seed)[0], 0.0)]
    for _ in range(steps):
        observation, reward, *_ = env.step(rng.uniform(-0.3, 0.3, 2))
        rows.append(np.append(observation, reward))
    return np.array(rows)
