"""Speeds compared with a baseline, and peers."""

from dataclasses import asdict

import pytest

from benchmarks.speed import peers
from benchmarks.speed.environments import Speed, compare
from fbl_gym import TABLE_1

ROWS = [Speed("peer", 10.0, 9.0, 11.0, 1.0, ""), Speed("arm", 80.0, 70.0, 90.0, 8.0, "peer")]


def test_ratios_are_compared_with_a_baseline():
    baseline = [asdict(row) for row in (ROWS[0], Speed("arm", 40.0, 40.0, 40.0, 4.0, "peer"))]
    assert compare(ROWS, baseline) == {"arm": 2.0}


def test_a_contestant_that_the_baseline_lacks_is_left_out():
    assert compare(ROWS, [asdict(ROWS[0])]) == {}


def test_mujoco_steps_the_arm():
    pytest.importorskip("mujoco")
    assert peers.mujoco_arm(TABLE_1)() == 1
    assert peers.mujoco_arms(TABLE_1, 4)() == 4
