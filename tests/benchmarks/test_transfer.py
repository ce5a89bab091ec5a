"""Orders of policies in two worlds: tau against SciPy's, pairs that are not separated, and the command."""

import numpy as np
import pytest
from scipy.stats import kendalltau

from benchmarks import cli
from benchmarks.analysis.transfer import Runs, compare_halves, compare_orders, transfer_best


def runs(errors, diverged=0.0):
    """Return runs [policies x scenarios x seeds] of errors that broadcast to it."""
    errors = np.asarray(errors)
    errors = errors[:, None] if errors.ndim == 2 else errors
    return Runs(errors, np.broadcast_to(diverged, errors.shape))


def test_tau_is_kendalls_where_all_pairs_are_separated():
    rng = np.random.default_rng(0)
    for _ in range(20):
        first, second = rng.permutation(8.0 * np.arange(1, 9)), rng.permutation(8.0 * np.arange(1, 9))
        spread = rng.uniform(0.99, 1.01, 16)
        agreement = compare_orders(runs(np.outer(first, spread)), runs(np.outer(second, spread)))
        assert agreement.pairs == 28
        assert agreement.tau == pytest.approx(kendalltau(first, second).statistic)
    assert compare_halves(runs(np.outer(first, spread))) == compare_orders(*[runs(np.outer(first, spread))] * 2)


def test_pairs_that_one_world_does_not_separate_are_left_out():
    rng = np.random.default_rng(1)
    alike = runs(rng.lognormal(size=(2, 400)))
    apart = np.array([[1.0], [5.0]]) * rng.lognormal(sigma=0.1, size=(2, 400))
    assert compare_orders(runs(apart), runs(apart[::-1])) == compare_orders(runs(apart[::-1]), runs(apart))
    assert compare_orders(runs(apart), runs(apart[::-1])).tau == -1.0
    assert compare_orders(alike, runs(apart)).pairs == 0
    assert np.isnan(compare_orders(alike, runs(apart)).tau)
    assert compare_halves(alike).pairs == 0


def test_a_policy_that_diverges_on_both_sides_has_no_place():
    errors = np.outer([1.0, 2.0, 90.0], np.linspace(0.9, 1.1, 8))
    lost = np.array([0.0, 0.0, 1.0])[:, None, None]
    assert compare_orders(runs(errors), runs(errors)).pairs == 3
    assert compare_orders(runs(errors, lost), runs(errors, lost)).pairs == 1
    assert compare_orders(runs(errors, lost), runs(errors)).pairs == 3


def test_the_best_in_the_other_world():
    """Diverged runs have their price; ratios are to the best ranked policy there."""
    spread = np.ones((1, 2, 100))
    package, world = (np.array(each)[:, None, None] * spread for each in ([1.0, 2.0, 1.5, 0.1], [4.0, 1.0, 2.0, 0.1]))
    lost = np.zeros((4, 2, 100))
    lost[0, 0, :1] = 1.0  # 1.8 %, of one scenario out of two: as much as an error of 1.9 %
    world[1, 1] = 3.0
    ranked = np.array([True, True, True, False])
    best = transfer_best(Runs(package, lost), Runs(world, lost), ranked, 5)
    assert [row.policy for row in best] == [2, 0, 1]
    assert [row.diverged for row in best] == [0, 1, 0]
    assert [row.scenario for row in best] == [0, 0, 1]
    np.testing.assert_allclose([row.ratio for row in best], [2 / 3**0.5, 4 / 3**0.5, 1.0])
    np.testing.assert_allclose([row.worst for row in best], [2.0, 4.0, 1.5])


def test_the_command_prints_tau_and_the_best(tmp_path, capsys):
    pytest.importorskip("mujoco")
    broken = tmp_path / "broken.py"
    broken.write_text("def make_policy(interface):\n    raise ValueError('no gains')\n")
    arguments = ["transfer", "computed-torque", "pd-gravity", "zero", str(broken), "--seeds", "4", "--workers", "1"]
    arguments += ["--store", str(tmp_path), "--scenario", "hardware-nominal", "hardware-delay-2", "--top", "2"]
    assert cli.main(arguments) == 1
    out, err = capsys.readouterr()
    lines = [line.split() for line in out.splitlines()]
    assert next(line for line in lines if line[:1] == ["all"])[1] == "1.00"
    assert sum("mujoco-lab" in line for line in lines) == 3
    assert f"without {broken}, which failed: " in err
    assert len(list(tmp_path.glob("*.json"))) == 12
    assert cli.main([*arguments, "--markdown", "--world", "mujoco-bend"]) == 1
    assert "| all | " in capsys.readouterr().out
    with pytest.raises(SystemExit):
        cli.main([*arguments, "--world", "mujoco-soft"])
    assert cli.main(["transfer", "pd-gravity", "--scenario", "mass-error-9"]) == 2
    assert cli.main(["transfer", "pd-gravity", "--seeds", "2"]) == 2
