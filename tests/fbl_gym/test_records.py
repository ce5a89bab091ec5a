"""Records: frozen values, and the plain data that makes them."""

import dataclasses
import json

import numpy as np
import pytest

from fbl_gym import (
    Actuator,
    ArmParameters,
    ArrayDisturbance,
    ArrayReference,
    FilteredSteps,
    FourierReference,
    Friction,
    Limits,
    MinimumJerk,
    Noise,
    ParameterError,
    Payload,
    PiecewiseConstantDisturbance,
    PulseDisturbance,
    Reward,
    Scenario,
    SensorError,
    SineDisturbance,
    SineReference,
    Steps,
    TwoLinkArmEnv,
)

ROWS = ((0.0, 1.0), (2.0, 3.0))
# One of each kind, with no field at its default.
RECORDS = [
    ArmParameters(1.0, 2.0, 3.0, 4.0, gravity=5.0, centre=0.5, inertia=0.1),
    Payload(2.0, pick_up=1.0, drop=3.0),
    ParameterError(ratio=(1, 2, 3, 4), radius=0.5, parameters=("m2",), sampling="together", payload=3.0),
    SensorError(sigma=(0.1, 0.2), bias=0.3, quantization=(0.0, 0.5)),
    SensorError(snr_db=20.0),
    Noise(position=0.1, velocity={"snr_db": 10.0}, acceleration=(0.1, 0.2)),
    Friction(viscous=1.0, coulomb=(2.0, 3.0), stiction=4.0, v_s=(0.1, 0.2), law="literal"),
    PiecewiseConstantDisturbance((1.0, 2.0), period=0.3),
    SineDisturbance((1.0, 2.0), frequency=3.0, phase=(0.1, 0.2)),
    PulseDisturbance(-3.0, period=1.0, width=0.2, start=0.3),
    ArrayDisturbance(ROWS, dt=0.2),
    Actuator(torque_limit=(10.0, 20.0), delay=0.01, lag=0.02),
    MinimumJerk(low=-2.0, high=2.0, points=ROWS, move_time=1.0, hold_time=0.2),
    Steps(low=-2.0, high=2.0, points=ROWS, period=0.5),
    FilteredSteps(low=-2.0, high=2.0, points=ROWS, period=0.5, bandwidth=3.0),
    SineReference(centre=1.0, amplitude=(2.0, 3.0), frequency=0.5, phase=None),
    FourierReference(centre=1.0, amplitude=(2.0, 3.0), frequency=0.5, harmonics=3),
    ArrayReference(ROWS, dt=0.2, velocity=ROWS, acceleration=ROWS),
    Limits(position=2.0, velocity=2.0, acceleration=3.0, command=4.0, error=0.5, error_time=0.1),
    Reward(tracking="l1", worst=1.0, resolution=0.1, weight_tracking=2.0, weight_effort=3.0, weight_chatter=4.0),
]
NAMES = [f"{type(record).__name__}-{i}" for i, record in enumerate(RECORDS)]
# The option of the environment that takes each record.
PLACES = [
    lambda x: {"arm": x},
    lambda x: {"parameter_error": {"payload": x}},
    lambda x: {"parameter_error": x},
    lambda x: {"noise": {"position": x}},
    lambda x: {"noise": {"velocity": x}},
    lambda x: {"noise": x},
    lambda x: {"friction": x},
    *[lambda x: {"disturbance": x}] * 4,
    lambda x: {"actuator": x},
    *[lambda x: {"reference": x}] * 6,
    lambda x: {"limits": x},
    lambda x: {"reward": x},
]


def plain(record):
    """The record as it comes back from JSON."""
    return json.loads(json.dumps(dataclasses.asdict(record)))


@pytest.mark.parametrize("record", RECORDS, ids=NAMES)
def test_records_are_frozen(record):
    for field in dataclasses.fields(record):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(record, field.name, 1.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        record.something_new = 1.0


@pytest.mark.parametrize("record", RECORDS, ids=NAMES)
def test_records_hash_and_compare_by_value(record):
    same = dataclasses.replace(record)
    assert same is not record
    assert same == record
    assert hash(same) == hash(record)
    assert len({record, same}) == 1


@pytest.mark.parametrize("record", RECORDS, ids=NAMES)
def test_records_survive_json(record):
    assert type(record)(**plain(record)) == record


@pytest.mark.parametrize("record", RECORDS, ids=NAMES)
def test_records_and_their_defaults_hold_only_immutable_values(record):

    def is_fixed(value):
        if isinstance(value, tuple):
            return all(map(is_fixed, value))
        if dataclasses.is_dataclass(value):
            return all(is_fixed(getattr(value, field.name)) for field in dataclasses.fields(value))
        return value is None or isinstance(value, int | float | str)

    assert is_fixed(record)
    for field in dataclasses.fields(record):
        assert field.default is dataclasses.MISSING or is_fixed(field.default)


@pytest.mark.parametrize(("record", "place"), list(zip(RECORDS, PLACES, strict=True)), ids=NAMES)
def test_a_record_and_its_plain_data_are_the_same_option(record, place):
    options = {"actuator": {"torque_limit": (2000.0, 800.0)}, "control_dt": 0.01}
    one, two = TwoLinkArmEnv(**{**options, **place(record)}), TwoLinkArmEnv(**{**options, **place(plain(record))})
    assert one.scenario == two.scenario
    assert one.interface == two.interface
    np.testing.assert_array_equal(one.reset(seed=0)[0], two.reset(seed=0)[0])
    a, b = one.step((0.1, 0.1)), two.step((0.1, 0.1))
    np.testing.assert_array_equal(a[0], b[0])
    assert a[1] == b[1]


def test_numbers_pairs_lists_and_arrays_make_equal_records():
    for value in (0.5, (0.5, 0.5), [0.5, 0.5], np.array([0.5, 0.5]), np.float64(0.5), np.float32(0.5)):
        assert SensorError(sigma=value) == SensorError(sigma=(0.5, 0.5))
    assert Friction(coulomb=2) == Friction(coulomb=np.int32(2)) == Friction(coulomb=(2.0, 2))
    assert ParameterError(ratio=[1, 2, 1, 1]) == ParameterError(ratio={"m2": 2.0}) == ParameterError(ratio=(1, 2, 1, 1))
    assert ParameterError(parameters="m1") == ParameterError(parameters=["m1"])
    assert ArrayDisturbance(np.array(ROWS)) == ArrayDisturbance([list(row) for row in ROWS]) == ArrayDisturbance(ROWS)
    assert Scenario(sensors="position") == Scenario(sensors=["position"])


def test_a_ratio_may_be_an_array():
    assert ParameterError(ratio=np.array([1.0, 2.0, 1.0, 1.0])) == ParameterError(ratio=(1.0, 2.0, 1.0, 1.0))


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
    assert TwoLinkArmEnv(actuator=None, action="torque").torque_limit is None


def test_a_record_does_not_share_the_data_it_was_made_from():
    """Later changes of a dict, list or array change no record; making a record changes none of them."""
    table, ratio, sensors = np.array(ROWS), {"m1": 2.0}, ["position", "velocity"]
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
    assert before["disturbance"]["torque"] == [[0.0, 1.0], [2.0, 3.0]]


def test_no_default_is_shared_between_environments():
    one, two = TwoLinkArmEnv(noise={"position": 0.1}), TwoLinkArmEnv()
    assert two.scenario.noise is None
    assert one._batch._memory is not two._batch._memory
    one._batch._memory[:] = 0.0
    assert TwoLinkArmEnv()._batch._memory.any()


def test_derived_numbers_of_records():
    assert SensorError(snr_db=20.0).std == pytest.approx((0.1, 0.1))
    assert SensorError(sigma=(0.1, 0.2)).std == (0.1, 0.2)
    assert ParameterError(ratio={"L2": 3.0}).ratios == (1.0, 1.0, 1.0, 3.0)
    assert (Scenario(control_dt=0.02).substeps, Scenario(control_dt=0.02).steps) == (20, 500)
