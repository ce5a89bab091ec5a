"""`controllers.Runner`: the environment's observation, the rollout's torques, stops, and the log."""

import dataclasses
import re

import numpy as np
import pytest

import controllers
from benchmarks.identification.logs import read
from benchmarks.policies.spec import resolve
from benchmarks.run.rollout import make_env, rollout
from controllers import Runner
from controllers.base import TorqueLaw
from fbl_gym import TwoLinkArmEnv, scenarios

SCENARIO = scenarios.get("servo-delay-2").replace(duration=1.0)
ARM = {"parameter_error": {"radius": 0.2}, "friction": {"viscous": 5.0, "coulomb": 5.0}, "duration": 1.0}


def reference_of(env, observation):
    """Return the rows of the reference that an observation has, [rows x 6]."""
    slots = [f"reference_{name}" for name in ("position", "velocity", "acceleration")]
    rows = [observation[env.unwrapped.layout[slot]] for slot in slots]
    if "preview" in env.unwrapped.layout:
        rows.append(observation[env.unwrapped.layout["preview"]])
    return np.concatenate(rows).reshape(-1, 6)


def readings(env, observation, computed=True):
    """Return the arguments of `step` from an observation."""
    names = [name for name in ("position", "velocity", "acceleration") if name in env.unwrapped.layout]
    names = [name for name in names if not (name == "velocity" and computed)]
    measured = {name: observation[env.unwrapped.layout[name]] for name in names}
    return measured | {"reference": reference_of(env, observation)}


def drive(runner, scenario, seed=3):
    """Run a runner on the arm of an environment that takes torques; return the torques [T x 2]."""
    env = TwoLinkArmEnv(scenario, action="torque", preview=runner.rows - 1)
    observation, _ = env.reset(seed=seed)
    torques = []
    for k in range(scenario.steps):
        torques.append(runner.step(**readings(env, observation), time=k * scenario.control_dt))
        observation, _, terminated, _, _ = env.step(torques[-1])
        assert not terminated
    assert runner.stopped == ""
    return np.array(torques)


@pytest.mark.parametrize("world", ["", "@mujoco"])
@pytest.mark.parametrize(
    "policy",
    [
        "pd-gravity", "computed-torque-dob@tuned", "computed-torque-dob+predictor@tuned",
        "computed-torque+kalman@kalman_bandwidth=60", "lqg@tuned", "ppo-blend@1",
    ],
)  # fmt: skip
def test_torques_are_those_of_a_rollout(policy, world):
    """The robot is another environment, from which only positions and the reference come."""
    scenario = scenarios.get(f"servo-delay-2{world}").replace(duration=0.5)
    runner = Runner(policy, scenario, max_error=3.0)
    for _ in range(2):  # a second run begins afresh
        assert (drive(runner, scenario) == rollout(policy, scenario, [3]).command[1:, 0]).all()
        runner.reset()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"noise": {"position": 1e-3, "velocity": 1e-2, "acceleration": 0.1}},
        {"encoder": {"difference": 3, "low_pass": 20.0}, "sensors": ("position", "velocity")},
        {"encoder": {"difference": 1, "latency": 2}, "actuator": {"delay": 0.025}},
        {"encoder": {"latency": 1}, "actuator": None},
        {"sensors": ("position",), "actuator": {"lag": 0.01, "delay_samples": 2}, "plant": "mujoco"},
        {"reference": "steps", "joint": {"stiffness": 2e3, "rotor_inertia": 1.0}, "physics_dt": 5e-4},
    ],
    ids=str,
)
@pytest.mark.parametrize("preview", [0.0, 0.025])
def test_observations_are_those_of_the_environment(preview, options):
    """All bits of it: clipped readings, computed velocities, previous actions and preview."""
    scenario = scenarios.Scenario().replace(**ARM | {"initial_error": 0.05} | options)
    seen = []

    def spy(interface):
        return _Spy(controllers.make("zero", interface), seen)

    spy.preview = preview
    runner = Runner(spy, scenario, max_error=9.0)
    env = make_env(dataclasses.replace(resolve("zero"), preview=preview), scenario, None)
    observation, _ = env.reset(seed=5)
    computed = scenario.encoder is not None and scenario.encoder.difference is not None
    for k in range(40):
        runner.step(**readings(env, observation, computed), time=k * scenario.control_dt)
        assert runner.stopped == ""
        assert (seen[-1][0] == observation).all()
        observation = env.step(runner.policy.action)[0]


class _Spy:
    def __init__(self, policy, seen):
        self.policy, self.seen = policy, seen

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        self.seen.append(observation.copy())
        action, state = self.policy.predict(observation, state, episode_start, deterministic)
        self.action = action[0]
        return action, state


# Names.


def test_names_that_are_no_robots_policy():
    with pytest.raises(ValueError, match="reads the truth"):
        Runner("oracle-flm", SCENARIO)
    with pytest.raises(ValueError, match="unknown policy 'pd-gravty'"):
        Runner("pd-gravty@my_gains", SCENARIO)


@pytest.mark.parametrize(
    ("argument", "value"), [("ramp", -1.0), ("max_error", 0.0), ("max_interval", 0.001), ("ramp", np.nan)]
)
def test_a_wrong_argument_is_named(argument, value):
    with pytest.raises(ValueError, match=argument):
        Runner("pd-gravity", SCENARIO, **{argument: value})


# Stops.


def started(tmp_path=None, **options):
    """Return a runner after ten good steps at rest, and their reference."""
    options = {"ramp": 0.1, "log": None if tmp_path is None else tmp_path / "run.csv"} | options
    runner, reference = Runner("pd-gravity", SCENARIO, **options), np.array([0.1, 0.2, 0.0, 0.0, 0.0, 0.0])
    for k in range(10):
        torque = runner.step([0.1, 0.25], reference, time=0.01 * k)
    assert (torque != 0).all()
    return runner, reference, torque


BAD = {
    "late": ({"time": 0.2}, "time must go on by at most 0.02 s"),
    "not going on": ({"time": 0.09}, "time must go on"),
    "no time": ({"time": np.nan}, "time must go on"),
    "not finite": ({"position": [0.1, np.nan]}, "position must be 2 finite numbers"),
    "short": ({"position": [0.1]}, "position must be 2 finite numbers"),
    "text": ({"position": "?"}, "could not convert"),
    "jump": ({"position": [0.1, 1.6], "reference": [0.1, 1.6, 0, 0, 0, 0]}, "joint 2 .* last reading"),
    "far": ({"position": [0.75, 0.25]}, "joint 1 is 0.65 rad from its reference"),
    "reference": ({"reference": np.zeros((2, 6))}, "reference must be 6 finite numbers"),
    "velocity": ({"velocity": [0.0, 0.0]}, "velocity must not be given"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_reading_ends_the_run_on_a_ramp(case):
    """The torque goes to zero in equal steps, and stays there whatever comes, until `reset`."""
    runner, reference, torque = started()
    given, reason = BAD[case]
    good = {"position": [0.1, 0.25], "reference": reference, "time": 0.1}
    ramp = [runner.step(**good | given)]
    ramp += [runner.step(**good | {"time": 0.11 + 0.01 * k}) for k in range(14)]
    assert ramp == pytest.approx(np.maximum(0.9 - 0.1 * np.arange(15), 0.0)[:, None] * torque)
    assert not np.any(ramp[9:])
    assert re.search(reason, runner.stopped), runner.stopped
    runner.reset()
    assert runner.stopped == ""
    assert (runner.step(**good) != 0).all()


@pytest.mark.parametrize(
    ("case", "error"), [("not finite", "position"), ("far", "max_error"), ("reference", "6 finite")]
)
def test_a_bad_first_reading_is_an_error(case, error):
    """Nothing has moved. The next reading may be a good one."""
    runner = Runner("computed-torque-dob+predictor", SCENARIO)
    good = {"position": [0.1, 0.25], "reference": [0.1, 0.2, 0, 0, 0, 0], "time": 0.1}
    with pytest.raises(ValueError, match=error):
        runner.step(**good | BAD[case][0])
    assert runner.stopped == ""
    torque = runner.step(**good)
    assert (torque == Runner("computed-torque-dob+predictor", SCENARIO).step(**good)).all()


def test_a_signal_that_the_scenario_needs_is_named():
    with pytest.raises(ValueError, match="velocity must be given: this scenario needs position and velocity"):
        Runner("pd-gravity", SCENARIO.replace(encoder=None)).step([0.0, 0.0], np.zeros(6))


def test_a_bound_of_the_scenario_stops_the_run():
    bound = {"high": (3.0, 0.5), "violation": "end"}
    runner = Runner("pd-gravity", SCENARIO.replace(constraints=bound))
    for k, angle in enumerate((0.4, 0.49, 0.51)):
        runner.step([0.0, angle], [0, angle, 0, 0, 0, 0], time=0.01 * k)
        assert ("constraint" in runner.stopped) == (angle > 0.5)


@pytest.mark.parametrize("failure", [np.array([[np.nan, 0.0]]), RuntimeError("no solution")], ids=["nan", "error"])
def test_a_policy_that_fails_stops_the_run(failure):
    class Fails(TorqueLaw):
        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            fails = deterministic and not np.any(episode_start) and observation[0, 0] > 0
            if fails and isinstance(failure, Exception):
                raise failure
            return (failure if fails else np.ones((1, 2))), state

    runner = Runner(Fails, SCENARIO, ramp=0.02)
    limit = np.array(SCENARIO.actuator.torque_limit)
    torques = [runner.step([0.1, 0.0], np.zeros(6), time=0.01 * k) for k in range(4)]
    assert np.array_equal(torques, np.array([1.0, 0.5, 0.0, 0.0])[:, None] * limit)
    assert runner.stopped.startswith("no solution" if isinstance(failure, Exception) else "action must be")


def test_torques_stay_within_their_limits():
    runner = Runner("pd-gravity@frequency=100", SCENARIO, max_error=2.0)
    torque = runner.step([0.0, 0.0], [1.5, -1.5, 0, 0, 0, 0])
    assert np.abs(torque).tolist() == list(SCENARIO.actuator.torque_limit)


def test_time_is_the_clocks_if_none_is_given():
    runner = Runner("pd-gravity", SCENARIO, max_interval=60.0)
    for _ in range(3):
        runner.step([0.0, 0.0], np.zeros(6))
    assert runner.stopped == ""


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
    assert log.difference == 1
    assert log.counts == pytest.approx([4096, 4096])


def test_the_log_ends_where_the_run_stops(tmp_path):
    """And has each line at once, so that a killed process leaves one."""
    runner, reference, _ = started(tmp_path)
    assert len((tmp_path / "run.csv").read_text().splitlines()) == 11
    for k in range(5):
        runner.step([np.nan, 0.25], reference, time=0.1 + 0.01 * k)
    assert len((tmp_path / "run.csv").read_text().splitlines()) == 11
    runner.reset(tmp_path / "next.csv")
    runner.step([0.1, 0.25], reference, time=5.0)
    runner.close()
    lines = (tmp_path / "next.csv").read_text().splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("time_s,position_1_rad,position_2_rad,velocity_1_rad_s,velocity_2_rad_s,reference_1_rad")
    assert lines[1].startswith("0.0,0.1,0.25,0.0,0.0,0.1,0.2,")


def test_readings_of_the_robot_are_never_lost():
    """A scenario whose simulated readings are all lost shows the robot's own ones."""
    torques = []
    for dropout in (0.0, 1.0):
        encoder = {"difference": 1, "dropout": dropout}
        scenario = scenarios.Scenario(encoder=encoder, sensors=("position", "velocity"))
        runner = Runner("pd-gravity", scenario)
        torques.append([runner.step((-1.6 + 0.01 * k, 0.0), (-1.6, 0, 0, 0, 0, 0), time=0.01 * k) for k in range(5)])
    np.testing.assert_array_equal(*torques)
    assert not np.array_equal(torques[0][0], torques[0][4])
