"""Learning curves, grouped over training seeds."""

import json

import numpy as np
import pytest

from benchmarks.analysis.curves import read_groups
from benchmarks.cli.parser import main


@pytest.fixture
def runs(tmp_path):
    """Two runs of PPO, with the errors 8, 2, 4 and 8, 8, 8 at 100, 200, 300 steps, and a slower one of SAC."""
    for name, seed, errors, cpu in (("ppo-0", 0, (8, 2, 4), 1), ("ppo-1", 1, (8, 8, 8), 1), ("sac-0", 0, (8, 1, 1), 5)):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "run.json").write_text(json.dumps({"algorithm": name[:3], "seed": seed}))
        rows = [f"{100 * i},{9 * i},{cpu * i},{error}" for i, error in enumerate(errors, 1)]
        (folder / "curve.csv").write_text("\n".join(["steps,wall_s,cpu_s,validation_mrad", *rows]) + "\n")
    return [tmp_path / name for name in ("ppo-0", "ppo-1", "sac-0")]


def test_runs_are_grouped_over_their_seeds_and_keep_their_best_agent(runs):
    ppo, sac = read_groups(runs)
    assert (ppo.name, len(ppo.runs), sac.name, len(sac.runs)) == ("ppo", 2, "sac", 1)
    np.testing.assert_array_equal(ppo.errors("steps", np.array([50, 100, 250, 300])), [[8, 8, 2, 2], [8, 8, 8, 8]])
    assert ppo.estimate("steps", np.array([300])).value == pytest.approx([4.0])


def test_the_command_compares_after_equal_steps_and_equal_time(runs, tmp_path, capsys):
    assert main(["curves", *map(str, runs), "--plot", str(tmp_path / "curves.svg")]) == 0
    out = capsys.readouterr().out
    assert "after 300 steps" in out
    assert "after 3 s" in out
    assert "ppo" in (tmp_path / "curves.svg").read_text()


def test_a_folder_without_a_run_and_a_run_given_twice_are_refused(runs, tmp_path, capsys):
    for wrong, text in ((tmp_path, "RUN must be a folder of fbl-gym train"), (runs[0], "RUN must differ")):
        assert main(["curves", str(runs[0]), str(wrong)]) == 2
        assert text in capsys.readouterr().err
