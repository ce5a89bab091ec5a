"""Episodes: with many options, in pairs with and without one, and of an arm with dry friction."""

import functools
from importlib.util import find_spec

import numpy as np
import pytest

from fbl_gym import ArmParameters, TwoLinkArmEnv, TwoLinkArmVectorEnv, options

ID = "fbl_gym/TwoLinkArm-v0"
TRACKING = "fbl_gym/TwoLinkArmTracking-v0"
MUJOCO = "fbl_gym/TwoLinkArmMuJoCo-v0"
needs_mujoco = pytest.mark.skipif(find_spec("mujoco") is None, reason="needs the extra mujoco")
#: Constraints that an arm exceeds now and then.
TIGHT = {"low": (-2.2, -0.9), "high": (-1.2, 0.6), "velocity": (1.0, 1.5)}

#: One of each kind of option, as records where there is one.
RECORDS = {
    "parameter_error": options.ParameterError(ratio={"m2": 2.0}, radius=0.5, payload={"mass": 3.0, "pick_up": 0.2}),
    "noise": options.Noise(position=options.SensorError(sigma=0.01, bias=1e-3, quantization=1e-3), velocity=0.02),
    "friction": options.Friction(coulomb=5.0, stiction=(3.0, 2.0)),
    "disturbance": options.SineDisturbance(amplitude=10.0),
    "actuator": options.Actuator(delay=0.015, lag=0.02), "reference": {"kind": "filtered-steps", "bandwidth": 6.0},
    "preview": 2, "duration": 1.0,
}  # fmt: skip

#: Everything at once, in episodes that end soon and often, by time or by divergence.
EVENTFUL = {
    "scenario": "everything-3", "duration": 0.3, "limits": {"velocity": 9.0}, "actuator": {"delay": 0.013, "lag": 0.01},
    "preview": 1,
}  # fmt: skip


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
    first = env.reset(seed=seed)[0]
    later = (env.step(action) for action in rng.uniform(-0.3, 0.3, (steps, 2)))
    return np.array([[*first, 0.0], *([*observation, reward] for observation, reward, *_ in later)])


# Pairs of runs with and without an option, with the same seed and torques.

LANES = 64
WAYS = ("position", "velocity", "acceleration")
PLANT = (*WAYS, "applied_torque", "disturbance", "friction_torque", "lumped", "reference")


def torques(k, lanes=LANES):
    """Return torques [lanes x 2] that move the arm, a function of the step."""
    phase = np.arange(lanes)[:, None] + np.array([0.0, 1.0])
    return np.array([150.0, 40.0]) * np.sin(0.05 * k + phase) + np.array([-50.0, -10.0])


def run(env, steps, **start):
    """Return the observations [steps + 1 x lanes x size] and truths of an episode under `torques`."""
    observations, truths = [env.reset(**start)[0]], [env.truth]
    for k in range(steps):
        observations.append(env.step(torques(k, env.num_envs))[0])
        truths.append(env.truth)
    return np.array(observations), truths


def play(steps=100, lanes=LANES, seed=0, **options):
    """Return the layout, observations and truths of a run of new arms."""
    env = TwoLinkArmVectorEnv(lanes, **{"action": "torque", "limits": {"position": 100.0}, **options})
    return env.layout, *run(env, steps, seed=seed)


def same(ours, theirs, *names):
    """Return True if the truths of two runs agree to the bit in the named fields."""
    pairs = zip(ours, theirs, strict=True)
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for a, b in pairs for name in names)


@functools.cache
def plain():
    """Return the run without any option: layout, observations, truths."""
    return play()


def watch(*names, steps=150, torque=(-50.0, -10.0), seed=0, **options):
    """Return fields of the truth [steps + 1 x ...] of one arm with steps of 1 ms under a held torque."""
    env = started(**{"action": "torque", "control_dt": 1e-3, "physics_dt": 1e-3, **options}, seed=seed)
    truths = truths_of(env, [torque(k) if callable(torque) else torque for k in range(steps)])
    return tuple(np.array([getattr(truth, name) for truth in truths]) for name in names)


# An arm with dry friction, and its breakaway torques.

FLAT = ArmParameters(gravity=0.0)
STILL = {"kind": "minimum-jerk", "points": ((0.4, 0.7),)}
DRY = {"coulomb": (20.0, 8.0), "stiction": (10.0, 4.0), "v_s": 1e-3}
BREAKAWAY = np.array([30.0, 12.0])


def flat(**options):
    """Return an arm at rest without gravity; its load is the applied torque alone."""
    still = {"arm": FLAT, "action": "torque", "actuator": None, "reference": STILL, "friction": DRY}
    return started(**{**still, **options})
