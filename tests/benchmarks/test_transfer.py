"""Orders of policies in two worlds: tau against SciPy's, pairs that are not separated, and the command."""

import numpy as np
import pytest
from scipy.stats import kendalltau

from benchmarks import cli
from benchmarks.analysis.transfer import Runs, compare_halves, compare_orders


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
        assert agreement.pairs == agreement.clear_pairs == 28
        assert agreement.tau == agreement.clear_tau
        assert agreement.tau == pytest.approx(kendalltau(first, second).statistic)
    assert compare_halves(runs(np.outer(first, spread))) == compare_orders(*[runs(np.outer(first, spread))] * 2)


def test_pairs_that_one_world_does_not_separate_are_not_clear():
    rng = np.random.default_rng(1)
    alike = runs(rng.lognormal(size=(2, 400)))
    apart = np.array([[1.0], [5.0]]) * rng.lognormal(sigma=0.1, size=(2, 400))
    assert compare_orders(runs(apart), runs(apart[::-1])) == compare_orders(runs(apart[::-1]), runs(apart))
    assert compare_orders(runs(apart), runs(apart[::-1])).tau == -1.0
    assert compare_orders(alike, runs(apart)).clear_pairs == compare_halves(alike).clear_pairs == 0
    assert np.isnan(compare_orders(alike, runs(apart)).clear_tau)
    assert abs(compare_orders(alike, runs(apart)).tau) == compare_orders(alike, runs(apart)).pairs == 1


def test_a_policy_that_diverges_on_both_sides_has_no_place():
    errors = np.outer([1.0, 2.0, 90.0], np.linspace(0.9, 1.1, 8))
    lost = np.array([0.0, 0.0, 1.0])[:, None, None]
    assert compare_orders(runs(errors), runs(errors)).pairs == 3
    assert compare_orders(runs(errors, lost), runs(errors, lost)).pairs == 1
    assert compare_orders(runs(errors, lost), runs(errors)).pairs == 3


def test_the_command_prints_both_boards_and_tau(tmp_path, capsys):
    pytest.importorskip("mujoco")
    broken = tmp_path / "broken.py"
    broken.write_text("def make_policy(interface):\n    raise ValueError('no gains')\n")
    (tmp_path / "short.toml").write_text('base = "servo-nominal"\nduration = 2.0\n')
    base = ["leaderboard", "--world", "mujoco-lab", "--workers", "1", "--store", str(tmp_path)]
    line = [*base, "--policies", "computed-torque", "pd-gravity", "oracle-flm", str(broken)]
    assert cli.main([*line, "--seeds", "4", "--scenarios", str(tmp_path / "short.toml")]) == 1
    out = capsys.readouterr().out
    lines = [words for text in out.splitlines() if (words := text.split())]
    assert next(words for words in lines if words[0] == "mujoco-lab")[1] == "1.00"
    places = [tuple(words[:2]) for words in lines if words[0] in ("computed-torque", "pd-gravity")]
    assert places == [("computed-torque", "1–2"), ("pd-gravity", "1–2")] * 2
    assert any(words[0] == "(oracle-flm)" for words in lines)
    assert f"Left out: {broken}: ValueError: no gains" in " ".join(out.split())
    assert len(list(tmp_path.glob("*.json"))) == 6
    with pytest.raises(SystemExit):
        cli.main([*base, "mujoco-soft"])
    assert cli.main([*base, "--policies", "pd-gravity", "--seeds", "2"]) == 2
    assert "--seeds must be at least 4" in capsys.readouterr().err
