"""`controllers.Runner`: the environment's observation, the rollout's torques, stops, and the log."""

import dataclasses
import json
import re
import tomllib
from pathlib import Path
from types import MethodType, SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

import controllers
from benchmarks.identification.logs import read
from benchmarks.policies.spec import resolve
from benchmarks.run.rollout import make_env, rollout
from controllers import Runner
from controllers.base import TorqueLaw
from controllers.laws.computed_torque import ComputedTorque
from fbl_gym import TwoLinkArmEnv, scenarios
from fbl_gym.options import SENSORS

SCENARIO = scenarios.get("servo-delay-2").replace(duration=1.0)
ARM = {"parameter_error": {"radius": 0.2}, "friction": {"viscous": 5.0, "coulomb": 5.0}, "duration": 1.0}


def readings(env, observation):
    """Return the arguments of `step` from an observation; the velocity, unless the encoder computes it."""
    layout, encoder = env.unwrapped.layout, env.unwrapped.scenario.encoder
    computed = {"velocity"} if encoder and encoder.difference is not None else set()
    measured = {name: observation[layout[name]] for name in SENSORS if name in layout and name not in computed}
    return measured | {"reference": observation[layout.reference]}


def drive(runner, scenario, seed=3):
    """Run a runner on the arm of an environment that takes torques; return the torques [T x 2]."""
    env = TwoLinkArmEnv(scenario, action="torque", preview=runner.rows - 1)
    (observation, _), torques = env.reset(seed=seed), []
    for k in range(scenario.steps):
        torques.append(runner.step(**readings(env, observation), time=k * scenario.control_dt))
        observation, _, terminated, _, _ = env.step(torques[-1])
        assert not terminated
    assert runner.stopped == ""
    return np.array(torques)


@pytest.mark.parametrize("world", ["", "@mujoco"])
@pytest.mark.parametrize("policy", [
    "pd-gravity", "computed-torque-dob@tuned", "computed-torque-dob+predictor@tuned",
    "computed-torque+kalman@kalman_bandwidth=60", "lqg@tuned", "ppo-blend@1",
])  # fmt: skip
def test_torques_are_those_of_a_rollout(policy, world):
    """The robot is another environment, from which only positions and the reference come."""
    scenario = scenarios.get(f"servo-delay-2{world}").replace(duration=0.5)
    runner = Runner(policy, scenario, max_error=3.0)
    for _ in range(2):  # a second run begins afresh
        assert (drive(runner, scenario) == rollout(policy, scenario, [3]).command[1:, 0]).all()
        runner.reset()


@pytest.mark.parametrize("options", [
    {}, {"noise": {"position": 1e-3, "velocity": 1e-2, "acceleration": 0.1}},
    {"encoder": {"difference": 3, "low_pass": 20.0}, "sensors": ("position", "velocity")},
    {"encoder": {"difference": 1, "latency": 2}, "actuator": {"delay": 0.025}},
    {"encoder": {"latency": 1}, "actuator": None},
    {"sensors": ("position",), "actuator": {"lag": 0.01, "delay_samples": 2}, "plant": "mujoco"},
    {"reference": "steps", "joint": {"stiffness": 2e3, "rotor_inertia": 1.0}, "physics_dt": 5e-4},
], ids=str)  # fmt: skip
@pytest.mark.parametrize("preview", [0.0, 0.025])
def test_observations_are_those_of_the_environment(preview, options):
    """All bits of it: clipped readings, computed velocities, previous actions and preview."""
    scenario = scenarios.Scenario().replace(**ARM | {"initial_error": 0.05} | options)

    spy = SimpleNamespace(preview=preview)
    spy.make = MethodType(lambda self, interface: Mock(wraps=controllers.make("zero", interface)), spy)
    runner = Runner(spy.make, scenario, max_error=9.0)
    env = make_env(dataclasses.replace(resolve("zero"), preview=preview), scenario, None)
    observation, _ = env.reset(seed=5)
    for k in range(40):
        runner.step(**readings(env, observation), time=k * scenario.control_dt)
        assert runner.stopped == ""
        assert (runner.policy.predict.call_args.args[0] == observation).all()
        observation = env.step(np.zeros(2))[0]


# Arguments.


@pytest.mark.parametrize(("policy", "options", "error"), [
    ("oracle-flm", {}, "reads the truth"), ("pd-gravty@my_gains", {}, "unknown policy 'pd-gravty'"),
    ("pd-gravity", {"ramp": -1.0}, "ramp"), ("pd-gravity", {"ramp": np.nan}, "ramp"),
    ("pd-gravity", {"max_error": 0.0}, "max_error"), ("pd-gravity", {"max_interval": 0.001}, "max_interval"),
    ("pd-gravity", {"max_velocity": (1.0, 0.0)}, "max_velocity"),
])  # fmt: skip
def test_a_wrong_argument_is_named(policy, options, error):
    with pytest.raises(ValueError, match=error):
        Runner(policy, SCENARIO, **options)


def test_gains_of_another_arm_are_a_warning(tmp_path):
    gains = {"gains": {"frequency": 9.0}, "arms": [dataclasses.asdict(scenarios.get("cicese").arm)]}
    (tmp_path / "pd-gravity.json").write_text(json.dumps(gains))
    with pytest.warns(UserWarning, match=r"pd-gravity.json has the gains of another arm than that of servo-delay-2"):
        Runner(f"pd-gravity@{tmp_path}", SCENARIO)
    Runner(f"pd-gravity@{tmp_path}", "cicese")  # any warning is an error


# Stops.


def started(tmp_path=None, **options):
    """Return a runner after ten good steps at rest, and their reference."""
    options = {"ramp": 0.1, "log": None if tmp_path is None else tmp_path / "run.csv"} | options
    scenario = SCENARIO.replace(constraints={"high": (3.0, 2.0), "violation": "end"})
    runner, reference = Runner("pd-gravity", scenario, **options), np.array([0.1, 0.2, 0.0, 0.0, 0.0, 0.0])
    for k in range(10):
        torque = runner.step([0.1, 0.25], reference, time=0.01 * k)
    assert (torque != 0).all()
    return runner, reference, torque


BAD = tomllib.loads(Path(__file__).with_name("bad_readings.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("case", BAD)
def test_a_bad_reading_ends_the_run_on_a_ramp(case):
    """The torque goes to zero in equal steps, and stays there whatever comes, until `reset`."""
    runner, reference, torque = started()
    given, reason = BAD[case]
    good = {"position": [0.1, 0.25], "reference": reference, "time": 0.1}
    ramp = [runner.step(**good | given), *(runner.step(**good | {"time": 0.11 + 0.01 * k}) for k in range(14))]
    assert ramp == pytest.approx(np.maximum(0.9 - 0.1 * np.arange(15), 0.0)[:, None] * torque)
    assert not np.any(ramp[9:])
    assert re.search(reason, runner.stopped), runner.stopped
    runner.reset()
    assert runner.stopped == ""
    assert (runner.step(**good) != 0).all()


@pytest.mark.parametrize(("case", "error"), [("not finite", "position"), ("far", "max_error"), ("reference", "6 fini")])
def test_a_bad_first_reading_is_an_error(case, error):
    """Nothing has moved. The next reading may be a good one."""
    runner = Runner("computed-torque-dob+predictor", SCENARIO)
    good = {"position": [0.1, 0.25], "reference": [0.1, 0.2, 0, 0, 0, 0], "time": 0.1}
    with pytest.raises(ValueError, match=error):
        runner.step(**good | BAD[case][0])
    assert runner.stopped == ""
    torque = runner.step(**good)
    assert (torque == Runner("computed-torque-dob+predictor", SCENARIO).step(**good)).all()
    with pytest.raises(ValueError, match="velocity must be given: this scenario needs position and velocity"):
        Runner("pd-gravity", SCENARIO.replace(encoder=None)).step([0.0, 0.0], np.zeros(6))


def test_a_policy_without_a_number_stops_the_run():
    class Fails(TorqueLaw):
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            fails = deterministic and not np.any(episode_start) and observation[0, 0] > 0
            return np.array([[np.nan if fails else 1.0, 1.0]]), state

    runner = Runner(Fails, SCENARIO, ramp=0.02)
    limit = np.array(SCENARIO.actuator.torque_limit)
    torques = [runner.step([0.1, 0.0], np.zeros(6), time=0.01 * k) for k in range(4)]
    assert np.array_equal(torques, np.array([1.0, 0.5, 0.0, 0.0])[:, None] * limit)
    assert runner.stopped.startswith("action must be")


def test_torques_stay_within_their_limits():
    torque = Runner("pd-gravity@frequency=100", SCENARIO, max_error=2.0).step([0.0, 0.0], [1.5, -1.5, 0, 0, 0, 0])
    assert np.abs(torque).tolist() == list(SCENARIO.actuator.torque_limit)


def test_time_is_the_clocks_if_none_is_given():
    runner = Runner("pd-gravity", SCENARIO, max_interval=60.0)
    for _ in range(3):
        runner.step([0.0, 0.0], np.zeros(6))
    assert runner.stopped == ""


def test_readings_two_samples_apart_are_in_time(tmp_path):
    """By any clock: 0.05 - 0.03 is more than 0.02, and the seconds since 1970 have few digits left."""
    for start, number, dt in ((0.0, float, 0.01), (1.7e9, float, 1e-4), (500.0, np.float32, 0.001)):
        scenario = SCENARIO.replace(control_dt=dt, physics_dt=dt)
        runner = Runner("pd-gravity", scenario, log=tmp_path / "run.csv")
        for k in range(1, 100, 2):
            runner.step([0.0, 0.0], np.zeros(6), time=number(start + dt * k))
        assert runner.stopped == ""
        runner.close()
        assert np.loadtxt(tmp_path / "run.csv", delimiter=",", skiprows=1)[-1, 0] == pytest.approx(98 * dt, rel=1e-2)


@pytest.mark.parametrize(("scenario", "options"), [
    ("servo-nominal", {}), ("direct-nominal", {}), ("geared-nominal", {}), ("servo-lost-readings-2", {}),
    ("geared-nominal", {"encoder": {"counts": 500, "difference": 20}}), ("servo-friction-3", {}), ("cicese", {}),
    ("dfki-a0", {}), ("dfki-c1", {"friction": {"coulomb": 1.0, "stiction": 1.0}}),
])  # fmt: skip
@pytest.mark.parametrize("motion", ["own", "hold", "one joint"])
def test_a_healthy_run_does_not_stop(scenario, options, motion):
    """Joints that stick, reverse or creep along a coarse encoder repeat their readings, too."""
    scenario = scenarios.get(scenario).replace(duration=1.0, **options)
    if motion != "own":
        amplitude = 0.0 if motion == "hold" else (0.5, 0.0)
        scenario = scenario.replace(reference={"kind": "sine", "centre": (-1.0, 0.5), "amplitude": amplitude})
    for policy in ("pd-gravity", "computed-torque-dob@tuned", "lqg-elastic@tuned"):
        drive(Runner(policy, scenario), scenario)


# The loop of the page, with faults.

LOOP = (Path(__file__).parents[2] / "examples" / "run_on_robot.py").read_text(encoding="utf-8")
#: Sample of the fault, in the middle of the first move.
FAULT = 50


def stuck(*joints):
    return lambda now, at_fault: np.where(np.isin((0, 1), joints), at_fault, now)


READINGS = {  # the reading, of the true one and that at the fault; the reason; the latest stop [samples]
    "stuck 1": (stuck(0), "joint 1 has the same reading .* its encoder is stuck", 25),
    "stuck 2": (stuck(1), "joint 2 has the same reading .* its encoder is stuck", 25),
    "both stuck": (stuck(0, 1), "its encoder is stuck", 25),
    "slipped": (lambda now, at_fault: now + (0.3, 0.0), "joint 1 is .* from its last reading", 0),
    "swapped": (lambda now, at_fault: now[::-1], "joint 1 is .* from its reference", 0),
    "turned round": (lambda now, at_fault: 2 * at_fault - now, "joint . is .* from its reference", 40),
    "no number": (lambda now, at_fault: now * np.nan, "position must be 2 finite numbers", 0),
}


@pytest.fixture
def run_page(tmp_path, monkeypatch):
    """Run the page's loop; return the robot with all torques and velocities, the runner, and the error."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("controllers.runner.sleep", lambda seconds: None)

    def run(*, reading=None, at_step=lambda k: None, text=LOOP):
        robots = []

        class Robot(TwoLinkArmEnv):
            def __init__(self, *args, **options):
                super().__init__(*args, **options)
                self.calls, self.torques, self.speeds, self.at_fault = 0, [], [], None
                robots.append(self)

            def step(self, torque):
                self.calls += 1
                at_step(self.calls)
                self.torques.append(np.array(torque))
                observation, *rest = super().step(torque)
                self.speeds.append(np.abs(self.truth.velocity).max())
                if reading is not None and len(self.torques) >= FAULT:
                    position = observation[:2].copy()
                    self.at_fault = position if self.at_fault is None else self.at_fault
                    observation[:2] = reading(position, self.at_fault)
                return observation, *rest

        monkeypatch.setattr("fbl_gym.TwoLinkArmEnv", Robot)
        names, error = {}, None
        try:
            exec(compile(text, "page", "exec"), names)
        except BaseException as problem:
            error = problem
        return robots[0], names["runner"], error

    return run


def check_ramp(torques):
    """Check that the torques end in 50 equal steps to zero."""
    start = np.array(torques[-50]) / 0.98
    assert np.array(torques[-50:]) == pytest.approx((1 - 0.02 * np.arange(1, 51))[:, None] * start)
    assert np.any(start)
    assert not np.any(torques[-1])


@pytest.mark.parametrize("fault", READINGS)
@pytest.mark.parametrize("policy", ["computed-torque-dob@tuned", "pid-gravity@tuned", "lqg-elastic@tuned"])
def test_the_loop_of_the_page_survives_a_false_reading(policy, fault, run_page):
    reading, reason, latest = READINGS[fault]
    text = LOOP.replace("computed-torque-dob@tuned", policy)
    robot, runner, error = run_page(reading=reading, text=text)
    assert (error, runner.stopping) == (None, False)
    assert re.search(reason, runner.stopped), runner.stopped
    check_ramp(robot.torques)
    assert FAULT <= (stop := len(robot.torques) - 50) <= FAULT + latest
    assert max(robot.speeds[: stop + 1]) < (10.0 if fault == "turned round" else 6.0)


def check_end(run, steps, stopped, expected=None):
    """Check the steps of a run before its ramp, the reason of its end, and the error that is raised."""
    robot, runner, error = run
    assert error is expected
    assert (runner.stopped[: len(stopped) or None], len(robot.torques)) == (stopped, steps + 50)
    check_ramp(robot.torques)


@pytest.mark.parametrize("failure", [RuntimeError("no solution"), SystemExit(3), KeyboardInterrupt()], ids=repr)
def test_the_loop_of_the_page_survives_a_policy_that_fails(failure, monkeypatch, run_page):
    decide, calls = ComputedTorque.predict, []

    def predict(*args, **options):
        calls.append(0)
        if len(calls) == 3 + FAULT:
            raise failure
        return decide(*args, **options)

    monkeypatch.setattr(ComputedTorque, "predict", predict)
    check_end(run_page(), FAULT - 1, str(failure) or repr(failure))


def test_the_loop_of_the_page_survives_a_late_reading(run_page):
    text = LOOP.replace("time=k *", "time=(k + 2 * (k >= 50)) *")
    check_end(run_page(text=text), FAULT, "time must go on by at most 0.02 s")


@pytest.mark.parametrize("failure", [KeyboardInterrupt(), SystemExit(3), OSError("cable"), None], ids=repr)
def test_the_loop_of_the_page_ends_in_a_ramp(failure, run_page):
    """After the motion, or an exception of the user's code, which comes once more in the ramp."""

    def at_step(call):
        if failure is not None and call in (FAULT, FAULT + 20, FAULT + 50):
            raise failure

    reason = "" if failure is None else str(failure) or repr(failure)
    check_end(run_page(at_step=at_step), 400 if failure is None else FAULT - 1, reason, failure)


def test_a_full_disk_ends_the_log_alone(tmp_path, run_page):
    """It ends with a whole line. The largest size of a file stands for that of the disk."""
    resource = pytest.importorskip("resource")
    whole, _, _ = run_page()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5000, limits[1]))
    try:
        robot, runner, error = run_page()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (error, runner.stopped) == (None, "")
    assert "File too large" in runner.log_error
    assert np.array_equal(robot.torques, whole.torques)
    text = (tmp_path / "run.csv").read_text()
    assert text.endswith("\n")
    assert 4800 < len(text) < 5000


def test_without_a_block_the_ramp_is_stepped():
    runner, reference, torque = started()
    runner.stop()
    sent = [runner.step([0.1, 0.25], reference) for _ in range(10) if runner.stopping]
    assert sent == pytest.approx((1 - 0.1 * np.arange(1, 11))[:, None] * torque)
    assert (runner.stopped, runner.stopping) == ("", False)
    with pytest.raises(ValueError, match="send must be given"), runner:
        pass


def test_a_block_that_ends_between_two_runs_sends_the_ramp():
    """The robot keeps the last torque of the first run until the second one begins."""
    sent: list = []
    runner, _, torque = started(send=sent.append)
    with runner:
        runner.reset()
    assert sent == pytest.approx((1 - 0.1 * np.arange(1, 11))[:, None] * torque)
    runner.reset()
    runner.stop()
    assert not runner.stopping


# The log.


def test_identify_reads_the_log(tmp_path):
    scenario = SCENARIO.replace(duration=4.0)
    runner = Runner("computed-torque@tuned", scenario, max_error=3.0, log=tmp_path / "run.csv")
    torques = drive(runner, scenario)
    runner.close()
    table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True)
    assert np.array_equal(np.array([table["torque_1_Nm"], table["torque_2_Nm"]]).T, torques)
    log = read(tmp_path / "run.csv")
    assert log.dt == pytest.approx(log.sample) == scenario.control_dt
    assert (log.difference, *log.counts) == pytest.approx((1, 4096, 4096))


def test_the_log_ends_where_the_run_stops(tmp_path):
    """And has each line at once, so that a killed process leaves one."""
    runner, reference, _ = started(tmp_path)
    for k in range(5):
        assert (tmp_path / "run.csv").read_text().count("\n") == 11
        runner.step([np.nan, 0.25], reference, time=0.1 + 0.01 * k)
    runner.reset(tmp_path / "next.csv")
    runner.step([0.1, 0.25], reference, time=5.0)
    runner.close()
    head, line = (tmp_path / "next.csv").read_text().splitlines()
    assert head.startswith("time_s,position_1_rad,position_2_rad,velocity_1_rad_s,velocity_2_rad_s,reference_1_rad")
    assert line.startswith("0.0,0.1,0.25,0.0,0.0,0.1,0.2,")


def test_readings_of_the_robot_are_never_lost():
    """A scenario whose simulated readings are all lost shows the robot's own ones."""
    torques = []
    for dropout in (0.0, 1.0):
        encoder = {"difference": 1, "dropout": dropout}
        runner = Runner("pd-gravity", scenarios.Scenario(encoder=encoder, sensors=("position", "velocity")))
        torques.append([runner.step((-1.6 + 0.01 * k, 0.0), (-1.6, 0, 0, 0, 0, 0), time=0.01 * k) for k in range(5)])
    np.testing.assert_array_equal(*torques)
    assert not np.array_equal(torques[0][0], torques[0][4])
