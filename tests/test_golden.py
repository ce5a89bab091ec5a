"""Golden traces: a few stored episodes, and the bits of the environment alone.

A test fails if the same scenario, seed and policy give another episode, or if the environment gives
another bit on any machine. `python tests/test_golden.py` writes them again; that is a change of
results and belongs into CHANGELOG.md.
"""

import hashlib
import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from benchmarks.run.rollout import rollout
from fbl_gym import TwoLinkArmVectorEnv, scenarios

FOLDER = Path(__file__).parent / "golden"
CASES = [
    ("pd-gravity", "nominal"), ("cascade-flm", "everything-2"), ("adaptive-flm", "paper-6a"),
    ("robust-flm", "paper-4b"), ("slotine-li", "mixed-error-2"), ("sliding-mode", "stiction-2"),
    ("td3", "payload-2"),
]  # fmt: skip
EVERY = 50


def episode(policy, scenario):
    """Return positions [rad] and torques [N m] of seed 0 over two seconds, every 50th sample."""
    trace = rollout(policy, scenarios.get(scenario).replace(duration=2.0), [0])
    return {name: getattr(trace, name)[::EVERY, 0].tolist() for name in ("position", "torque")}


def file_of(policy, scenario):
    return FOLDER / f"{policy}--{scenario.replace('/', '--')}.json"


@pytest.mark.parametrize(("policy", "scenario"), CASES)
def test_an_episode_is_the_stored_one(policy, scenario):
    trace = episode(policy, scenario)
    for name, values in json.loads(file_of(policy, scenario).read_text()).items():
        np.testing.assert_allclose(trace[name], values, rtol=1e-6, atol=1e-9, err_msg=name)


BITS = FOLDER / "bits.json"
WORLDS = tomllib.loads((FOLDER / "worlds.toml").read_text(encoding="utf-8"))


def bits(options):
    """Return the SHA-256 of observations and rewards of three arms over 100 steps, under exact actions."""
    env = TwoLinkArmVectorEnv(3, **options)
    digest = hashlib.sha256(env.reset(seed=7)[0].astype("<f8").tobytes())
    for k in range(100):
        fractions = (np.arange(6).reshape(3, 2) * 11 + 37 * k) % 64 / 64 - 0.5
        observations, rewards, *_ = env.step(fractions * env.single_action_space.high)
        digest.update(observations.astype("<f8").tobytes() + rewards.astype("<f8").tobytes())
    return digest.hexdigest()


@pytest.mark.parametrize("world", WORLDS)
def test_every_bit_is_the_stored_one(world):
    assert bits(WORLDS[world]) == json.loads(BITS.read_text())[world]


if __name__ == "__main__":
    BITS.write_text(json.dumps({world: bits(options) for world, options in WORLDS.items()}, indent=1) + "\n")
    FOLDER.mkdir(exist_ok=True)
    for case in CASES:
        file_of(*case).write_text(json.dumps(episode(*case)) + "\n")
        sys.stdout.write(f"{file_of(*case)}\n")
