"""A law's text may have parts, and may end in gains: numbers, a file, or a folder with a file for each law."""

import dataclasses
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import controllers
from benchmarks.policies.spec import resolve
from benchmarks.run.cell import Cell
from benchmarks.run.rollout import rollout
from controllers.base import TorqueLaw
from controllers.composition import compose
from controllers.name import PolicyName
from controllers.registry import tuned_gains
from fbl_gym import TABLE_1, TwoLinkArmEnv, scenarios
from fbl_gym.records.record import tuning_ranges

NAMES = tomllib.loads(Path(__file__).with_name("names.toml").read_text(encoding="utf-8"))
TASK = scenarios.get("everything-2").replace(duration=0.5)


@pytest.fixture(autouse=True)
def files(folder):
    (folder / "parted.py").write_text(NAMES["law"].format(gain="observer"))
    (folder / "law.py").write_text("from controllers.laws.simple import PdGravity\n\nmake_policy = PdGravity\n")
    (folder / "free.py").write_text(NAMES["factory"])
    (folder / "law.json").write_text('{"gains": {"kp": "x"}}')
    (folder / "my_arm").mkdir()
    (folder / "my_arm/pd-gravity.json").write_text(json.dumps({"gains": {"frequency": 8.0}}))
    (folder / "gains.json").write_text('{"frequency": [8, 9]}')


@pytest.mark.parametrize("factory", ["", ":Law"])
def test_a_law_of_a_file_with_parts_runs_and_can_be_tuned(factory):
    spec = resolve(f"parted.py{factory}+kalman+predictor@frequency=5@kalman_bandwidth=60")
    assert (spec.parsed.form, spec.parsed.parts, spec.problem) == ("file", ("kalman", "predictor"), "")
    assert {"frequency", "kalman_bandwidth", "predictor_lead"} <= tuning_ranges(spec.factory()).keys()
    assert (rollout(spec, TASK, range(2)).position != rollout("parted.py@frequency=5", TASK, range(2)).position).any()
    assert spec.identity["policy"] != resolve("parted.py").identity["policy"]


@pytest.mark.parametrize(("text", "form", "source", "attribute", "parts"), NAMES["read"])
def test_a_text_is_read_and_written_as_it_is(text, form, source, attribute, parts):
    name = PolicyName.parse(text)
    assert (name.form, name.source, name.attribute, [*name.parts]) == (form, source, attribute, parts)
    assert str(name) == text


def test_gains_of_the_law_are_also_those_of_the_law_with_parts(tmp_path):
    assert tuned_gains("sliding-mode+barrier@tuned") == tuned_gains("sliding-mode@tuned")
    assert tuned_gains("sliding-mode+predictor+barrier@tuned") == tuned_gains("sliding-mode+predictor@tuned")
    policy = controllers.make("sliding-mode+kalman@tuned", TwoLinkArmEnv())
    assert policy.kalman_bandwidth == compose(TorqueLaw, "kalman").kalman_bandwidth
    for name, gains in (("parted.py", {"frequency": 3.0}), ("parted.py+kalman", {"frequency": 4.0})):
        (tmp_path / f"{name}.json").write_text(json.dumps({"policy": name, "gains": gains}))
        assert resolve(f"parted.py+kalman@{tmp_path}").parsed.given_gains == gains
    with pytest.raises(ValueError, match=r"has the gains of parted.py\+kalman, not of parted.py"):
        resolve("parted.py@parted.py+kalman.json")


def test_a_gain_may_be_a_multiple_of_the_tuned_or_default_one():
    """Each class has its own tuned gains. The multiple and the number are two policies."""
    for robot in ("servo", "direct"):
        env = TwoLinkArmEnv(scenarios.get(f"{robot}-nominal"))
        policy, tuned = controllers.make("lqg@tuned@position=0.5,2x", env), tuned_gains("lqg@tuned", robot)
        np.testing.assert_array_equal(policy.position, [0.5, 2.0] * np.array(tuned["position"]))
    one, two = (resolve(text).make(env).frequency for text in ("parted.py", "parted.py@frequency=4x@frequency=0.5x"))
    assert two == 2.0 * one
    assert resolve("parted.py@frequency=30@frequency=0.5x").make(env).frequency == 15.0
    assert resolve("lqg@position=0.5x").identity != resolve("lqg@position=0.5").identity


@pytest.mark.parametrize("gain", ["_inside", "kalman_bandwidth", "needs"])
def test_a_gain_with_a_name_of_the_composed_law_is_refused(folder, gain):
    (folder / "parted.py").write_text(NAMES["law"].format(gain=gain))
    with pytest.raises(ValueError, match=f"has a {gain} of its own, so a gain of Law needs another name"):
        resolve("parted.py+kalman")


@pytest.mark.parametrize(("text", "frequency", "damping"), [
    ("pd-gravity@my_arm", (8.0, 8.0), 0.4), ("pd-gravity@my_arm/pd-gravity.json@damping=0.7", (8.0, 8.0), 0.7),
    ("law.py@gains.json", (8.0, 9.0), 0.4), ("law.py:PdGravity@frequency=8,9", (8.0, 9.0), 0.4),
    ("free.py@frequency=8,9", (8.0, 9.0), 0.4),
])  # fmt: skip
def test_gains_of_a_text_reach_the_law(text, frequency, damping):
    law = (spec := resolve(text)).make(TwoLinkArmEnv())
    assert (law.frequency, law.damping, spec.tuning) == (frequency, (damping, damping), "given gains")
    assert Cell(spec, "nominal", (0,)).key != Cell(str(spec.parsed.code), "nominal", (0,)).key


def test_tuned_gains_are_changed_one_by_one():
    tuned, changed = (resolve(text).make(TwoLinkArmEnv()) for text in ("pid-flm@tuned", "pid-flm@tuned@kp=7"))
    assert (changed.kp, changed.ki, changed.kd) == ((7.0, 7.0), tuned.ki, tuned.kd)


@pytest.mark.parametrize(("text", "message"), [
    *NAMES["refused"].items(),
    *[(PolicyName(form, "os"), f"unknown form of a policy's name {form!r}") for form in ("weird", "", "Module")],
    (PolicyName.parse("law.py@gains.json", "a suite"), r"a suite names law\.py@gains\.json, whose code would be run"),
], ids=str)  # fmt: skip
def test_a_wrong_name_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        resolve(text)


def test_gains_of_another_arm_are_named(folder, fbl_gym):
    (folder / "told.json").write_text(json.dumps({"gains": {"frequency": 8.0}, "arms": [dataclasses.asdict(TABLE_1)]}))
    for file, scenario, named in (("told", "nominal", 0), ("told", "servo-nominal", 1), ("gains", "servo-nominal", 0)):
        shown = fbl_gym(f"evaluate pd-gravity@{file}.json --scenario {scenario} --seeds 1").out
        assert shown.count(f"{file}.json has the gains of another arm") == named
