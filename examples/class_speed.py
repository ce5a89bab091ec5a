"""Measure how many control steps a second one core makes in each class of robots.

python examples/class_speed.py
"""

import time

import numpy as np

from fbl_gym import TwoLinkArmVectorEnv

NAMES = [f"{robot}-{family}" for robot in ("servo", "direct", "geared") for family in ("nominal", "everything-3")]
arms = {name: TwoLinkArmVectorEnv(512, name, threads=1) for name in ("nominal", *NAMES, "servo-surprise-bend")}
times, action = {name: [] for name in arms}, np.zeros((512, 2))
for _ in range(7):
    for name, env in arms.items():
        env.reset(seed=0)
        begin = time.process_time()
        for _ in range(100):
            env.step(action)
        times[name].append(time.process_time() - begin)
for name, each in times.items():
    print(f"{name:<20} {0.0512 / np.median(each):5.2f} million steps/s")
