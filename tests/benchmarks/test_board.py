"""Rollouts, suites, results on disk and the command line, run as a user runs them."""

import builtins
import csv
import json
from pathlib import Path

import numpy as np
import pytest

import controllers
from benchmarks import cli, results
from benchmarks.metrics import METRICS, measure
from benchmarks.rollout import rollout
from benchmarks.runner import run_cell
from benchmarks.suite import Cell, leaderboard, leaderboard_scenarios
from fbl_gym import TwoLinkArmEnv, scenarios


def test_a_lane_of_a_rollout_is_the_single_environment():
    """Position and torque of each seed are those of a plain loop over the single environment."""
    found = rollout("cascade-flm", scenarios.get("everything-2"), [3, 8])
    for lane, seed in enumerate((3, 8)):
        env = TwoLinkArmEnv("everything-2")
        policy, state = controllers.make("cascade-flm", env), None
        observation, _ = env.reset(seed=seed)
        for k in range(200):
            np.testing.assert_allclose(found.position[k, lane], env.truth.position, rtol=0, atol=1e-12)
            np.testing.assert_allclose(found.reference[k, lane], env.truth.reference, rtol=0, atol=1e-12)
            action, state = policy.predict(observation, state)
            observation = env.step(action)[0]


def test_all_policies_meet_the_same_worlds():
    one = rollout("pid-flm", scenarios.get("disturbance-1"), range(4))
    two = rollout("cascade-flm", scenarios.get("disturbance-1"), range(4))
    np.testing.assert_array_equal(one.disturbance, two.disturbance)
    np.testing.assert_array_equal(one.reference, two.reference)


def test_a_rollout_repeats_bit_for_bit():
    one, two = (rollout("cascade-flm", scenarios.get("everything-3"), range(3)) for _ in range(2))
    np.testing.assert_array_equal(one.position, two.position)


def test_a_diverged_lane_stays_dead_and_leaves_the_others_alone():
    scenario = scenarios.get("disturbance-3")
    found = rollout("zero", scenario, range(16))
    dead = ~found.alive[-1]
    assert dead.any()
    assert np.all(np.diff(found.alive.astype(int), axis=0) <= 0)
    survivor = rollout("zero", scenario, [int(np.flatnonzero(~dead)[0])]) if (~dead).any() else None
    if survivor is not None:
        np.testing.assert_array_equal(survivor.position[:, 0], found.position[:, np.flatnonzero(~dead)[0]])
    assert [row["diverged"] for row in measure(found)] == list(dead.astype(float))
    # What was asked of it goes on, and is what was asked of the others.
    np.testing.assert_array_equal(found.reference, rollout("pd-gravity", scenario, range(16)).reference)


def test_the_suite_covers_every_family_on_both_arms():
    names = leaderboard_scenarios()
    assert len(names) == len(set(names)) == 2 * (1 + 3 * (len(scenarios.families()) - 1))
    cells = leaderboard(seeds=range(2))
    assert len(cells) == len(names) * len(controllers.names())
    assert {cell.seeds for cell in cells} == {(0, 1)}
    assert [c.scenario for c in leaderboard(["zero"], ["stiction"])] == [
        f"{arm}stiction-{s}" for arm in ("", "section-2-2/") for s in (1, 2, 3)
    ]


def test_a_failing_policy_is_a_row_with_its_error(monkeypatch):
    monkeypatch.setattr(controllers, "make", lambda *_: 1 / 0)
    result = run_cell(Cell("pid-flm", "nominal", (0,)))
    assert result.rows == ()
    assert "ZeroDivisionError" in result.error


def test_leaderboard_command(tmp_path, capsys):
    arguments = ["leaderboard", "--seeds", "2", "--scenarios", "mass-error-1", "section-2-2/nominal"]
    assert cli.main([*arguments, "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    for word in ("mass-error-1", "cascade-", "(oracle-", "Arm section-2-2", "leaderboard.csv"):
        assert word in shown.replace("\n", "")
    with (tmp_path / "leaderboard.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * 2 * len(controllers.names())
    assert set(rows[0]) == {"policy", "scenario", "seed", *METRICS}
    document = json.loads((tmp_path / "leaderboard.json").read_text())
    assert {cell["id"] for cell in document["cells"]} >= {"zero/mass-error-1", "oracle-flm/section-2-2/nominal"}
    assert document["packages"]["gymnasium"]
    mean = {cell["id"]: cell["mean"]["error_pct"] for cell in document["cells"]}
    assert mean["oracle-flm/mass-error-1"] < mean["cascade-flm/mass-error-1"] < mean["zero/mass-error-1"]
    assert not list(tmp_path.glob(".*"))


def test_a_killed_run_leaves_what_it_had(tmp_path, monkeypatch):
    """Results are written while the run goes on: here after each cell, and the run dies in the second."""
    monkeypatch.setattr(cli, "SAVE_EVERY", 0.0)
    first = run_cell(Cell("zero", "nominal", (0,)))

    def dies(_):
        yield first
        raise SystemExit(137)

    monkeypatch.setattr("benchmarks.runner.run", dies)
    with pytest.raises(SystemExit):
        cli.main(["leaderboard", "--seeds", "1", "--out", str(tmp_path)])
    (cell,) = json.loads((tmp_path / "leaderboard.json").read_text())["cells"]
    assert cell["id"] == "zero/nominal"


def test_evaluate_command_with_a_plot(tmp_path, capsys):
    picture = tmp_path / "trace.png"
    assert cli.main(["evaluate", "pid-flm", "--scenario", "paper-3a", "--seeds", "1", "--plot", str(picture)]) == 0
    shown = capsys.readouterr().out
    assert "[mrad]" in shown.replace("\n", "")
    assert "settling_s" in shown
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_the_papers_pid_settles_with_a_perfect_model_and_not_with_half_of_it():
    """Figures 3a and 3b: settled within each step, against far off."""
    perfect = measure(rollout("pid-flm", scenarios.get("paper-3a"), [0]))[0]
    half = measure(rollout("pid-flm", scenarios.get("paper-3b"), [0]))[0]
    assert perfect["settling_s"] < 4.0
    assert perfect["steady_1_pct"] < 5.0
    assert half["error_pct"] > 3 * perfect["error_pct"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "pid-fml"], "did you mean 'pid-flm'"),
        (["evaluate", "zero", "--scenario", "paper-3"], "did you mean 'paper-3"),
        (["leaderboard", "--policies", "nobody"], "unknown policy 'nobody'"),
        (["leaderboard", "--scenarios", "everythin"], "unknown scenario 'everythin'"),
    ],
)
def test_wrong_names_are_named(arguments, message, capsys):
    assert cli.main(arguments) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("seeds", ["0", "-1", "many"])
def test_seeds_must_be_a_number(seeds, capsys):
    with pytest.raises(SystemExit):
        cli.main(["evaluate", "zero", "--seeds", seeds])
    assert "whole number" in capsys.readouterr().err


def test_a_missing_extra_is_named(monkeypatch, capsys):
    real = builtins.__import__

    def without_matplotlib(name, *rest, **options):
        if name.startswith("matplotlib"):
            raise ImportError(f"No module named {name!r}")
        return real(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", without_matplotlib)
    assert cli.main(["evaluate", "zero", "--plot", "x.png"]) == 2
    assert "pip install 'fbl-gym[bench]'" in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path, capsys):
    blocked = tmp_path / "file"
    blocked.write_text("")
    arguments = ["leaderboard", "--seeds", "1", "--policies", "zero", "--scenarios", "nominal", "--out", str(blocked)]
    assert cli.main(arguments) == 2
    assert "file" in capsys.readouterr().err


def test_a_full_disk_leaves_the_old_results(tmp_path, monkeypatch):
    """A write that fails halfway neither destroys what was there nor leaves its rubbish behind."""
    done = [run_cell(Cell("zero", "nominal", (0,)))]
    results.write(tmp_path, done, "first")
    before = (tmp_path / "leaderboard.csv").read_text()

    def full(self, text, **_):
        with self.open("w") as file:
            file.write(text[:10])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space left"):
        results.write(tmp_path, done * 2, "second")
    assert (tmp_path / "leaderboard.csv").read_text() == before
    assert not list(tmp_path.glob(".*"))


def test_lists(capsys):
    assert cli.main(["list", "policies"]) == 0
    assert cli.main(["list", "scenarios"]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in (*controllers.names(), *scenarios.names()))
