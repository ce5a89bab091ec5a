"""Pairs of runs with and without an option, with the same seed and torques."""

import functools

import numpy as np

from fbl_gym import TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import started, truths_of

LANES = 64
WAYS = ("position", "velocity", "acceleration")
PLANT = (*WAYS, "applied_torque", "disturbance", "friction_torque", "lumped", "reference")


def torques(k, lanes=LANES):
    """Return torques [lanes x 2] that move the arm, a function of the step."""
    phase = np.arange(lanes)[:, None] + np.array([0.0, 1.0])
    return np.array([150.0, 40.0]) * np.sin(0.05 * k + phase) + np.array([-50.0, -10.0])


def play(steps=100, lanes=LANES, seed=0, **options):
    """Return the layout, observations [steps + 1 x lanes x size] and truths of a run under `torques`."""
    env = TwoLinkArmVectorEnv(lanes, action="torque", limits={"position": 100.0}, **options)
    observations, truths = [env.reset(seed=seed)[0]], [env.truth]
    for k in range(steps):
        observations.append(env.step(torques(k, lanes))[0])
        truths.append(env.truth)
    return env.layout, np.array(observations), truths


def same(ours, theirs, *names):
    """Return True if the truths of two runs agree to the bit in the named fields."""
    return all(
        np.array_equal(getattr(a, name), getattr(b, name)) for a, b in zip(ours, theirs, strict=True) for name in names
    )


@functools.cache
def plain():
    """Return the run without any option: layout, observations, truths."""
    return play()


def watch(*names, steps=150, torque=(-50.0, -10.0), seed=0, **options):
    """Return fields of the truth [steps + 1 x ...] of one arm with steps of 1 ms under a held torque."""
    env = started(**{"action": "torque", "control_dt": 1e-3, "physics_dt": 1e-3, **options}, seed=seed)
    truths = truths_of(env, [torque(k) if callable(torque) else torque for k in range(steps)])
    return tuple(np.array([getattr(truth, name) for truth in truths]) for name in names)
