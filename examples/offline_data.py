"""Record episodes of a policy as arrays, for offline learning with d3rlpy or your own code.

    python examples/offline_data.py computed-torque medium.npz --noise 0.1

The policy observes `fbl_gym/TwoLinkArm-v0`. The file has what an agent observes of the same arms:
stacks of the last observations of `fbl_gym/TwoLinkArmTracking-v0`.
"""

import argparse

import gymnasium as gym
import numpy as np

import controllers
import fbl_gym
from benchmarks.seeds import SPLITS

parser = argparse.ArgumentParser()
parser.add_argument("policy")
parser.add_argument("file")
parser.add_argument("--scenario", default="servo-practice-everything-1")
parser.add_argument("--episodes", type=int, default=100)
parser.add_argument("--noise", type=float, default=0.0, help="on each action, as a share of the torque limit")
parser.add_argument("--frames", type=int, default=4, help="observations in a stack")
arguments = parser.parse_args()

# Equal seeds and equal actions make equal motions, so two environments show one motion twice.
lanes, seeds = arguments.episodes, list(SPLITS["training"][: arguments.episodes])
arms = fbl_gym.TwoLinkArmVectorEnv(lanes, arguments.scenario, action="normalized")
agents = gym.make_vec(
    "fbl_gym/TwoLinkArmTracking-v0", lanes, vectorization_mode="vector_entry_point", scenario=arguments.scenario
)
policy = controllers.make(arguments.policy, arms)
seen, (observation, _) = arms.reset(seed=seeds)[0], agents.reset(seed=seeds)
stack = np.repeat(observation[:, None], arguments.frames, axis=1)
state, running, noise = None, np.ones(lanes, dtype=bool), np.random.default_rng(0)
steps = []
for _ in range(arms.scenario.steps):
    action, state = policy.predict(seen, state)
    action = action + arguments.noise * noise.standard_normal(action.shape)
    action = np.clip(action, -1.0, 1.0).astype(np.float32)
    seen, *_ = arms.step(action)
    observation, rewards, terminated, truncated, _ = agents.step(action)
    steps.append((running, stack.reshape(lanes, -1), action, rewards, terminated, truncated))
    stack = np.concatenate([stack[:, 1:], observation[:, None]], axis=1)
    running = running & ~(terminated | truncated)

names = ("observations", "actions", "rewards", "terminals", "timeouts")
recorded, *signals = (np.swapaxes(signal, 0, 1) for signal in map(np.array, zip(*steps, strict=True)))
data = {name: signal[recorded].astype(np.float32) for name, signal in zip(names, signals, strict=True)}
np.savez(arguments.file, **data)
print(f"{arguments.file}: {len(data['rewards']):,} steps, mean return {data['rewards'].sum() / lanes:.1f}")
