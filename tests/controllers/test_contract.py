"""Every registered policy keeps the contract of `fbl-gym check-policy`; names, access, gains and their declarations."""

import dataclasses
import json
import math
from dataclasses import dataclass
from importlib import metadata

import numpy as np
import pytest

import controllers
import fbl_gym
from benchmarks.agents.adapter import AdapterSettings
from benchmarks.agents.network import Actor
from benchmarks.policies.spec import resolve
from benchmarks.run.cell import Cell
from benchmarks.run.contract import broken
from benchmarks.run.rollout import rollout
from controllers import registry
from controllers.base import leaves
from controllers.laws.simple import PdGravity
from controllers.preview import reference_at
from controllers.registry import CATALOGUE
from fbl_gym import ArmParameters, Interface, TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.records.record import number, tuning_ranges
from fbl_gym.scenarios.class_families import conditions
from fbl_gym.scenarios.classes import CLASSES
from fbl_gym.scenarios.scenario import Scenario
from tests.controllers.closed_loop import EXCITING, broken_promises, mean_error, nominal, tracking
from tests.fbl_gym.declared import fields
from tests.fbl_gym.episodes import truths_of

NAMES = controllers.names()


@pytest.mark.parametrize("name", [*NAMES, "pid-flm+kalman", "adaptive-robust-flm+eso+predictor"])
def test_a_policy_keeps_every_promise(name):
    assert broken_promises(name) == []


@pytest.mark.parametrize("name", [name for name in NAMES if controllers.access(name) != "oracle"])
def test_a_policy_but_an_oracle_holds_plain_data(name):
    """Its interface and its gains: nothing leads to an environment. Its state is no part of the caller's array."""
    policy = controllers.make(name, env := TwoLinkArmEnv("mixed-error-3"))
    parts = leaves(policy.predict(observation := env.reset(seed=0)[0])[1])
    assert not any(np.shares_memory(observation, part) for part in parts if part is not None)
    for field in dataclasses.fields(policy):
        plain = Interface | AdapterSettings | Actor | float | int | str | tuple | None
        assert isinstance(getattr(policy, field.name), plain), field.name
    assert type(controllers.make(name, policy.interface)) is type(policy)


def test_a_torque_at_a_limit_that_float32_rounds_down_lies_in_the_box():
    assert float(np.float32(0.7)) < 0.7
    assert broken(resolve("pd-gravity"), nominal(actuator={"torque_limit": 0.7}, duration=0.5)) == ""


NO_ORACLES = [name for name, law in CATALOGUE.items() if "access" not in law]


@pytest.mark.parametrize("name", NO_ORACLES)
def test_a_reading_that_is_nan_spoils_its_own_lane_alone(name):
    env = TwoLinkArmVectorEnv(2)
    policy, (observation, _) = controllers.make(name, env), env.reset(seed=0)
    _, state = policy.predict(observation)
    observation[0, env.interface.layout["position"]] = np.nan
    assert np.isnan(policy.predict(observation, state)[0]).tolist() == [[True, True], [False, False]]


def motion(name, scale):
    """Return the positions [T + 1 x 1 x 2] of a servo whose masses are `scale` times the nominal ones."""
    arm = CLASSES["servo"].arm
    arm = dataclasses.replace(arm, m1=scale * arm.m1, m2=scale * arm.m2, rotor=tuple(scale * np.array(arm.rotor)))
    return rollout(name, Scenario(**conditions(arm, "servo")).replace(duration=1.5), [0]).position


@pytest.mark.parametrize("name", NO_ORACLES)
def test_the_motion_does_not_depend_on_the_size(name):
    small, usual, large = (motion(name, scale) for scale in (0.3, 1.0, 30.0))
    np.testing.assert_allclose([small, large], [usual, usual], atol=1e-6)


ROTORS = ArmParameters(rotor=(8.0, 4.0))
MODEL_BASED = "cascade-flm adaptive-flm slotine-li slotine-li-composite spong-robust rbf-adaptive computed-torque"


@pytest.mark.parametrize("name", [*MODEL_BASED.split(), "computed-torque-tde", "computed-torque-dob"])
def test_a_law_follows_an_arm_with_rotors_as_well(name):
    options = {"steps": 200, "skip": 1, "action": "torque", "actuator": None}
    plain, heavy = (mean_error(name, arm=arm, **options) for arm in (ArmParameters(), ROTORS))
    assert heavy < 1.5 * plain + 1e-5


def test_estimates_are_those_of_the_links():
    """The rotors are taken off the torque before the fit."""
    options = {"action": "torque", "actuator": None, "control_dt": 1e-3, "reference": EXCITING}
    env = TwoLinkArmVectorEnv(2, arm=ROTORS, parameter_error=1.2, **options)
    _, states = tracking(controllers.make("adaptive-flm", env), env, 2000)
    np.testing.assert_allclose(states[-1].lumped, env.truth.lumped, rtol=0.05)


@dataclass(frozen=True)
class Plain(controllers.TorqueLaw):
    w: float = 8.0


def test_a_law_prints_its_name_and_gains():
    env = TwoLinkArmEnv()
    assert repr(Plain(env.interface, w=-1.0)).endswith("Plain(w=-1.0)")  # only declared gains are checked
    assert repr(controllers.make("pid-flm", env)) == "PidFlm(kp=(10.0, 10.0), ki=(0.0, 0.0), kd=(3.0, 3.0))"
    assert repr(controllers.make("oracle-flm", env)) == "OracleFlm(kp=(400.0, 400.0), kd=(40.0, 40.0))"


def test_an_environment_that_observes_otherwise_is_refused():
    several = TwoLinkArmVectorEnv(2, ["nominal", "noise-1"])
    for env in (fbl_gym.TwoLinkArmTrackingEnv(), fbl_gym.TwoLinkArmTrackingVectorEnv(2), several):
        with pytest.raises(ValueError, match=r"one scenario as TwoLinkArm-v0 does, got a (TwoLink|SideBy)"):
            controllers.make("computed-torque", env)


WITHOUT = ("zero", "computed-torque-eso", "h-infinity", "ladrc", "lqg-elastic", "oracle")


@pytest.mark.parametrize("name", [name for name in controllers.names() if not name.startswith(WITHOUT)])
def test_a_missing_sensor_is_named(name):
    with pytest.raises(ValueError, match=r"needs a sensor of|the agent has sensors of position, velocity"):
        controllers.factory(name)(TwoLinkArmEnv(sensors=("position",)).interface)


def test_the_reference_ahead_is_read_from_the_preview():
    env = TwoLinkArmVectorEnv(2, "servo-nominal", preview=3)
    ahead = reference_at(env.interface, env.reset(seed=0)[0], np.array([0.0, 0.03]))
    first, *_, last = truths_of(env, np.zeros((3, 2, 2)))
    np.testing.assert_allclose(ahead[..., :2], np.stack([first.reference, last.reference], axis=1), atol=1e-12)


def test_a_wrong_observation_is_refused():
    with pytest.raises(ValueError, match=r"observation must have shape \(12,\)"):
        controllers.make("pid-flm", TwoLinkArmEnv()).predict(np.zeros(7))


@pytest.mark.parametrize(("answer", "got"), [
    (lambda n: np.zeros((n, 2)), "got a ndarray"),
    (lambda n: (np.zeros((n, 4)), ()), r"got a torque of shape \(3, 4\)"),
    (lambda n: (None, ()), r"got a torque of shape \(\)"),
])  # fmt: skip
def test_a_law_that_answers_wrongly_is_told_what_is_right(answer, got):
    class Mine(controllers.TorqueLaw):
        def torque(self, observation, state):  # noqa: ARG002
            return answer(len(observation))

    interface = TwoLinkArmEnv().interface
    with pytest.raises(ValueError, match=rf"Mine.torque must return a torque \[3 x 2\] and the next state, {got}"):
        Mine(interface).predict(np.zeros((3, 12)))
    with pytest.raises(ValueError, match=r"'kp'.* are @dataclass\(frozen=True\) and its annotation missing"):
        controllers.make(Mine, interface, kp=3.0)
    with pytest.raises(ValueError, match=r"must be a name here, got 'mine\.py@gains': give its class"):
        controllers.make("mine.py@gains", interface)


# The registry.


LAWS = [name for name in controllers.names() if controllers.kind(name) == "classical"]


def test_a_name_is_registered_once():
    with pytest.raises(ValueError, match="registered already"):
        controllers.register("zero", "controllers.laws.simple:Zero", "again")


@pytest.mark.parametrize("name", LAWS)
def test_the_catalogue_has_the_access_of_the_class(name):
    assert controllers.access(name) == controllers.access(controllers.factory(name))


def test_the_environment_goes_to_an_oracle_alone(monkeypatch):
    """To what is registered or declared as one; the name of an argument gives no way to the truth."""
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))

    def factory(env):
        return env

    env = TwoLinkArmEnv()
    assert isinstance(controllers.make(factory, env), Interface)
    for name, made, access in (("mine", factory, "oracle"), ("other", "controllers.oracles.oracle:OracleFlm", None)):
        controllers.register(name, made, "a policy", access=access)
        assert controllers.access(name) == "oracle"
    with pytest.raises(ValueError, match="needs the environment, got its interface"):
        controllers.make("oracle-flm", env.interface)
    factory.access = "oracle"
    assert controllers.make(factory, env) is env
    factory.access = "truth"
    register = lambda made: controllers.register("third", made, "a policy", access="truth")
    for ask in (controllers.access, lambda made: controllers.make(made, env), register):
        with pytest.raises(ValueError, match=r"unknown access.* 'truth'"):
            ask(factory)


def test_an_installed_package_adds_a_policy(monkeypatch):
    point = metadata.EntryPoint("mine", "controllers.laws.simple:PdGravity", registry.ENTRY_POINTS)
    monkeypatch.setattr(registry, "entry_points", lambda: (point,))
    assert "mine" in controllers.names()
    told = [ask("mine") for ask in (controllers.access, controllers.kind, controllers.summary)]
    assert told == ["nominal", "classical", "PD with gravity compensation."]
    assert controllers.make("mine", TwoLinkArmEnv(), frequency=3.0).frequency == (3.0, 3.0)


def tune(folder, **frequencies):
    """Write tuned gains of pd-gravity for classes of robots."""
    for robot, frequency in frequencies.items():
        (folder / robot).mkdir(exist_ok=True)
        (folder / robot / "pd-gravity.json").write_text(json.dumps({"gains": {"frequency": frequency}}))


@pytest.fixture
def tuned(tmp_path, monkeypatch):
    monkeypatch.setattr("controllers.name.TUNED", tmp_path)
    tune(tmp_path, geared=3.0, direct=4.0)
    return tmp_path


@pytest.mark.usefixtures("tuned")
def test_gains_of_a_class():
    """The error of a class without gains says how to find some."""
    env = TwoLinkArmEnv("geared-nominal")
    for tuning, frequency in (("geared", 3.0), ("tuned", 3.0), ("direct", 4.0)):
        assert controllers.make(f"pd-gravity@{tuning}", env).frequency == (frequency, frequency)
    assert controllers.make("pd-gravity@tuned", TwoLinkArmEnv("direct-nominal")).frequency == (4.0, 4.0)
    for name in ("pd-gravity@servo", "pd-gravity+springs@servo"):
        with pytest.raises(ValueError, match=r"no tuned gains for the class .*fbl-gym tune pd-gravity.* --class"):
            resolve(name)
    with pytest.raises(ValueError, match="no tuned gains for the class servo"):
        controllers.make("pd-gravity@tuned", TwoLinkArmEnv("servo-nominal"))


def test_results_follow_the_gains_of_every_class(tuned):
    """A cell follows those of its own class."""
    cells = [Cell("pd-gravity@tuned", task, (0,)) for task in ("direct-nominal", "geared-nominal")]
    first, keys = resolve("pd-gravity@tuned").identity, [cell.key for cell in cells]
    tune(tuned, geared=5.0)
    second = resolve("pd-gravity@tuned").identity
    assert {name for name in first if first[name] != second[name]} == {"tuned"}
    again = [Cell("pd-gravity@tuned", cell.scenario, (0,)).key for cell in cells]
    assert [one == two for one, two in zip(again, keys, strict=True)] == [True, False]


@pytest.mark.parametrize("name", [name for robot in CLASSES for name in controllers.tuned(robot)])
def test_tuned_gains_are_in_the_tuning_range(name):
    ranges = tuning_ranges(controllers.factory(name))
    assert ranges
    for gain, value in registry.tuned_gains(name).items():
        low, high = ranges[gain]
        assert low <= np.min(value) <= np.max(value) <= high


def test_a_subclass_keeps_the_declaration_of_a_plain_default_and_replaces_another():
    @dataclass(frozen=True)
    class Faster(PdGravity):
        frequency: float = 20.0
        damping: float = number(0.5, low=0, high=1)

    ranges, interface = tuning_ranges(PdGravity), TwoLinkArmEnv().interface
    assert tuning_ranges(Faster) == {"frequency": ranges["frequency"]}
    assert Faster(interface).frequency == (20.0, 20.0)
    with pytest.raises(ValueError, match="damping must be a finite number not below 0 and not above 1"):
        Faster(interface, damping=2.0)


@pytest.mark.parametrize("name", LAWS)
def test_a_gain_out_of_bounds_is_named(name):
    env, law = TwoLinkArmEnv(), controllers.factory(name)
    for gain in (gain for gain in fields(law) if gain.owner is law):
        right = "whole number" if gain.is_whole else "finite number"
        for word, bound in gain.bounds if gain.is_number else ():
            message = rf"{gain.name} must be a {right} {word} {bound:g}.*, got "
            for value in [round(bound) - 1, *([round(bound)] if word == "greater than" else []), math.nan, "1"]:
                with pytest.raises(ValueError, match=message + repr(value)):
                    controllers.make(name, env, **{gain.name: value})
