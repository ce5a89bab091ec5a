"""Golden traces: a few episodes, kept as they were. They fail when the same scenario, seed and policy give another episode.

`python tests/test_golden.py` writes them anew; that is a change of results, and belongs into CHANGELOG.md.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks.rollout import rollout
from fbl_gym import scenarios

FOLDER = Path(__file__).parent / "golden"
CASES = [
    ("pd-gravity", "nominal"),
    ("cascade-flm", "everything-2"),
    ("cascade-flm", "section-2-2/everything-1"),
    ("adaptive-flm", "paper-6a"),
    ("robust-flm", "paper-4b"),
    ("slotine-li", "mixed-error-2"),
    ("sliding-mode", "stiction-2"),
    ("ppo-memory", "payload-2"),
]
EVERY = 50


def episode(policy, scenario):
    """Positions [rad] and torques [N m] of seed 0 over two seconds, every so many samples."""
    trace = rollout(policy, scenarios.get(scenario).replace(duration=2.0), [0])
    return {name: getattr(trace, name)[::EVERY, 0].tolist() for name in ("position", "torque")}


def file_of(policy, scenario):
    return FOLDER / f"{policy}--{scenario.replace('/', '--')}.json"


@pytest.mark.parametrize(("policy", "scenario"), CASES)
def test_an_episode_is_what_it_was(policy, scenario):
    found, kept = episode(policy, scenario), json.loads(file_of(policy, scenario).read_text())
    for name, values in kept.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-6, atol=1e-9, err_msg=name)


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for case in CASES:
        file_of(*case).write_text(json.dumps(episode(*case)) + "\n")
        sys.stdout.write(f"{file_of(*case)}\n")
