"""Count how often an agent's 95 % interval holds the true mean, by its number of training seeds.

    python examples/few_trainings.py

The runs are simulated: trainings vary three times as much as means over 32 test seeds.
"""

import numpy as np

from benchmarks.analysis.statistics import resample

random = np.random.default_rng(0)
for members in (3, 5, 10):
    covered = 0.0
    for trial in range(400):
        runs = 3 * random.standard_normal((members, 1)) + 32**0.5 * random.standard_normal((1, 32))
        seeds, trainings = resample(32, 2 * trial)[1:] / 32, resample(members, 2 * trial + 1)[1:] / members
        low, high = np.quantile(((trainings @ runs) * seeds).sum(axis=1), (0.025, 0.975))
        covered += (low < 0 < high) / 400
    print(members, round(covered, 2))
