"""One policy on one scenario, as a table."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.policies.spec import PolicyLike, resolve
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from benchmarks.seeds import SPLITS
from fbl_gym import Scenario
from fbl_gym.records.checks import check_whole
from fbl_gym.scenarios import as_scenario


def evaluate(
    policy: PolicyLike, scenario: Scenario | str | Path = "nominal", seeds: int | Sequence[int] = 16, *,
    trust: bool = False, **gains: Any,
) -> pd.DataFrame:  # fmt: skip
    """Run one episode for each seed, and return the metrics of each run.

    Args:
        policy: as for `fbl-gym evaluate`, such as "computed-torque-dob@tuned" or "my_law.py".
        scenario: its name, its file, or a `Scenario`.
        seeds: the seeds; a number means the first test seeds.
        trust: True lets the code of a saved model run.
        **gains: arguments of the policy, such as `kp=25.0`.

    Returns:
        A table with a row for each seed and a column for each metric of
        `benchmarks.run.metrics.METRICS` that applies to the scenario.

    Raises:
        ValueError: there is no such policy or scenario, or a gain is unknown or out of bounds.
    """
    if not np.iterable(seeds):
        seeds = SPLITS["test"][: check_whole("seeds", seeds, low=1, high=len(SPLITS["test"]))]
    rows = measure(rollout(resolve(policy, trust=trust), as_scenario(scenario), seeds, gains))
    return pd.DataFrame(rows, index=pd.Index(seeds, name="seed")).dropna(axis=1, how="all")
