"""A law's text may end in gains: numbers, a file, or a folder with a file for each law."""

import dataclasses
import json

import pytest

from benchmarks import cli
from benchmarks.policies import external
from benchmarks.policies.name import PolicyName
from benchmarks.policies.spec import Changed, resolve
from benchmarks.run.suite import Cell
from fbl_gym import SECTION_2_2, TABLE_1, TwoLinkArmEnv

LAW = """
from controllers.simple import PdGravity

make_policy = PdGravity
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "law.py").write_text(LAW)
    (tmp_path / "my_arm").mkdir()
    (tmp_path / "my_arm/pd-gravity.json").write_text(json.dumps({"gains": {"frequency": 8.0}}))
    (tmp_path / "gains.json").write_text('{"frequency": [8, 9]}')
    return tmp_path


@pytest.mark.parametrize(
    ("text", "frequency", "damping"),
    [
        ("pd-gravity@frequency=8", (8.0, 8.0), 0.4),
        ("pd-gravity@frequency=8@damping=0.7", (8.0, 8.0), 0.7),
        ("pd-gravity@my_arm", (8.0, 8.0), 0.4),
        ("pd-gravity@my_arm/pd-gravity.json@damping=0.7", (8.0, 8.0), 0.7),
        ("law.py@gains.json", (8.0, 9.0), 0.4),
        ("law.py:PdGravity@frequency=8,9", (8.0, 9.0), 0.4),
    ],
)
def test_gains_of_a_text_reach_the_law(text, frequency, damping):
    spec = resolve(text)
    law = spec.make(TwoLinkArmEnv())
    assert law.frequency == frequency
    assert law.damping == (damping, damping)
    assert spec.tuning == "given gains"
    assert Cell(spec, "nominal", (0,)).key != Cell(spec.parsed.code.text, "nominal", (0,)).key


def test_tuned_gains_are_changed_one_by_one():
    tuned, changed = (resolve(text).make(TwoLinkArmEnv()) for text in ("pid-flm@tuned", "pid-flm@tuned@kp=7"))
    assert (changed.kp, changed.ki, changed.kd) == ((7.0, 7.0), tuned.ki, tuned.kd)


def test_changed_gains_are_another_cell(folder):
    spec = resolve("law.py@gains.json")
    (folder / "gains.json").write_text('{"frequency": 7}')
    with pytest.raises(Changed, match="changed since it was resolved"):
        spec.make(TwoLinkArmEnv())
    assert resolve("law.py@gains.json").identity != spec.identity


def test_gains_hide_no_code_that_needs_trust():
    with pytest.raises(external.Untrusted, match=r"law\.py@gains\.json, whose code would be run"):
        external.expect_trust(PolicyName.parse("law.py@gains.json"), "a suite")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pid-flm@tunde", "unknown policy 'pid-flm@tunde'; did you mean 'pid-flm@tuned'"),
        ("pid-flm@lost/gains", "gains of pid-flm: there is no file lost/gains/pid-flm.json"),
        ("law.py@lost.json", "gains of law.py: there is no file lost.json"),
        ("law.py@law.json", "law.json must be JSON with numbers"),
        ("pid-flm@kpp=3", "unknown argument of pid-flm 'kpp'; did you mean 'kp'"),
        ("pid-flm@kp=x", "must be such as kp=25, or kp=25,30 for the two joints, got 'kp=x'"),
        ("ppo-memory@kp=3", "unknown argument of ppo-memory 'kp'"),
    ],
)
def test_wrong_gains_are_refused(text, message, folder):
    (folder / "law.json").write_text('{"gains": {"kp": "x"}}')
    with pytest.raises(ValueError, match=message):
        resolve(text)


def test_gains_of_another_arm_are_named(folder, capsys):
    arm = dataclasses.asdict(TABLE_1)
    (folder / "told.json").write_text(json.dumps({"gains": {"frequency": 8.0}, "arms": [arm]}))
    name = PolicyName.parse("pd-gravity@told.json")
    assert name.gains_of_other_arms(TABLE_1) == []
    assert name.gains_of_other_arms(SECTION_2_2) == [folder / "told.json"]
    assert PolicyName.parse("pd-gravity@gains.json").gains_of_other_arms(SECTION_2_2) == []
    for scenario, names in (("nominal", False), ("servo-nominal", True)):
        assert cli.main(["evaluate", "pd-gravity@told.json", "--scenario", scenario, "--seeds", "1"]) == 0
        assert ("told.json has the gains of another arm" in capsys.readouterr().out) == names
