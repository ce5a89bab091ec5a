"""Options as plain data: what is accepted, what is refused and in which words, and that records stay as they are."""

import dataclasses
import json
import math

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
    TwoLinkArmVectorEnv,
)

ROWS = ((0.0, 1.0), (2.0, 3.0))
# One of each, with no field at its default.
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
    Limits(position=1.0, velocity=2.0, acceleration=3.0, command=4.0),
    Reward(tracking="l1", worst=1.0, resolution=0.1, weight_tracking=2.0, weight_effort=3.0, weight_chatter=4.0),
]
NAMES = [f"{type(record).__name__}-{i}" for i, record in enumerate(RECORDS)]
# Where each record stands among an environment's options.
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


# Records are values.


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
def test_records_come_back_from_json(record):
    assert type(record)(**plain(record)) == record


@pytest.mark.parametrize("record", RECORDS, ids=NAMES)
def test_records_hold_nothing_that_can_change(record):
    """Nor do their defaults: numbers, strings, None, and tuples and records of such."""

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


def test_numbers_pairs_lists_and_arrays_are_alike():
    for value in (0.5, (0.5, 0.5), [0.5, 0.5], np.array([0.5, 0.5]), np.float64(0.5), np.float32(0.5)):
        assert SensorError(sigma=value) == SensorError(sigma=(0.5, 0.5))
    assert Friction(coulomb=2) == Friction(coulomb=np.int32(2)) == Friction(coulomb=(2.0, 2))
    assert ParameterError(ratio=[1, 2, 1, 1]) == ParameterError(ratio={"m2": 2.0}) == ParameterError(ratio=(1, 2, 1, 1))
    assert ParameterError(parameters="m1") == ParameterError(parameters=["m1"])
    assert ArrayDisturbance(np.array(ROWS)) == ArrayDisturbance([list(row) for row in ROWS]) == ArrayDisturbance(ROWS)
    assert Scenario(sensors="position") == Scenario(sensors=["position"])


def test_a_ratio_may_be_an_array_as_every_other_sequence_may():
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


def test_what_is_given_is_not_kept():
    """Changing a dict, list or array afterwards changes no record, and building a record changes none of them."""
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
    assert one._batch.program.settings is not two._batch.program.settings
    one._batch.program.settings[:] = 0.0
    assert TwoLinkArmEnv()._batch.program.settings.any()


def test_derived_numbers():
    assert SensorError(snr_db=20.0).std == pytest.approx((0.1, 0.1))
    assert SensorError(sigma=(0.1, 0.2)).std == (0.1, 0.2)
    assert ParameterError(ratio={"L2": 3.0}).ratios == (1.0, 1.0, 1.0, 3.0)
    assert (Scenario(control_dt=0.02).substeps, Scenario(control_dt=0.02).steps) == (20, 500)


# Every field refuses what it cannot mean, and says its name, the value and the right form.

NUMBERS = {
    ArmParameters: ("m1", "m2", "L1", "L2", "gravity", "centre", "inertia"),
    Payload: ("mass", "pick_up", "drop"),
    ParameterError: ("ratio", "radius"),
    SensorError: ("sigma", "bias", "quantization", "snr_db"),
    Friction: ("viscous", "coulomb", "stiction", "v_s"),
    PiecewiseConstantDisturbance: ("amplitude", "period"),
    SineDisturbance: ("amplitude", "frequency", "phase"),
    PulseDisturbance: ("amplitude", "period", "width", "start"),
    ArrayDisturbance: ("dt",),
    Actuator: ("torque_limit", "delay", "lag"),
    MinimumJerk: ("low", "high", "move_time", "hold_time"),
    Steps: ("low", "high", "period"),
    FilteredSteps: ("low", "high", "period", "bandwidth"),
    SineReference: ("centre", "amplitude", "frequency", "phase"),
    FourierReference: ("centre", "amplitude", "frequency", "harmonics"),
    ArrayReference: ("dt",),
    Limits: ("position", "velocity", "acceleration", "command"),
    Reward: ("worst", "resolution", "weight_tracking", "weight_effort", "weight_chatter"),
    Scenario: ("control_dt", "physics_dt", "duration", "initial_error"),
}
NEEDED = {
    Payload: {"mass": 1.0},
    PiecewiseConstantDisturbance: {"amplitude": 1.0},
    SineDisturbance: {"amplitude": 1.0},
    PulseDisturbance: {"amplitude": 1.0},
    ArrayDisturbance: {"torque": ROWS},
    ArrayReference: {"position": ROWS},
}
FIELDS = [(cls, name) for cls, names in NUMBERS.items() for name in names]


@pytest.mark.parametrize(("cls", "name"), FIELDS, ids=[f"{cls.__name__}.{name}" for cls, name in FIELDS])
def test_a_number_must_be_a_finite_number(cls, name):
    for value in (math.nan, math.inf, -math.inf, True, np.bool_(False), "1.0", b"1", 1j, {1.0}, object):
        with pytest.raises(ValueError, match=f"{name}.* must be") as problem:
            cls(**{**NEEDED.get(cls, {}), name: value})
        assert repr(value) in str(problem.value)


NOT_NEGATIVE = [
    (Payload, "mass", 0.0),
    (Payload, "pick_up", 0.0),
    (ParameterError, "radius", 0.0),
    (SensorError, "sigma", 0.0),
    (SensorError, "quantization", 0.0),
    (Friction, "viscous", 0.0),
    (Friction, "coulomb", 0.0),
    (Friction, "stiction", 0.0),
    (PiecewiseConstantDisturbance, "amplitude", 0.0),
    (SineDisturbance, "amplitude", 0.0),
    (SineDisturbance, "frequency", 0.0),
    (PulseDisturbance, "start", 0.0),
    (Actuator, "delay", 0.0),
    (Actuator, "lag", 0.0),
    (MinimumJerk, "hold_time", 0.0),
    (SineReference, "amplitude", 0.0),
    (FourierReference, "amplitude", 0.0),
    (ArmParameters, "gravity", 0.0),
    (ArmParameters, "inertia", 0.0),
    (Reward, "weight_tracking", 0.0),
    (Reward, "weight_effort", 0.0),
    (Reward, "weight_chatter", 0.0),
]
POSITIVE = [
    *[(ArmParameters, name) for name in ("m1", "m2", "L1", "L2", "centre")],
    (ParameterError, "ratio"),
    (Friction, "v_s"),
    (PiecewiseConstantDisturbance, "period"),
    (PulseDisturbance, "period"),
    (PulseDisturbance, "width"),
    (ArrayDisturbance, "dt"),
    (Actuator, "torque_limit"),
    (MinimumJerk, "move_time"),
    (Steps, "period"),
    (FilteredSteps, "period"),
    (FilteredSteps, "bandwidth"),
    (SineReference, "frequency"),
    (FourierReference, "frequency"),
    (FourierReference, "harmonics"),
    (ArrayReference, "dt"),
    *[(Limits, name) for name in ("position", "velocity", "acceleration", "command")],
    (Reward, "worst"),
    (Reward, "resolution"),
    *[(Scenario, name) for name in ("control_dt", "physics_dt", "duration")],
]


@pytest.mark.parametrize(("cls", "name", "least"), NOT_NEGATIVE, ids=[f"{c.__name__}.{n}" for c, n, _ in NOT_NEGATIVE])
def test_what_may_be_zero_may_not_be_negative(cls, name, least):
    assert cls(**{**NEEDED.get(cls, {}), name: least}) is not None
    with pytest.raises(ValueError, match=rf"{name}.* must be .*got -0\.25"):
        cls(**{**NEEDED.get(cls, {}), name: -0.25})


@pytest.mark.parametrize(("cls", "name"), POSITIVE, ids=[f"{c.__name__}.{n}" for c, n in POSITIVE])
def test_what_must_be_positive_may_not_be_zero(cls, name):
    for value in (0, -3):
        with pytest.raises(ValueError, match=rf"{name}.* must be .*got {value}"):
            cls(**{**NEEDED.get(cls, {}), name: value})


PER_JOINT = [
    *[(SensorError, name) for name in ("sigma", "bias", "quantization")],
    *[(Friction, name) for name in ("viscous", "coulomb", "stiction", "v_s")],
    (PiecewiseConstantDisturbance, "amplitude"),
    *[(SineDisturbance, name) for name in ("amplitude", "frequency", "phase")],
    (PulseDisturbance, "amplitude"),
    (Actuator, "torque_limit"),
    *[(cls, name) for cls in (MinimumJerk, Steps, FilteredSteps) for name in ("low", "high")],
    *[(SineReference, name) for name in ("centre", "amplitude", "phase")],
    *[(FourierReference, name) for name in ("centre", "amplitude")],
    (Scenario, "initial_error"),
]


@pytest.mark.parametrize(("cls", "name"), PER_JOINT, ids=[f"{c.__name__}.{n}" for c, n in PER_JOINT])
def test_a_pair_has_two_good_entries(cls, name):
    needed = NEEDED.get(cls, {})
    for value in ((), (1.0,), (1.0, 2.0, 3.0), [1.0] * 4, np.ones(3)):
        with pytest.raises(ValueError, match=f"{name} must be one number, or one for each of the two joints, got"):
            cls(**{**needed, name: value})
    for value in ((1.0, math.nan), (True, 1.0), ("a", 1.0), (1.0, (1.0, 2.0))):
        with pytest.raises(ValueError, match=rf"{name}\[[01]\] must be a finite number.*got"):
            cls(**{**needed, name: value})


@pytest.mark.parametrize(
    ("cls", "name"),
    [(ArrayDisturbance, "torque"), (ArrayReference, "position"), (ArrayReference, "velocity")]
    + [(ArrayReference, "acceleration"), (MinimumJerk, "points"), (Steps, "points"), (FilteredSteps, "points")],
)
def test_a_table_has_rows_of_two_finite_numbers(cls, name):
    needed = NEEDED.get(cls, {})
    for value in ([], 3.0, "ab", [1.0, 2.0], [[1.0, 2.0, 3.0]], [[1.0, 2.0], [3.0]], np.ones((2, 2, 2)), [["a", "b"]]):
        with pytest.raises(ValueError, match=rf"{name} must be an array of shape \[n x 2\]"):
            cls(**{**needed, name: value})
    with pytest.raises(ValueError, match=rf"{name} must be finite, got \[ *2. nan\] in row 1"):
        cls(**{**needed, name: [[0.0, 1.0], [2.0, math.nan]]})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Payload(1.0, pick_up=2.0, drop=2.0), "drop must be a finite number greater than 2, got 2.0"),
        (lambda: PulseDisturbance(1.0, period=0.5, width=0.6), r"width must be .* not above 0\.5, got 0\.6"),
        (lambda: SensorError(sigma=0.1, snr_db=3.0), r"give sigma or snr_db, not both; got sigma=.* and snr_db=3"),
        (
            lambda: Steps(low=1.0, high=(2.0, 0.0)),
            r"low must not exceed high, got low=\(1.0, 1.0\) and high=\(2.0, 0.0\)",
        ),
        (lambda: ArrayReference(ROWS, velocity=ROWS[:1]), "velocity must have the 2 rows of position, got 1"),
        (lambda: ArmParameters(centre=1.5), r"centre must be a fraction in \(0, 1\], got 1.5"),
        (lambda: ArmParameters(inertia=1.5), r"inertia must be a fraction in \[0, 1\], got 1.5"),
        (lambda: FourierReference(harmonics=2.0), "harmonics must be a whole number not below 1, got 2.0"),
        (lambda: ParameterError(ratio=(1.0, 2.0)), r"ratio must be one number, four .* got \(1.0, 2.0\)"),
        (lambda: ParameterError(ratio={"m2": 0.0}), "ratio of m2 must be a finite number greater than 0, got 0.0"),
        (lambda: ParameterError(ratio={"m2": "x"}), "ratio of m2 must be .* got 'x'"),
        (
            lambda: Reward(weight_tracking=0, weight_effort=0, weight_chatter=0),
            "at least one of weight_tracking, weight_effort, weight_chatter must be positive",
        ),
    ],
)
def test_fields_that_contradict_each_other_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Friction(law="exct"), "unknown law 'exct'; did you mean 'exact'"),
        (lambda: Reward(tracking="logg"), "unknown tracking 'logg'; did you mean 'log'"),
        (lambda: ParameterError(sampling="eech"), "unknown sampling 'eech'; did you mean 'each'"),
        (lambda: ParameterError(parameters=("m1", "L3")), "unknown parameter 'L3'; did you mean 'L"),
        (lambda: ParameterError(ratio={"mm1": 2.0}), "unknown parameter of ratio 'mm1'; did you mean 'm1'"),
        (lambda: Scenario(sensors=("position", "velocty")), "unknown sensor 'velocty'; did you mean 'velocity'"),
        (lambda: Scenario(arm="tabel-1"), "unknown arm 'tabel-1'; did you mean 'table-1'"),
        (
            lambda: Scenario(reference="minimum-jrk"),
            "unknown kind of reference 'minimum-jrk'; did you mean 'minimum-jerk'",
        ),
        (lambda: Scenario(disturbance={"kind": "pulse", "amplitude": 1.0}), "'pulse'; did you mean 'pulses'"),
        (lambda: Scenario(noise={"positon": 0.1}), "unknown field of noise 'positon'; did you mean 'position'"),
        (
            lambda: Scenario(noise={"position": {"sigm": 1}}),
            "noise: unknown field of position 'sigm'; did you mean 'sigma'",
        ),
        (lambda: Scenario(friction={"stikction": 1}), "unknown field of friction 'stikction'; did you mean 'stiction'"),
        (lambda: Scenario(actuator={"dealy": 1}), "unknown field of actuator 'dealy'; did you mean 'delay'"),
        (
            lambda: Scenario(reference={"kind": "sine", "freqency": 1}),
            "unknown field of reference 'freqency'.*'frequency'",
        ),
        (
            lambda: Scenario(parameter_error={"payload": {"mas": 1}}),
            "unknown field of payload 'mas'; did you mean 'mass'",
        ),
        (lambda: Scenario(limits={"postion": 1}), "unknown field of limits 'postion'; did you mean 'position'"),
        (lambda: TwoLinkArmEnv(reward={"wight_effort": 1}), "unknown field of reward 'wight_effort'.*'weight_effort'"),
        (lambda: TwoLinkArmEnv(contol_dt=0.01), "unknown option 'contol_dt'; did you mean 'control_dt'"),
        (lambda: TwoLinkArmVectorEnv(2, referense="sine"), "unknown option 'referense'; did you mean 'reference'"),
        (lambda: TwoLinkArmEnv("mixed-eror-2"), "unknown scenario 'mixed-eror-2'; did you mean 'mixed-error-2'"),
        (lambda: TwoLinkArmEnv(action="accelaration"), "unknown action 'accelaration'; did you mean 'acceleration'"),
        (lambda: TwoLinkArmEnv().layout["referense_position"], "did you mean 'reference_position'"),
    ],
)
def test_the_nearest_known_name_is_suggested(make, message):
    with pytest.raises(ValueError, match=message) as problem:
        make()
    assert "Known: " in str(problem.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Scenario(friction=3.0), "friction must be a Friction, a dict of its fields .viscous.*got 3.0"),
        (lambda: Scenario(noise=0.1), "noise must be a Noise, a dict of its fields .*got 0.1"),
        (
            lambda: Scenario(disturbance=5.0),
            "disturbance must be one of its records, or a dict with a 'kind' of .*got 5.0",
        ),
        (lambda: Scenario(disturbance={"amplitude": 5.0}), "disturbance must be .*a 'kind' of"),
        (lambda: Scenario(reference=None), "reference must be one of its records, .*got None"),
        (lambda: Scenario(limits=None), "limits must be a Limits, .*got None"),
        (lambda: Scenario(arm=3.0), "arm must be .*got 3.0"),
        (lambda: TwoLinkArmEnv(reward="l1"), "reward must be a Reward, a dict of its fields .*got 'l1'"),
        (lambda: TwoLinkArmEnv(scenario=3), "scenario must be a Scenario, .*got 3"),
        (lambda: Scenario(reference={"kind": "array"}), "reference must have the fields of ArrayReference"),
        (lambda: Scenario(parameter_error="2"), "parameter_error must be .*got '2'"),
        (lambda: ParameterError(payload="2"), "payload must be a Payload, .* or its mass, got '2'"),
    ],
)
def test_the_wrong_kind_of_thing_is_named_with_the_right_form(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: ParameterError(parameters=5),
        lambda: ParameterError(parameters=None),
        lambda: Scenario(sensors=5),
        lambda: Scenario(sensors=None),
        lambda: Scenario(disturbance={"kind": ["sine"]}),
        lambda: SensorError(sigma=np.array("x")),
    ],
    ids=["parameters=5", "parameters=None", "sensors=5", "sensors=None", "kind=[...]", "0-d array"],
)
def test_no_wrong_value_escapes_as_another_error(make):
    with pytest.raises(ValueError, match=r"must be|unknown"):
        make()


@pytest.mark.parametrize(
    ("options", "first", "second"),
    [
        ({"control_dt": 0.01, "physics_dt": 0.003}, "control_dt=0.01", "physics_dt=0.003"),
        ({"control_dt": 0.001, "physics_dt": 0.01}, "control_dt=0.001", "physics_dt=0.01"),
        ({"duration": 1.005}, "duration=1.005", "control_dt=0.01"),
        ({"actuator": {"delay": 0.0015}}, "delay=0.0015", "physics_dt=0.001"),
        ({"disturbance": PiecewiseConstantDisturbance(1.0, period=0.0125)}, "period=0.0125", "physics_dt=0.001"),
        ({"disturbance": PulseDisturbance(1.0, width=0.0125)}, "width=0.0125", "physics_dt=0.001"),
        ({"disturbance": PulseDisturbance(1.0, start=0.0125)}, "start=0.0125", "physics_dt=0.001"),
        ({"disturbance": PulseDisturbance(1.0, period=2.0005)}, "period=2.0005", "physics_dt=0.001"),
        ({"disturbance": ArrayDisturbance(ROWS, dt=0.0125)}, "dt=0.0125", "physics_dt=0.001"),
    ],
    ids=str,
)
def test_a_time_that_does_not_divide_names_both(options, first, second):
    with pytest.raises(ValueError, match=r"must (be a multiple of|divide)") as problem:
        Scenario(**options)
    for part in (first, second):
        name, value = part.split("=")
        assert name in str(problem.value)
        assert value in str(problem.value)


@pytest.mark.parametrize(
    ("control_dt", "physics_dt", "substeps"),
    [(0.01, 0.001, 10), (0.001, 0.001, 1), (0.3, 0.1, 3), (1 / 30, 1 / 300, 10), (0.02, 1e-4, 200), (0.7, 0.1, 7)],
)
def test_any_pair_of_rates_of_which_one_divides_the_other(control_dt, physics_dt, substeps):
    scenario = Scenario(control_dt=control_dt, physics_dt=physics_dt, duration=3 * control_dt)
    assert scenario.substeps == substeps
    env = TwoLinkArmEnv(scenario)
    env.reset(seed=0)
    assert [env.step((0.0, 0.0))[3] for _ in range(3)] == [False, False, True]
    assert env.truth.time == pytest.approx(3 * control_dt)


def test_after_an_error_the_next_environment_is_as_ever():
    before = TwoLinkArmEnv().reset(seed=0)[0]
    for bad in ({"noise": {"position": -1}}, {"control_dt": 0.0015}, {"reference": "sinus"}):
        with pytest.raises(ValueError, match=r"must be|unknown"):
            TwoLinkArmEnv(**bad)
    np.testing.assert_array_equal(TwoLinkArmEnv().reset(seed=0)[0], before)
