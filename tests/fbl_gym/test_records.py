"""Records: declarations give checks, conversion, tuning range and documentation; plain data makes records."""

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest

from fbl_gym import (
    Actuator,
    ArrayDisturbance,
    FourierReference,
    Friction,
    Noise,
    ParameterError,
    Payload,
    Scenario,
    SensorError,
    TwoLinkArmEnv,
)
from fbl_gym.checks import Pair
from fbl_gym.options.descriptions import describe
from fbl_gym.records import Record, choice, choices, number, pair, record, tuning_ranges, whole
from tests.fbl_gym.declared import TABLE


@dataclass(frozen=True)
class Spring(Record):
    """A spring.

    Args:
        stiffness: of the spring.
    """

    stiffness: float = number(unit="N/m", above=0)


@dataclass(frozen=True)
class Joint(Record):
    """A joint.

    Args:
        gain: of the joint's
            controller.
        limit: largest torque; None: no limit.
        mode: of the controller.
        sensors: that are used.
        links: number of links.
        spring: in the joint.
    """

    gain: Pair | float = pair(10.0, unit="1/s", tune=(1.0, 100.0), low=0)
    limit: float | None = number(5.0, unit="N m", above=0, optional=True)
    mode: str = choice("fast", ("fast", "exact"))
    sensors: tuple[str, ...] = choices(("angle",), ("angle", "speed"))
    links: int = whole(2, low=1)
    spring: Spring | None = record(Spring, None, scalar="stiffness")

    def validate(self):
        if self.mode == "exact" and self.limit is None:
            raise ValueError("mode='exact' needs a limit, got None")


def test_values_are_checked_and_converted():
    joint = Joint(gain=3, limit=None, sensors=["speed", "angle"], spring={"stiffness": 2})
    assert joint == Joint((3.0, 3.0), None, "fast", ("angle", "speed"), 2, Spring(2.0))
    assert Joint(spring=2.0).spring == Spring(2.0)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"gain": (1.0, -1.0)}, r"gain\[1\] must be a finite number not below 0, got -1.0"),
        ({"mode": "fst"}, "unknown mode 'fst'; did you mean 'fast'"),
        ({"sensors": "angel"}, "unknown sensor 'angel'; did you mean 'angle'"),
        ({"links": 0}, "links must be a whole number not below 1, got 0"),
        ({"links": None}, "links must be a whole number not below 1, got None"),
        ({"spring": {"stiffness": 0}}, "spring: stiffness must be a finite number greater than 0, got 0"),
        ({"mode": "exact", "limit": None}, "mode='exact' needs a limit"),
    ],
)
def test_a_wrong_value_is_an_error_with_field_value_and_right_form(fields, message):
    with pytest.raises(ValueError, match=message):
        Joint(**fields)


def test_only_gains_with_a_range_are_tuned():
    assert tuning_ranges(Joint) == {"gain": (1.0, 100.0)}


def test_a_subclass_with_another_default_keeps_the_declaration():
    @dataclass(frozen=True)
    class Stiff(Joint):
        gain: Pair | float = 50.0

    assert Stiff().gain == (50.0, 50.0)
    assert tuning_ranges(Stiff) == tuning_ranges(Joint)
    with pytest.raises(ValueError, match=r"gain must be a finite number not below 0, got -1"):
        Stiff(gain=-1)


def test_a_description_has_form_unit_default_meaning_and_range():
    fields = {field.path: field for field in describe(Joint, "joint.")}
    gain = fields["joint.gain"]
    assert (gain.form, gain.unit, gain.default) == ("one or two numbers not below 0", "1/s", "10")
    assert (gain.meaning, gain.tune) == ("of the joint's controller.", "1 to 100")
    assert fields["joint.limit"].form == "a number greater than 0, or None"
    assert fields["joint.spring"].form == "a Spring, a dict of its fields or its stiffness, or None"
    assert fields["joint.spring.stiffness"].default == "required"


# Plain data.


def test_numbers_pairs_lists_and_arrays_make_equal_records():
    for value in (0.5, (0.5, 0.5), [0.5, 0.5], np.array([0.5, 0.5]), np.float64(0.5), np.float32(0.5)):
        assert SensorError(sigma=value) == SensorError(sigma=(0.5, 0.5))
    assert Friction(coulomb=2) == Friction(coulomb=np.int32(2)) == Friction(coulomb=(2.0, 2))
    assert (
        len({ParameterError(x) for x in ([1, 2, 1, 1], {"m2": 2.0}, (1, 2, 1, 1), np.array([1.0, 2.0, 1.0, 1.0]))}) == 1
    )
    assert ParameterError(parameters="m1") == ParameterError(parameters=["m1"])
    assert (
        ArrayDisturbance(np.array(TABLE)) == ArrayDisturbance([list(row) for row in TABLE]) == ArrayDisturbance(TABLE)
    )
    assert Scenario(sensors="position") == Scenario(sensors=["position"])


def test_one_value_stands_for_its_record():
    assert TwoLinkArmEnv(parameter_error=2.0).scenario.parameter_error == ParameterError(ratio=2.0)
    assert TwoLinkArmEnv(parameter_error={"payload": 3.0}).scenario.parameter_error.payload == Payload(3.0)
    assert TwoLinkArmEnv(noise={"position": (0.1, 0.2)}).scenario.noise == Noise(position=SensorError((0.1, 0.2)))
    assert TwoLinkArmEnv(actuator=(10.0, 20.0)).scenario.actuator == Actuator(torque_limit=(10.0, 20.0))
    assert TwoLinkArmEnv(reference="fourier").scenario.reference == FourierReference()
    assert TwoLinkArmEnv(arm="section-2-2").scenario.arm.L1 == 20.0


def test_none_switches_an_option_off():
    off = {"parameter_error": None, "noise": None, "friction": None, "disturbance": None}
    scenario = TwoLinkArmEnv("everything-3", **off).scenario
    assert dataclasses.replace(scenario, name="nominal", description=Scenario().description) == Scenario()
    assert TwoLinkArmEnv(actuator=None, action="torque").interface.torque_limit is None
    assert Scenario(events=None).events == ()


def test_a_record_does_not_share_the_data_it_was_made_from():
    """Later changes of a dict, list or array change no record; making a record changes none of them."""
    table, ratio, sensors = np.array(TABLE), {"m1": 2.0}, ["position", "velocity"]
    error = {"ratio": ratio, "payload": {"mass": 1.0}}
    options = {"disturbance": {"kind": "array", "torque": table}, "parameter_error": error, "sensors": sensors}
    env = TwoLinkArmEnv(**options)
    before = env.scenario.to_dict()
    assert error == {"ratio": {"m1": 2.0}, "payload": {"mass": 1.0}}
    table[:] = 9.0
    ratio["m1"] = 9.0
    error["payload"]["mass"] = 9.0
    sensors.append("acceleration")
    assert env.scenario.to_dict() == before
    assert before["disturbance"]["torque"] == [list(row) for row in TABLE]


def test_no_default_is_shared_between_environments():
    one, two = TwoLinkArmEnv(noise={"position": 0.1}), TwoLinkArmEnv()
    assert two.scenario.noise is None
    assert one._batch._memory is not two._batch._memory
    one._batch._memory[:] = 0.0
    assert TwoLinkArmEnv()._batch._memory.any()


def test_derived_numbers_of_records():
    assert SensorError(snr_db=20.0).std_at(0.01) == pytest.approx((0.1, 0.1))
    assert SensorError(sigma=(0.1, 0.2)).std_at(0.01) == (0.1, 0.2)
    assert ParameterError(ratio={"L2": 3.0}).ratios == (1.0, 1.0, 1.0, 3.0)
    assert (Scenario(control_dt=0.02).substeps, Scenario(control_dt=0.02).steps) == (20, 500)
