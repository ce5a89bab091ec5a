"""The registry: names, arguments, entry points, and access to the environment; gains and their declarations."""

import json
import math
from dataclasses import dataclass
from importlib import metadata

import numpy as np
import pytest

import controllers
from benchmarks.policies.spec import resolve
from benchmarks.run.cell import Cell
from controllers import registry
from controllers.laws.simple import PdGravity
from fbl_gym import Interface, TwoLinkArmEnv
from fbl_gym.records.record import number, tuning_ranges
from fbl_gym.scenarios.classes import CLASSES
from tests.fbl_gym.declared import fields


def test_a_name_is_registered_once():
    with pytest.raises(ValueError, match="registered already"):
        controllers.register("zero", "controllers.laws.simple:Zero", "again")


@pytest.mark.parametrize("name", [name for name in controllers.names() if controllers.kind(name) == "classical"])
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


LAWS = [name for name in controllers.names() if controllers.kind(name) == "classical"]


@pytest.mark.parametrize("name", [name for robot in CLASSES for name in controllers.tuned(robot)])
def test_tuned_gains_are_in_the_tuning_range(name):
    ranges = tuning_ranges(controllers.factory(name))
    assert ranges
    for gain, value in controllers.registry.tuned_gains(name).items():
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
