"""Repeated trials: one arm and one motion for each seed, the policy's state goes on, and noise is new."""

import csv

import numpy as np
import pytest

from benchmarks import cli
from benchmarks.run.rollout import rollout, rollout_trials
from benchmarks.run.suite import load
from fbl_gym import scenarios

SHORT = scenarios.get("servo-practice-noise-3").replace(duration=1.0)


def test_a_policy_that_does_not_learn_repeats_its_first_trial_but_for_the_noise():
    first, second = rollout_trials("computed-torque", SHORT, range(2), 2)
    alone = rollout("computed-torque", SHORT, range(2))
    for name in ("position", "torque", "reference"):
        np.testing.assert_array_equal(getattr(first, name), getattr(alone, name))
    np.testing.assert_array_equal(first.reference, second.reference)
    np.testing.assert_array_equal(first.lengths, second.lengths)
    assert 0 < np.abs(first.position - second.position).max() < 0.05
    quiet = SHORT.replace(noise=None)
    first, second = rollout_trials("computed-torque", quiet, range(2), 2)
    np.testing.assert_array_equal(first.position, second.position)


def test_a_run_that_diverged_takes_part_in_the_next_trial():
    first, second = rollout_trials("zero", SHORT.replace(duration=2.0), [0], 2)
    assert not first.alive[-1].any()
    assert second.alive[0].all()
    np.testing.assert_array_equal(first.reference, second.reference)


def test_the_command_prints_each_trial_and_writes_all_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.toml").write_text('base = "servo-practice-nominal"\nduration = 2.0')
    line = (
        "evaluate zero computed-torque-ilc --scenario short.toml --trials 2 --seeds 3 --csv runs.csv --plot trials.pdf"
    )
    assert cli.main(line.split()) == 0
    assert " diverged" in capsys.readouterr().out
    with open("runs.csv") as file:
        runs = list(csv.DictReader(file))
    assert [(run["trial"], run["seed"]) for run in runs[:6]] == [(k, s) for k in "12" for s in "012"]
    errors = [float(run["error_pct"]) for run in runs[6:]]
    assert sum(errors[3:]) < 0.9 * sum(errors[:3])
    assert (tmp_path / "trials.pdf").stat().st_size > 1000


@pytest.mark.parametrize("suite", ["geared", "ideal"])
def test_a_law_that_learns_over_trials_is_not_on_a_board_of_single_ones(suite):
    assert not any("ilc" in policy for policy in load(suite).policy_names)
