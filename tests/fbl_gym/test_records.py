"""Records are made from plain data; `test_options.py` checks what their declarations give."""

import dataclasses

import numpy as np
import pytest

from controllers.laws.simple import PdGravity
from fbl_gym import SECTION_2_2, Friction, ParameterError, Scenario, SensorError, TwoLinkArmEnv, options
from fbl_gym.records.descriptions import describe
from tests.fbl_gym.declared import TABLE


def test_a_gain_is_described_with_its_tuning_range():
    gains = {field.path: (field.form, field.unit, field.tune) for field in describe(PdGravity)}
    assert gains["frequency"] == ("one or two numbers", "rad/s", "2 to 100")


def test_numbers_pairs_lists_and_arrays_make_equal_records():
    assert Friction(coulomb=2) == Friction(coulomb=np.int32(2)) == Friction(coulomb=(2.0, 2))
    for ratio in ([1, 2, 1, 1], (1, 2, 1, 1), np.array([1.0, 2.0, 1.0, 1.0])):
        assert ParameterError(ratio) == ParameterError({"m2": 2.0})
    assert ParameterError(parameters="m1") == ParameterError(parameters=["m1"])
    array = options.ArrayDisturbance
    assert array(np.array(TABLE)) == array([list(row) for row in TABLE])
    assert Scenario(sensors="position") == Scenario(sensors=["position"])


def test_a_number_in_single_precision_is_as_it_is_printed():
    single, pair = np.float32(0.01), np.array([0.1, 0.2], dtype=np.float32)
    given = Scenario(control_dt=single, duration=np.float32(0.3), actuator={"torque_limit": pair, "delay": single})
    assert given == Scenario(control_dt=0.01, duration=0.3, actuator={"torque_limit": (0.1, 0.2), "delay": 0.01})


def test_one_value_stands_for_its_record():
    for name, value, record in (
        ("parameter_error", 2.0, ParameterError(ratio=2.0)),
        ("parameter_error", {"payload": 3.0}, ParameterError(payload=options.Payload(3.0))),
        ("noise", {"position": (0.1, 0.2)}, options.Noise(position=SensorError((0.1, 0.2)))),
        ("actuator", (10.0, 20.0), options.Actuator(torque_limit=(10.0, 20.0))),
        ("reference", "fourier", options.FourierReference()),
        ("arm", "section-2-2", SECTION_2_2),
    ):
        assert getattr(TwoLinkArmEnv(**{name: value}).scenario, name) == record


def test_none_switches_an_option_off():
    off = {"parameter_error": None, "noise": None, "friction": None, "disturbance": None}
    scenario = TwoLinkArmEnv("everything-3", **off).scenario
    assert dataclasses.replace(scenario, name="nominal", description=Scenario().description) == Scenario()
    assert TwoLinkArmEnv(actuator=None, action="torque").interface.torque_limit is None
    assert Scenario(events=None).events == ()


def test_a_record_does_not_share_the_data_it_was_made_from():
    """Later changes of a dict, list or array change no record; making a record changes none of them."""
    table, sensors = np.array(TABLE), ["position", "velocity"]
    error = {"ratio": {"m1": 2.0}, "payload": {"mass": 1.0}}
    env = TwoLinkArmEnv(disturbance={"kind": "array", "torque": table}, parameter_error=error, sensors=sensors)
    before = env.scenario.to_dict()
    assert error == {"ratio": {"m1": 2.0}, "payload": {"mass": 1.0}}
    table[:] = error["ratio"]["m1"] = error["payload"]["mass"] = 9.0
    sensors.append("acceleration")
    assert env.scenario.to_dict() == before
    assert before["disturbance"]["torque"] == [list(row) for row in TABLE]


def test_no_default_is_shared_between_environments():
    TwoLinkArmEnv()._batch._memory[:] = 0.0
    assert TwoLinkArmEnv()._batch._memory.any()


def test_derived_numbers_of_records():
    for given, std in (({"snr_db": 20.0}, (0.1, 0.1)), ({"sigma": (0.1, 0.2)}, (0.1, 0.2))):
        assert SensorError(**given).std_at(0.01) == pytest.approx(std)
    assert (Scenario(control_dt=0.02).substeps, Scenario(control_dt=0.02).steps) == (20, 500)
