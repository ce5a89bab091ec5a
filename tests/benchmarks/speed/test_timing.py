"""Contestants take turns, and only the time of their own turns counts."""

import re
import sys
import time
from functools import partial

import gymnasium as gym
import numpy as np
import pytest

from benchmarks import speed
from fbl_gym import TwoLinkArmVectorEnv


def test_rates_are_environments_per_second(monkeypatch):
    monkeypatch.setattr(speed, "ROUND_S", 0.02)
    calls = []

    def step(name, lanes):
        calls.append(name)
        time.sleep(0.001)
        return lanes

    rates = speed.measure_rates({"one": partial(step, "one", 1), "many": partial(step, "many", 100)}, rounds=2)
    assert [len(values) for values in rates.values()] == [2, 2]
    turns = [name for name, before in zip(calls[2:], [None, *calls[2:]], strict=False) if name != before]
    assert turns == ["one", "many", "one", "many"]
    assert 0 < max(rates["one"]) < 1000
    assert min(rates["many"]) > max(rates["one"])


def test_a_contestant_returns_the_number_of_its_environments():
    single = speed.contestant(gym.make("fbl_gym/TwoLinkArm-v0", duration=0.05), np.zeros(2))
    assert [single() for _ in range(12)] == [1] * 12  # beyond the end of an episode
    assert speed.contestant(TwoLinkArmVectorEnv(3), np.zeros((3, 2)))() == 3


@pytest.mark.parametrize("policy", ["pd-gravity", "computed-torque+predictor"])
def test_the_decisions_of_an_arm_and_of_a_batch_are_measured(policy, monkeypatch, capsys):
    monkeypatch.setattr(speed, "WARM_UP", 2)
    monkeypatch.setattr(speed, "TURN", 20)
    monkeypatch.setattr(sys, "argv", ["speed", "--rounds", "1", "--decisions", policy])
    speed.main()
    name, one, many = capsys.readouterr().out.splitlines()[-1].split()
    assert name == policy
    assert all(0 < int(time) < 1e6 for time in (one, many))


def test_the_command_prints_the_measurements(monkeypatch, capsys):
    contestants = {"peer": (lambda: 1, ""), "arm": (lambda: 8, "peer")}
    monkeypatch.setattr(speed, "_contestants", lambda: contestants)
    monkeypatch.setattr(speed, "ROUND_S", 0.01)
    monkeypatch.setattr(sys, "argv", ["speed", "--rounds", "1"])
    speed.main()
    assert re.search(r"^peer +[\d,]+ *\narm +[\d,]+ +[\d.]+$", capsys.readouterr().out, flags=re.M)
    monkeypatch.setattr(sys, "argv", ["speed", "--rounds", "0"])
    with pytest.raises(SystemExit):
        speed.main()
    assert "--rounds: must be at least 1, got 0" in capsys.readouterr().err
