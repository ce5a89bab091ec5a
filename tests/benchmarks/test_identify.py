"""Identification: logs that are read or refused, arms that are found again, held-out terms, plans."""

import dataclasses
import tomllib
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from scipy.io import savemat

from benchmarks.identification import excitation, result
from benchmarks.identification import fit as fitting
from benchmarks.identification.fit import identify, refuse_meaningless, rollout_errors
from benchmarks.identification.logs import columns, read, refuse_twice, smooth
from benchmarks.identification.model import INDEX, parameters_of, windows
from benchmarks.identification.result import arm_of
from fbl_gym import scenarios
from fbl_gym.model.arm import inertia_matrix
from fbl_gym.records.record import ends
from tests import identification_coverage
from tests.identification_coverage import NAMES, move, write

START = scenarios.get("dfki-c1")
START = START.replace(actuator=dataclasses.replace(START.actuator, lag=0.003))
ROBOT = START.replace(
    arm=dataclasses.replace(START.arm, m1=0.6, m2=0.5, rotor=(START.arm.rotor[0], 1.5 * START.arm.rotor[1])),
    noise={"position": 1e-4}, encoder={"counts": 16384}, sensors=("position",),
    friction={"viscous": (0.02, 0.01), "coulomb": (0.15, 0.1)}, limits={"velocity": 100.0, "position": 100.0},
    actuator={"torque_limit": 10.0, "gain": (0.9, 1.0), "delay": 0.006, "lag": 0.003},
)  # fmt: skip
ZERO = (0.05, -0.04)
TABLES = tomllib.loads(Path(__file__).with_name("logs.toml").read_text(encoding="utf-8"))


def run(seed, zero=(0.0, 0.0), robot=ROBOT, seconds=6.0):
    """Return a log with jitter, whose positions are zero at some angles."""
    generator = np.random.default_rng(seed)
    rows = move(robot.replace(duration=seconds), generator, (0.4, 0.25)) - [0.0, *zero, 0.0, 0.0]
    rows[:, 0] += generator.uniform(-2e-4, 2e-4, len(rows))
    return rows


@pytest.fixture(scope="module")
def rows():
    return [run(0), run(1, ZERO), run(2)]


@pytest.fixture(scope="module")
def files(rows, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    return [write(folder / f"run-{i}.csv", each) for i, each in enumerate(rows)]


@pytest.fixture(scope="module")
def fit(files):
    ticks = []
    found = identify([read(path) for path in files[:2]], START, ticks.append)
    assert len(ticks) == 5
    return found


# Reading.


def test_a_log_says_what_was_found(files):
    log = read(files[0])
    assert log.counts == pytest.approx([16384, 16384], rel=1e-3)
    assert log.remarks[0] == "columns time_s; position_1_rad, position_2_rad; torque_1_Nm, torque_2_Nm"
    assert "3000 samples" in log.remarks[1]
    assert "not logged" in log.remarks[2]
    assert (log.dt, log.sample) == (0.004, pytest.approx(0.002, rel=0.02))


HEADER, DEGREES = ",".join(NAMES), 180 / np.pi
ROS = "%time,field.position0,field.position1,/joint_states/effort[0],/joint_states/effort[1]"


def stamped(text, stamp, name):
    """Return the text of a log with other times."""
    rows = [line.split(",", 1) for line in text.splitlines()]
    return "\n".join([f"{name},{rows[0][1]}", *(f"{stamp(float(time))},{rest}" for time, rest in rows[1:]), ""])


@pytest.mark.parametrize(("change", "factors", "signals"), [
    (lambda t: "\ufeff# my robot, 2026\n" + t, 1, []),
    (lambda t: t.replace(",", ";").replace(".", ","), 1, []),
    (lambda t: t.replace(",", "\t").replace("\n", "\r\n"), 1, []),
    (lambda t: "# " + t.replace(",", " "), 1, []),
    (lambda t: t.partition("\n")[2], 1, ["time=0", "position=1,2", "torque=3,4"]),
    (lambda t: t.replace("time_s", "time [s]"), 1, ["time=time [s]"]),
    (lambda t: t, [1e3, 1, 1, 1, 1], []),
    (lambda t: t.replace("time_s", "stamp_us"), [1e6, 1, 1, 1, 1], ["time=stamp_us"]),
    (lambda t: t, [1, DEGREES, DEGREES, -1, 1 / 0.091], ["position=deg", "torque=-torque_1_Nm,0.091*torque_2_Nm"]),
    (lambda t: t.replace(HEADER, "t,a,b,tau1,tau2"), [1, DEGREES, 1, -1, -1], ["torque=-tau", "position=deg*a,b"]),
    (lambda t: t.replace(HEADER, ROS), 1, []),
    (lambda t: t.replace(HEADER, "stamp,/joint_1/pos,elbow_pos,j1_effort,elbow.effort") + "6.0,0.1,0.1,0", 1, []),
    (lambda t: t.replace(HEADER, "t,θ1,θ2,τ1,τ2"), 1, []),
    (lambda t: t.replace("time_s", "time [ms]"), [1e3, 1, 1, 1, 1], ["time=ms"]),
    (lambda t: t.replace(HEADER, "t,q1,q2,u1,u2"), [1, 1, 1, 0.1, 0.1], ["torque=10*A"]),
    (lambda t: t.replace(HEADER, "t [ms],q1 (deg),q2[°],u1 [N m],u2 (mN·m)"), [1e3, DEGREES, DEGREES, 1, 1e3], []),
    (lambda t: t.replace(HEADER, "t,q1,q2,u1,u2\nms,deg,rad,,Nm"), [1e3, DEGREES, 1, 1, 1], []),
    (lambda t: t.replace(HEADER, "t,q1,q2,u1 [mA],u2 [mA]"), [1, 1, 1, 1e3 / 0.091, 1e3 / 0.091], ["torque=0.091*A"]),
    (lambda t: t.replace(HEADER, "t [s] q1 [deg] q2 [rad] u1 (Nm) u2").replace(",", " "), [1, DEGREES, 1, 1, 1], []),
    (lambda t: t.replace(HEADER, "t;q1;q2;i1;i2").replace(",", "|").replace(";", "|"), 1, ["torque=1*i"]),
    (lambda t: stamped(t, lambda s: f"2026-05-04T12:00:{s:012.9f}Z", "time"), 1, []),
    (lambda t: stamped(t, lambda s: f"{7 + int(s)},{round(1e9 * (s % 1))}", "stamp.sec,stamp.nanosec"), 1, []),
])  # fmt: skip
def test_logs_as_people_have_them(rows, tmp_path, change, factors, signals):
    first = read(write(tmp_path / "run.csv", rows[0]))
    path = write(tmp_path / "other.csv", rows[0] * factors)
    path.write_text(change(path.read_text()), newline="", encoding="utf-16" if signals else "utf-8")
    log = read(path, columns(signals), (0.5, 0.0))
    assert np.c_[log.position - (0.5, 0), log.torque] == pytest.approx(np.c_[first.position, first.torque], abs=1e-8)
    assert ("taken to be in" in log.remarks[0]) == (log.remarks[0].count("in ms") + log.remarks[0].count("in us") > 0)


def test_logs_of_matlab_and_traces(rows, tmp_path):
    """The readings and the commands of a trace are meant, not what acted."""
    named = {"t": rows[0][:, 0], "q1": rows[0][:, 1], "q2": rows[0][:, 2], "u": rows[0][:, 3:].T}
    savemat(tmp_path / "run.mat", named)
    np.savez(tmp_path / "run.npz", **named)
    matlab = read((tmp_path / "run.mat").rename(tmp_path / "run.MAT"))
    assert read(tmp_path / "run.npz").rows == matlab.rows
    assert matlab.position == pytest.approx(read(write(tmp_path / "a.csv", rows[0])).position)
    assert {read(write(tmp_path / "a.csv", rows[0] * [x, 1, 1, 1, 1])).dt for x in (5.02, 5.03)} == {0.01}  # 10.04 ms
    more = np.hstack([rows[0], rows[0][:, 1:] + 1.0])
    measured = ("measured_position_1_rad", "measured_position_2_rad", "command_1_Nm", "command_2_Nm")
    trace = write(tmp_path / "b.csv", more, (*NAMES, *measured))
    assert read(trace).remarks[0] == f"columns time_s; {', '.join(measured[:2])}; {', '.join(measured[2:])}"
    late = np.c_[more[:, :7], np.roll(more[:, 7:], 1, axis=0), more[:, 0]]  # with the command of the row before
    late = read(write(tmp_path / "c.csv", late, (*NAMES, *measured, "alive"))).torque[:-1]
    assert late == pytest.approx(read(trace).torque[:-1], abs=1e-8)
    for text, message in TABLES["signals"]:
        with pytest.raises(ValueError, match=message):
            read(trace, columns([text]))
    currents = write(tmp_path / "d.csv", rows[0], ("t", "q1", "q2", "i1", "i2"))
    with pytest.raises(ValueError, match="torque must not be in a, as 'i1' is"):
        read(currents, columns(["torque=i"]))


def test_a_logged_velocity_is_that_of_the_positions(rows, tmp_path):
    slope = smooth(rows[0][:, 1:3], 0.002, 1)
    names = (*NAMES, "velocity_1", "velocity_2")
    for noise in (0.0, 0.2):
        slope = slope + np.random.default_rng(1).normal(0, noise, slope.shape)
        assert "velocity: measured" in read(write(tmp_path / "a.csv", np.hstack([rows[0], slope]), names)).remarks[2]
    with pytest.raises(ValueError, match=r"velocity 1 must be that of position 1, but shares \d+ % of its motion"):
        read(write(tmp_path / "other.csv", np.hstack([rows[0], slope[:, ::-1]]), names))
    wrong = write(tmp_path / "b.csv", np.hstack([rows[0], DEGREES * slope]), names)
    with pytest.raises(ValueError, match=r"velocity 1 must be that of position 1, but is 5[67]\.\d times as fast"):
        read(wrong)
    named = [name.replace("velocity", "dq") + "[deg/s]" * ("vel" in name) for name in names]
    degrees = write(tmp_path / "c.csv", np.hstack([rows[0], DEGREES * slope]), named)
    assert "velocity: measured" in read(degrees).remarks[2]
    assert "not logged" in read(wrong, columns(["velocity="])).remarks[2]


@pytest.mark.parametrize(("damage", "message"), [
    (lambda r: np.delete(r, slice(1000, 1100), axis=0), r"gap of 0\.2.*before line 1002"),
    (lambda r: r * [1, 1, 0, 1, 1], "position 2 does not change.*unplugged"),
    (lambda r: np.concatenate([r, r]), "1 rows do not, first line 3002"),
    (lambda r: np.where(np.arange(len(r))[:, None] == 7, np.nan, r), "finite.*line 9"),
    (lambda r: r + np.outer(np.arange(len(r)) > 50, [0, 6.3, 0, 0, 0]), "position 1 must not jump.*unwrapped, or degrees"),
    (lambda r: r * np.where(np.arange(len(r))[:, None] < np.abs(r[:, 2]).argmax(), 1, [1, 1, 0, 1, 1]), "unplugged"),
    (lambda r: r[:50], "200 samples"), (lambda r: r[:900], "at least 2 s"),
])  # fmt: skip
def test_a_damaged_log_is_refused(rows, tmp_path, damage, message):
    with pytest.raises(ValueError, match=message):
        read(write(tmp_path / "bad.csv", damage(rows[0])))


def test_a_log_given_twice_is_refused(rows, files, tmp_path, fbl_gym):
    """Under another name, cut and moved in time, too; logs of other motions may start in the same place."""
    again = write(tmp_path / "again.csv", rows[0][200:] + [7.0, 0, 0, 0, 0])
    shown = fbl_gym(f"identify {files[0]} {again} --start dfki-c1", 2).err
    assert "each log must be given once, but run-0.csv and again.csv have the same samples" in shown
    refuse_twice([read(path) for path in files])


def test_a_file_that_is_no_table_is_refused(tmp_path):
    for head, line, count, message in TABLES["no table"]:
        (tmp_path / "bad.csv").write_text(head + line * count)
        with pytest.raises(ValueError, match=f"(?s){message}"):
            read(tmp_path / "bad.csv")


# Fitting.


def test_logs_of_two_robots_or_rates_are_refused(files, tmp_path):
    heavy = ROBOT.replace(arm=dataclasses.replace(ROBOT.arm, m1=0.9, m2=0.75))
    logs = [read(path) for path in (*files, write(tmp_path / "heavy.csv", run(5, robot=heavy)))]
    with pytest.raises(ValueError, match="one robot"):
        identify(logs, START)
    with pytest.raises(ValueError, match="one rate"):
        windows([logs[0], dataclasses.replace(logs[1], dt=2 * logs[1].dt)])


@pytest.mark.parametrize(("change", "message"), [
    (lambda r: r * [1, 1, 1, 0, 0], "torques must not all be zero"),
    (lambda r: r * [1, 1e-4, 1e-4, 1, 1], "must move, but rests"),
    (lambda r: r * [1, 1, 1e-4, 1, 1], "joint 2 must move in some log, but rests"),
    (lambda r: r * [1, 1, 1, 1, 0], "torque 2 is zero in all logs, but --start has a drive there"),
    (lambda r: r * [1, 1, 1, 1, -1], "check the sign of torque 2"),
    (lambda r: r * [1, -1, -1, 1, 1], "check the signs of both positions"),
    (lambda r: r[:, [0, 2, 1, 4, 3]], "check the order of the joints"),
    (lambda r: r + np.c_[0 * r[:, :2], r[:, 1], 0 * r[:, :2]], "position 2 counts from link 1"),
    (lambda r: r + [0, np.pi / 2, 0, 0, 0], "check the zeros of the angles, -1.5708 and"),
    (lambda r: r * [1, 1, 1, 11, 11], "p4 is 10.5 times that of --start. Check units"),
    (lambda r: r * [2, 1, 1, 1, 1], "is time in s?"), (lambda r: r + [0, 0.4, 0, 0, 0], "rad: add them to --zero"),
])  # fmt: skip
def test_a_fit_that_means_nothing_is_refused(rows, tmp_path, monkeypatch, change, message):
    monkeypatch.setattr(fitting, "FOLDS", 2)
    log = read(write(tmp_path / "wrong.csv", change(rows[0])))
    with pytest.raises(ValueError, match=message):
        refuse_meaningless(identify([log], START), START, ["wrong.csv"])


def test_a_fit_is_no_better_than_standing_still(fit):
    still = dataclasses.replace(fit, errors=dict.fromkeys(fit.errors, fit.errors["standing still"]))
    with pytest.raises(ValueError, match=r"its angle 1 errs 1\.00 times as much as standing still; its angle 2"):
        refuse_meaningless(still, START, ["a", "b"])
    refuse_meaningless(fit, START, ["a", "b"])


@pytest.mark.slow
def test_the_drive_that_has_torque_fixes_the_scale(tmp_path, monkeypatch):
    """A pendubot: joint 2 has no torque, and the start is wrong by a fifth."""
    monkeypatch.setattr(fitting, "FOLDS", 2)
    robot = ROBOT.replace(actuator={"torque_limit": (10.0, 0.0), "delay": 0.006})
    rows = run(6, robot=robot, seconds=8.0) * [1, 1, 1, 1, 0]
    arm = dataclasses.replace(START.arm, m1=1.2 * START.arm.m1, m2=1.2 * START.arm.m2)
    start = START.replace(arm=arm, actuator=dataclasses.replace(START.actuator, torque_limit=(10.0, 0.0)))
    found = identify([read(write(tmp_path / "pendubot.csv", rows))], start)
    low, high = found.interval[INDEX["p4"]]
    assert found.passive == (2,)
    assert "gain 1 fixes; gain 2 is unknown" in result.scale_of(found)
    assert 0.998 * low < robot.arm.lumped[3] < 1.002 * high


def test_the_command_of_coverage_counts_intervals_that_hold(capsys, monkeypatch):
    monkeypatch.setattr(fitting, "FOLDS", 2)
    identification_coverage.main(["1"])
    last = capsys.readouterr().out.splitlines()[-1].split()
    assert last[0] == "all"
    assert int(last[1].rstrip("%")) >= 50
    assert int(last[-1]) >= 11


def test_the_simulation_is_the_environments(files):
    """With the true numbers, open-loop errors are those of the sensors."""
    log = read(files[2])
    errors, *_ = rollout_errors(log, parameters_of(ROBOT), 0.5, zeros=False)
    assert np.median(np.abs(errors)) < 2e-3
    assert np.median(np.abs(rollout_errors(log, parameters_of(START), 0.5)[0])) > 0.05


def test_the_arm_and_the_zeros_of_a_log_are_found_again(fit):
    free = [INDEX[name] for name in fit.free]
    assert fit.parameters[free] == pytest.approx(parameters_of(ROBOT)[free], rel=0.15, abs=2e-3)
    assert fit.parameters[INDEX["delay"]] == pytest.approx(0.006, abs=3e-4)  # the data sheet has the lag
    assert {"rotor 2", "gain 1", "viscous 1"} <= set(fit.free)
    assert (np.ptp(fit.interval, axis=1)[free] > 0).all()
    assert fit.weak == {}
    assert fit.zero == pytest.approx(np.array([(0, 0), ZERO]), abs=5e-3)
    arm = arm_of(fit.parameters, START.arm)
    q = np.array([[0.3, -0.8], [1.0, 2.0]])
    assert inertia_matrix(arm, q) == pytest.approx(inertia_matrix(ROBOT.arm, q), rel=0.02)


@pytest.mark.slow
def test_what_a_log_cannot_tell_is_named(tmp_path, monkeypatch):
    """Friction holds joint 2 for most of the time, so that little tells its rotor."""
    monkeypatch.setattr(fitting, "FOLDS", 2)
    robot = ROBOT.replace(friction={"viscous": (0.02, 0.01), "coulomb": (0.1, 0.8)})
    found = identify([read(write(tmp_path / f"{seed}.csv", run(seed, robot=robot))) for seed in (3, 4)], START)
    assert "fast reversals of joint 2" in found.weak["rotor 2"]


# Planning.


def test_a_plan_starts_at_rest_and_keeps_limits():
    motion, condition = excitation.plan(START, (-1.5, 0.2), (0.8, 1.2), 4.0)
    q, v = motion["position"], motion["velocity"]
    assert (*q[0], *v[0]) == pytest.approx((-1.5, 0.2, 0.0, 0.0), abs=1e-9)
    for size, most in ((q - (-1.5, 0.2), (0.808, 1.212)), (v, 4.04), (motion["torque"], 0.71 * 10.0)):
        assert np.all(np.abs(size).max(axis=0) <= most)
    assert np.gradient(q, START.control_dt, axis=0)[1:-1] == pytest.approx(v[1:-1], abs=0.02)
    assert condition < 40


# The command.


def test_the_command_writes_a_scenario_with_distributions(files, folder, monkeypatch, fbl_gym):
    monkeypatch.setattr(fitting, "FOLDS", 2)
    fbl_gym("identify --plan plan.csv --start dfki-c1")
    assert scenarios.get("plan.toml").reference.kind == "array"
    one, other, held_out = files
    line = f"identify {one} {other} --start dfki-c1 --toml my_arm.toml --validate {held_out} --plot fit.png"
    text = fbl_gym(line).out
    assert (folder / "fit.png").stat().st_size > 1000
    assert "starting model" in text
    assert "share one scale" in text
    assert text.count("standing still") == 2
    scenario = scenarios.get("my_arm.toml")
    for value, true in zip((*scenario.friction.coulomb, scenario.actuator.gain[0]), (0.15, 0.1, 0.9), strict=True):
        assert ends(value)[0] < ends(value)[1]
        assert ends(value) == pytest.approx((true, true), rel=0.1)
    assert 0.0 < scenario.parameter_error.radius < 0.2
    assert ends(scenario.noise.position.bias)[1] > 0.02
    gym.make("fbl_gym/TwoLinkArm-v0", scenario="my_arm.toml").reset(seed=0)


def test_the_scenario_of_an_arm_whose_start_has_no_noise(tmp_path, monkeypatch, fbl_gym):
    """The velocity of the log is a difference, and there is no noise of a velocity to switch off."""
    monkeypatch.setattr(fitting, "FOLDS", 2)
    (path := tmp_path / "robot.toml").write_text('base = "servo-practice-nominal"\nduration = 8.0\n')
    start = scenarios.get(str(path))
    fbl_gym(f"evaluate pd-gravity --scenario {path} --seeds 1 --trace {tmp_path}/run.csv")
    runs = [read(tmp_path / "run.csv")]
    assert runs[0].difference == 1
    (tmp_path / "arm.toml").write_text(result.text(identify(runs, start), runs, start, str(path), ""))
    arm = scenarios.get(str(tmp_path / "arm.toml"))
    assert (arm.noise.velocity, arm.parameter_error.payload, arm.friction.load) == (None, None, (0.0, 0.0))
