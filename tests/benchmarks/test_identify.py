"""Identification: logs that are read or refused, arms that are found again, held-out terms, plans."""

import dataclasses
import gzip

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.identification import excitation, result
from benchmarks.identification import fit as fitting
from benchmarks.identification.fit import identify, rollout_errors
from benchmarks.identification.logs import COLUMNS, columns, read, refuse_twice
from benchmarks.identification.model import INDEX, parameters_of, windows
from benchmarks.identification.result import arm_of
from fbl_gym import scenarios
from fbl_gym.envs.env import TwoLinkArmEnv
from fbl_gym.model.arm import inertia_matrix
from fbl_gym.records.record import ends
from tests import identification_coverage

START = scenarios.get("dfki-c1")
ROBOT = START.replace(
    arm=dataclasses.replace(START.arm, m1=0.6, m2=0.5, rotor=(START.arm.rotor[0], 1.5 * START.arm.rotor[1])),
    noise={"position": 1e-4}, encoder={"counts": 16384}, sensors=("position",),
    friction={"viscous": (0.02, 0.01), "coulomb": (0.15, 0.1)}, limits={"velocity": 100.0, "position": 100.0},
    actuator={"torque_limit": 10.0, "gain": (0.9, 1.0), "delay": 0.006},
)  # fmt: skip
ZERO = (0.05, -0.04)


def run(seed, zero=(0.0, 0.0), robot=ROBOT, seconds=6.0):
    """Return time, measured positions and commands of a robot under two sines a joint [n x 5]."""
    generator = np.random.default_rng(seed)
    rate, phase = generator.uniform(2.0, 12.0, (2, 2)), generator.uniform(0, 6.28, (2, 2))
    env = TwoLinkArmEnv(robot, action="torque")
    observation, _ = env.reset(seed=seed)
    rows, jitter = [], generator.uniform(-2e-4, 2e-4, round(seconds / robot.control_dt))
    for k, late in enumerate(jitter):
        torque = ((0.4, 0.25) * np.sin(rate * k * robot.control_dt + phase)).sum(axis=0)
        rows.append([k * robot.control_dt + late, *(observation[:2] - zero), *torque])
        observation, *_ = env.step(torque.astype(np.float32))
    return np.array(rows)


def write(path, rows, names=(*COLUMNS["time"], *COLUMNS["position"], *COLUMNS["torque"])):
    with (gzip.open if path.suffix == ".gz" else open)(path, "wt") as file:
        np.savetxt(file, rows, delimiter=",", header=",".join(names), comments="")
    return path


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
    assert "3000 samples" in log.remarks[0]
    assert "not logged" in log.remarks[1]
    assert log.dt == 0.004
    assert log.sample == pytest.approx(0.002, rel=0.02)


def test_columns_have_names_units_and_a_zero(rows, tmp_path):
    names = ("t", "a", "b", "u", "w")
    path = write(tmp_path / "other.csv.gz", rows[0], names)
    mapping = columns(["time=t", "position=a,b", "torque=u,w"])
    assert read(path, mapping, (0.5, 0.0)).position[5] == pytest.approx(rows[0][10, 1:3] + (0.5, 0.0), abs=0.01)
    with pytest.raises(ValueError, match=r"column of time.*--signals"):
        read(path)
    with pytest.raises(ValueError, match="signal"):
        columns(["torqe=u,w"])
    with pytest.raises(ValueError, match="2 of torque"):
        columns(["torque=u"])


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda r: np.delete(r, slice(1000, 1100), axis=0), r"gap of 0\.2"),
        (lambda r: r * [1, 1, 0, 1, 1], "position_2_rad does not change.*unplugged"),
        (lambda r: np.concatenate([r, r]), "time must increase"),
        (lambda r: np.where(np.arange(len(r))[:, None] == 7, np.nan, r), "finite.*row 9"),
        (lambda r: r + np.outer(np.arange(len(r)) > 50, [0, 6.3, 0, 0, 0]), "position_1_rad must not jump.*unwrapped"),
        (
            lambda r: r * np.where(np.arange(len(r))[:, None] < np.abs(r[:, 2]).argmax(), 1, [1, 1, 0, 1, 1]),
            "unplugged",
        ),
        (lambda r: r[:50], "200 samples"),
        (lambda r: r * [1000, 1, 1, 1, 1], "time must be in s, 1e-05 to 0.1 s a sample, got"),
    ],
)
def test_a_damaged_log_is_refused(rows, tmp_path, damage, message):
    with pytest.raises(ValueError, match=message):
        read(write(tmp_path / "bad.csv", damage(rows[0])))


def test_a_log_given_twice_is_refused(rows, files, tmp_path, fbl_gym):
    """Under another name, cut and moved in time, too; logs of other motions may start in the same place."""
    again = write(tmp_path / "again.csv", rows[0][200:] + [7.0, 0, 0, 0, 0])
    shown = fbl_gym(f"identify {files[0]} {again} --start dfki-c1", 2).err
    assert f"each log must be given once, but {files[0].name} and again.csv have the same samples" in shown
    refuse_twice([read(path) for path in files])


def test_logs_of_two_rates_do_not_mix(files):
    log = read(files[0])
    with pytest.raises(ValueError, match="one rate"):
        windows([log, dataclasses.replace(log, dt=2 * log.dt)])


@pytest.mark.parametrize(
    ("text", "message"), [("", "header.*Empty"), ("time_s,a\n1,2\n1,2,3\n", "equal lines.*Line #3")]
)
def test_a_file_that_is_no_table_is_refused(tmp_path, text, message):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(ValueError, match=f"(?s){message}"):
        read(tmp_path / "bad.csv")


# Fitting.


def test_logs_of_two_robots_are_refused(files, tmp_path):
    heavy = ROBOT.replace(arm=dataclasses.replace(ROBOT.arm, m1=1.2, m2=1.0))
    other = read(write(tmp_path / "heavy.csv", run(5, robot=heavy)))
    with pytest.raises(ValueError, match="one robot"):
        identify([read(path) for path in files] + [other], START)


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


def test_the_arm_is_found_again(fit):
    true = parameters_of(ROBOT)
    for name in fit.free:
        assert fit.parameters[INDEX[name]] == pytest.approx(true[INDEX[name]], rel=0.15, abs=2e-3), name
    assert {"rotor 2", "gain 1", "viscous 1"} <= set(fit.free)
    widths = np.ptp(fit.interval(), axis=1)[[INDEX[name] for name in fit.free]]
    assert (widths > 0).all()
    assert fit.weak == {}


def test_zeros_of_a_log_are_found(fit):
    assert fit.zero == pytest.approx(np.array([(0, 0), ZERO]), abs=5e-3)


def test_the_arm_is_the_same_motion(fit):
    arm = arm_of(fit.parameters, START.arm)
    q = np.array([[0.3, -0.8], [1.0, 2.0]])
    assert inertia_matrix(arm, q) == pytest.approx(inertia_matrix(ROBOT.arm, q), rel=0.02)


@pytest.mark.slow
def test_what_a_log_cannot_tell_is_named(tmp_path, monkeypatch):
    """Joint 2 hangs still, so that nothing tells its friction."""
    monkeypatch.setattr(fitting, "FOLDS", 2)
    robot = ROBOT.replace(friction={"viscous": (0.02, 0.01), "coulomb": (0.1, 5.0)})
    still = [read(write(tmp_path / f"{seed}.csv", run(seed, robot=robot, seconds=6.0))) for seed in (3, 4)]
    found = identify(still, START)
    assert "slow moves" in found.weak.get("coulomb 2", "") or ends(tuple(found.interval()[INDEX["coulomb 2"]]))[1] > 0.5


# Planning.


def test_a_plan_starts_at_rest_and_keeps_limits():
    motion, condition = excitation.plan(START, (-1.5, 0.2), (0.8, 1.2), 4.0)
    assert motion["position"][0] == pytest.approx([-1.5, 0.2])
    assert np.abs(motion["velocity"][0]).max() < 1e-9
    assert (np.abs(motion["position"] - (-1.5, 0.2)).max(axis=0) <= np.array([0.8, 1.2]) * 1.01).all()
    assert np.abs(motion["velocity"]).max() <= 4.04
    assert np.abs(motion["torque"]).max() <= 0.71 * 10.0
    slope = np.gradient(motion["position"], 0.01, axis=0)
    assert slope[1:-1] == pytest.approx(motion["velocity"][1:-1], abs=0.02)
    assert condition < 40


# The command.


def test_the_command_writes_a_scenario_with_distributions(files, folder, monkeypatch, fbl_gym):
    monkeypatch.setattr(fitting, "FOLDS", 2)
    fbl_gym(["identify", "--plan", "plan.csv", "--start", "dfki-c1"])
    assert scenarios.get("plan.toml").reference.kind == "array"
    command = ["identify", *map(str, files[:2]), "--start", "dfki-c1", "--toml", "my_arm.toml"]
    text = fbl_gym([*command, "--validate", str(files[2]), "--plot", "fit.png"]).out
    assert (folder / "fit.png").stat().st_size > 1000
    assert "starting model" in text
    assert "common scale" in text
    scenario = scenarios.get("my_arm.toml")
    for value, true in ((scenario.friction.coulomb, (0.15, 0.1)), (scenario.actuator.gain[:1], (0.9,))):
        for each, number in zip(value, true, strict=True):
            assert ends(each)[0] < ends(each)[1]
            assert ends(each) == pytest.approx((number, number), rel=0.1)
    assert 0.0 < scenario.parameter_error.radius < 0.2
    assert ends(scenario.noise.position.bias)[1] > 0.02
    gym.make("fbl_gym/TwoLinkArm-v0", scenario="my_arm.toml").reset(seed=0)


def test_the_scenario_of_an_arm_whose_start_has_no_noise(tmp_path, monkeypatch, fbl_gym):
    """The velocity of the log is a difference, and there is no noise of a velocity to switch off."""
    monkeypatch.setattr(fitting, "FOLDS", 2)
    path = tmp_path / "robot.toml"
    path.write_text('base = "servo-practice-nominal"\nduration = 8.0\nfriction.load = 0.0\n')
    start = scenarios.get(str(path))
    fbl_gym(f"evaluate pd-gravity --scenario {path} --seeds 1 --trace {tmp_path}/run.csv")
    runs = [read(tmp_path / "run.csv")]
    assert runs[0].difference == 1
    (tmp_path / "arm.toml").write_text(result.text(identify(runs, start), runs, start, str(path), ""))
    assert scenarios.get(str(tmp_path / "arm.toml")).noise.velocity is None
