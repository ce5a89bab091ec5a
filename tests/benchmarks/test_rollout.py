"""Rollouts: `benchmarks.evaluate`, repeated trials, signals of `evaluate --trace`, sweeps over options, tables for LaTeX."""

import csv
import dataclasses

import numpy as np
import pytest
from scipy.io import loadmat

import benchmarks
import controllers
from benchmarks.report.latex import escape, write_table
from benchmarks.run.expansion import with_option
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import _stacked, rollout, rollout_trials
from benchmarks.run.suite import load
from benchmarks.run.traces import table
from fbl_gym import TwoLinkArmVectorEnv, scenarios

SHORT = scenarios.get("servo-practice-noise-3").replace(duration=1.0)


def rows(path):
    with open(path) as file:
        return list(csv.DictReader(file))


def test_a_policy_that_does_not_learn_repeats_its_first_trial_but_for_the_noise():
    first, second = rollout_trials("computed-torque", SHORT, range(2), 2)
    alone = rollout("computed-torque", SHORT, range(2))
    for name in ("position", "torque", "reference"):
        np.testing.assert_array_equal(getattr(first, name), getattr(alone, name))
    np.testing.assert_array_equal(first.reference, second.reference)
    np.testing.assert_array_equal(first.lengths, second.lengths)
    assert 0 < np.abs(first.position - second.position).max() < 0.05
    quiet = SHORT.replace(noise=None, duration=2.0)
    for law, seeds in (("computed-torque", (0, 1)), ("zero", (0,))):
        first, second = rollout_trials(law, quiet, seeds, 2)
        np.testing.assert_array_equal(first.position, second.position)
    assert not first.alive[-1].any()  # a run that diverged takes part in the next trial
    assert second.alive[0].all()


def test_the_command_prints_each_trial_and_writes_all_runs(folder, fbl_gym):
    (folder / "short.toml").write_text('base = "servo-practice-nominal"\nduration = 2.0')
    line = "evaluate zero computed-torque-ilc --scenario short.toml --trials 2 --seeds 3"
    assert " diverged" in fbl_gym(f"{line} --csv runs.csv --plot trials.pdf").out
    runs = rows("runs.csv")
    assert [(run["trial"], run["seed"]) for run in runs[:6]] == [(k, s) for k in "12" for s in "012"]
    errors = [float(run["error_pct"]) for run in runs[6:]]
    assert sum(errors[3:]) < 0.9 * sum(errors[:3])
    assert (folder / "trials.pdf").stat().st_size > 1000


@pytest.mark.parametrize("suite", ["geared", "ideal"])
def test_a_law_that_learns_over_trials_is_not_on_a_board_of_single_ones(suite):
    assert not any("ilc" in policy for policy in load(suite).policies)


LAW, TASK = "cascade-flm+eso", "servo-elastic-2"


@pytest.fixture(scope="module")
def signals():
    """Return the signals of two seeds of a law with an integral and an observer, [seed, sample] each."""
    (trace,) = rollout_trials(LAW, scenarios.get(TASK).replace(duration=0.4), (0, 1), 1, detailed=True)
    return {name: column.reshape(2, 41) for name, column in table(trace).items()}


def test_signals_are_those_of_the_environment_and_the_policy(signals):
    def both(name, k):
        return np.stack([signals[name.format(joint)][:, k] for joint in (1, 2)], axis=1)

    env = TwoLinkArmVectorEnv(2, scenarios.get(TASK).replace(duration=0.4))
    policy, state, action = controllers.make(LAW, env), None, np.zeros((2, 2))
    observation, _ = env.reset(seed=[0, 1])
    for k in range(41):
        truth = env.truth
        for sensor, unit in (("position", "rad"), ("velocity", "rad_s")):
            measured = both(f"measured_{sensor}_{{}}_{unit}", k)
            np.testing.assert_array_equal(measured, observation[:, env.layout[sensor]])
            np.testing.assert_array_equal(both(f"motor_{sensor}_{{}}_{unit}", k), getattr(truth, f"motor_{sensor}"))
        np.testing.assert_array_equal(both("torque_{}_Nm", k), truth.applied_torque)
        if state is not None:
            for i in range(4):
                np.testing.assert_array_equal(both(f"state_memory_{{}}_{i + 1}", k), state.memory[..., i])
            np.testing.assert_array_equal(both("state_inside_integral_{}", k), state.inside.integral)
            np.testing.assert_allclose(both("command_{}_Nm", k), action * env.interface.torque_limit)
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
    assert np.isnan(both("state_memory_{}_1", 0)).all()
    np.testing.assert_array_equal(_stacked([{}, {}, {"late": np.ones(1)}])["late"], [[np.nan], [np.nan], [1]])
    assert (np.abs(both("motor_position_{}_rad", 20) - both("position_{}_rad", 20)) > 1e-4).any()


def test_a_file_has_the_numbers_of_the_table(signals, tmp_path, fbl_gym):
    (tmp_path / "short.toml").write_text(f'base = "{TASK}"\nduration = 0.4\n')
    for laws, trace in ((LAW, "trace.csv"), (f"{LAW} zero", "two.mat")):
        fbl_gym(f"evaluate {laws} --scenario short.toml --seeds 2 --trace {trace}")
    own, zero = (loadmat(path) for path in sorted(tmp_path.glob("two-*.mat")))
    assert np.count_nonzero(zero["command_1_Nm"]) == 2  # at the start, it holds the arm still
    samples = rows(tmp_path / "trace.csv")
    assert (len(samples), list(samples[0])) == (2 * 41, list(signals))
    for name, numbers in signals.items():
        written = np.array([float(row[name]) for row in samples])
        np.testing.assert_allclose(written, numbers.ravel(), rtol=1e-9, err_msg=name)
        np.testing.assert_array_equal(own[name].ravel(), numbers.ravel(), err_msg=name)


@pytest.fixture(autouse=True)
def arm(folder):
    (folder / "arm.toml").write_text('base = "noise-1"\nduration = 0.5')
    limits = "limits.error = 0.1\nlimits.error_time = 0.1"
    (folder / "diverging.toml").write_text(f'base = "noise-1"\nduration = 2.0\n{limits}')


def test_an_option_changes_where_its_path_leads():
    base = scenarios.get("noise-1")
    scenario = with_option(base, "noise.position", 0.01)
    assert (scenario.name, scenario.noise.position.sigma) == ("noise-1,noise.position=0.01", (0.01, 0.01))
    assert scenario.noise.velocity == base.noise.velocity
    assert with_option(base, "arm.m1", 7.0).arm.m1 == 7.0
    assert with_option(base, "datasheet.lag", 0.002).datasheet.lag == 0.002  # without one before
    # Ranges that agents generalise over are values of the radius.
    trained_on = scenarios.get("everything-2")
    swept = with_option(trained_on, "parameter_error.radius", 2.0)
    assert swept.parameter_error == dataclasses.replace(trained_on.parameter_error, radius=2.0)


def test_a_factor_multiplies_both_joints_and_the_ends_of_a_distribution():
    base = scenarios.get("servo-friction-2")
    half = with_option(base, "friction.coulomb", 0.5, factor=True)
    assert half.name == "servo-friction-2,friction.coulomb=x0.5"
    for one, other in zip(half.friction.coulomb, base.friction.coulomb, strict=True):
        np.testing.assert_array_equal(one.uniform, 0.5 * np.array(other.uniform))
    limit = with_option(base, "actuator.torque_limit", 2.0, factor=True).actuator.torque_limit
    np.testing.assert_array_equal(limit, 2.0 * np.array(base.actuator.torque_limit))
    late = with_option(base, "encoder.latency", 1.0)
    assert with_option(late, "encoder.latency", 3.0, factor=True).encoder.latency == 3
    with pytest.raises(ValueError, match=r"joint.stiffness must be numbers to multiply by x2, got None: give values"):
        with_option(base, "joint.stiffness", 2.0, factor=True)


def test_a_sweep_goes_on_in_the_store(folder, fbl_gym):
    line = "sweep pd-gravity zero --over noise.position=1e-4:1e-2:log:3 --scenario arm.toml --seeds 2 --workers 1"
    fbl_gym(line)
    runs = rows("results/sweep.csv")
    assert [run["noise.position"] for run in runs[::4]] == ["0.0001", "0.001", "0.01"]
    stored = {path: path.stat().st_mtime_ns for path in (folder / "results/board").iterdir()}
    fbl_gym(line)
    assert stored == {path: path.stat().st_mtime_ns for path in (folder / "results/board").iterdir()}


def test_two_options_give_every_pair_of_values(folder, fbl_gym):
    line = "sweep pd-gravity --over arm.m2=2,4 --over noise.position=0:1e-2:lin:2 --scenario arm.toml --seeds 1"
    fbl_gym(f"{line} --workers 1 --csv two.csv --plot two.svg")
    pairs = [(run["arm.m2"], run["noise.position"]) for run in rows("two.csv")]
    assert pairs == [("2.0", "0.0"), ("2.0", "0.01"), ("4.0", "0.0"), ("4.0", "0.01")]
    assert all(f"pd-gravity, noise.position {level}<" in (folder / "two.svg").read_text() for level in ("0", "0.01"))
    shown = fbl_gym("sweep zero --over arm.m2=x0.5:2:log:3 --scenario arm.toml --seeds 1 --workers 1").out
    assert "factor on arm.m2" in shown
    assert [run["arm.m2"] for run in rows("results/sweep.csv")] == ["0.5", "1.0", "2.0"]
    lost = fbl_gym("sweep zero --over arm.m2=2,4000 --scenario diverging.toml --seeds 2 --workers 1 --tex lost.tex").out
    assert "2 lost" in lost
    assert "arm.m2 [kg] & zero" in (folder / "lost.tex").read_text()


@pytest.mark.parametrize(("text", "latex"), [
    ("my_law.py 5 %", r"my\_law.py 5 \%"),
    ("a\\b{c}~d^2 & #1 $", r"a\textbackslash{}b\{c\}\textasciitilde{}d\textasciicircum{}2 \& \#1 \$"),
    ("-1.0 (-2–3)\n0 (≤5)", r"$-$1.0 ($-$2--3) 0 ($\le$5)"),
    ("computed-torque-dob 1e-3", "computed-torque-dob 1e-3"),
])  # fmt: skip
def test_a_text_is_printed_as_it_is(text, latex):
    assert escape(text) == latex


def test_columns_of_numbers_are_to_the_right(tmp_path):
    rows = [("l1", "-1.0", "none"), ("zero", "(2)", "all")]
    write_table(tmp_path / "t.tex", ("law", "error %", "access"), rows, "fbl-gym\nevaluate")
    assert (tmp_path / "t.tex").read_text().splitlines() == [
        "% fbl-gym evaluate", r"% \usepackage{booktabs}", r"\begin{tabular}{lrl}", r"\toprule", r"law & error \% & access \\",
        r"\midrule", r"l1 & $-$1.0 & none \\", r"zero & (2) & all \\", r"\bottomrule", r"\end{tabular}",
    ]  # fmt: skip


@pytest.mark.parametrize(("line", "least", "columns"), [
    ("evaluate pd-gravity --plot lines.png", 15, 3), ("evaluate pd-gravity zero --plot lines.png", 2, 6),
    ("evaluate pd-gravity zero --trials 2", 2, 3),
    ("sweep pd-gravity zero --over encoder.latency=0,1,2 --workers 1", 3, 3),
    ("leaderboard --policies pd-gravity zero oracle-flm --scenarios arm.toml --workers 1", 3, 7),
])  # fmt: skip
def test_commands_write_their_table(line, least, columns, folder, fbl_gym):
    scenario = "" if "leaderboard" in line else "--scenario arm.toml"
    assert "table: table.tex" in fbl_gym(f"{line} {scenario} --seeds 2 --tex table.tex").out
    assert ("--plot" in line) == (folder / "lines.png").exists()
    body = (folder / "table.tex").read_text().split("\\midrule\n")[1].split("\\bottomrule")[0].splitlines()
    assert len(body) >= least
    assert all(row.count("&") >= columns - 1 and row.endswith(r"\\") for row in body)


NOMINAL = scenarios.get("servo-nominal").replace(duration=0.5)


def test_the_table_has_the_metrics_of_each_run():
    runs = benchmarks.evaluate("pid-flm", NOMINAL, seeds=2, kp=50.0)
    rows = measure(rollout("pid-flm", NOMINAL, [0, 1], {"kp": 50.0}))
    assert runs.to_dict("records") == [{name: row[name] for name in runs.columns} for row in rows]
    assert "overshoot_pct" not in runs.columns  # of steps
    assert [[*each.index] for each in (runs, benchmarks.evaluate("zero", NOMINAL, seeds=[7]))] == [[0, 1], [7]]


@pytest.mark.parametrize(("given", "message"), [
    ({"seeds": 0}, "seeds must be"), ({"seeds": 2.5}, r"seeds must be a whole number .*got 2\.5"),
    ({"k": 1.0}, "argument of pid-flm 'k'"), ({"scenario": "servo-nominl"}, "nominal"),
    ({"policy": {}}, "policy must be a name or a path, got a dict: save it"),
])  # fmt: skip
def test_a_mistake_is_named(given, message):
    with pytest.raises(ValueError, match=message):
        benchmarks.evaluate(**{"policy": "pid-flm", "scenario": NOMINAL, **given})


def test_a_diverged_lane_stays_dead_and_leaves_the_others_alone():
    scenario = scenarios.get("everything-3").replace(duration=0.4, limits={"velocity": 4.0})
    found = rollout("zero", scenario, range(16))
    dead = ~found.alive[-1]
    assert dead.any()
    assert np.all(np.diff(found.alive.astype(int), axis=0) <= 0)
    alive = int(np.flatnonzero(~dead)[0])
    np.testing.assert_array_equal(rollout("zero", scenario, [alive]).position[:, 0], found.position[:, alive])
    assert [row["diverged"] for row in measure(found)] == list(dead.astype(float))
    # What was asked of it goes on, and is what was asked of the others.
    np.testing.assert_array_equal(found.reference, rollout("pd-gravity", scenario, range(16)).reference)
