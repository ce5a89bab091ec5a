"""Orders of policies in two worlds: tau against SciPy's, pairs that are not separated, and the command."""

import numpy as np
import pytest
from scipy.stats import kendalltau

from benchmarks import cli
from benchmarks.analysis.transfer import compare_orders


def test_tau_is_kendalls_where_all_pairs_are_separated():
    rng = np.random.default_rng(0)
    for _ in range(20):
        first, second = rng.permutation(8.0 * np.arange(1, 9)), rng.permutation(8.0 * np.arange(1, 9))
        spread = rng.uniform(0.99, 1.01, 16)  # the same runs for all: differences are exact
        agreement = compare_orders(np.outer(first, spread), np.outer(second, spread))
        assert agreement.pairs == 28
        assert agreement.tau == pytest.approx(kendalltau(first, second).statistic)


def test_pairs_that_one_world_does_not_separate_are_left_out():
    rng = np.random.default_rng(1)
    alike = rng.lognormal(size=(2, 400))
    apart = np.array([[1.0], [5.0]]) * rng.lognormal(sigma=0.1, size=(2, 400))
    assert compare_orders(apart, apart[::-1]) == compare_orders(apart[::-1], apart)
    assert compare_orders(apart, apart[::-1]).tau == -1.0
    assert compare_orders(alike, apart).pairs == 0
    assert np.isnan(compare_orders(alike, apart).tau)


def test_errors_below_the_floor_are_equal():
    errors = np.array([[1e-9, 2e-9, 1e-8], [1e-5, 1e-6, 3e-5]])
    assert compare_orders(errors, errors).pairs == 0


def test_the_command_prints_errors_and_tau(tmp_path, capsys):
    pytest.importorskip("mujoco")
    arguments = ["transfer", "computed-torque", "pd-gravity", "zero", "--seeds", "2", "--workers", "1"]
    arguments += ["--world", "mujoco", "mujoco-bend", "--store", str(tmp_path), "--scenario", "mass-error-1"]
    assert cli.main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    assert next(line for line in lines if "tau (pairs)" in line).split()[2:4] == ["1.00", "(3)"]
    assert len(list(tmp_path.glob("*.json"))) == 9
    assert sum("mass-error-1@mujoco-bend--" in path.name for path in tmp_path.iterdir()) == 3
    with pytest.raises(SystemExit):
        cli.main([*arguments, "--world", "mujoco-soft"])
    assert cli.main(["transfer", "pd-gravity", "--scenario", "mass-error-9"]) == 2
