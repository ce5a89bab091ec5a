"""Step thousands of arms at once, each with masses, friction and noise of its own.

python examples/batch.py
"""

import time

import gymnasium as gym
import numpy as np

import fbl_gym  # noqa: F401  registers the environments

LANES, STEPS = 4096, 500

envs = gym.make_vec(
    "fbl_gym/TwoLinkArm-v0", LANES, vectorization_mode="vector_entry_point", scenario="servo-everything-2"
)
observations, _ = envs.reset(seed=0)  # lane i has the seed 0 + i
actions = np.zeros((LANES, 2), dtype=np.float32)  # torques, N m
envs.step(actions)  # the first step compiles, once on each machine

begin, episodes = time.perf_counter(), 0
for _ in range(STEPS):
    observations, rewards, terminated, truncated, infos = envs.step(actions)
    episodes += (terminated | truncated).sum()
seconds = time.perf_counter() - begin
print(f"{LANES * STEPS / seconds / 1e6:.2f} million steps/s, {episodes} episodes ended")
