"""Bounds of the fields of records: a wrong value is an error with field, value and right form."""

import math

import numpy as np
import pytest

from fbl_gym import (
    Actuator,
    ArmParameters,
    ArrayDisturbance,
    ArrayReference,
    DriveChange,
    Drop,
    ElasticJoint,
    FilteredSteps,
    FourierReference,
    Friction,
    FrictionChange,
    Knock,
    Limits,
    MinimumJerk,
    ParameterError,
    Payload,
    PickUp,
    PiecewiseConstantDisturbance,
    PulseDisturbance,
    Reward,
    Scenario,
    SensorError,
    SineDisturbance,
    SineReference,
    Steps,
)

ROWS = ((0.0, 1.0), (2.0, 3.0))

NUMBERS = {
    ArmParameters: ("m1", "m2", "L1", "L2", "gravity", "centre", "inertia", "rotor"),
    Payload: ("mass", "pick_up", "drop"),
    ParameterError: ("ratio", "radius"),
    SensorError: ("sigma", "bias", "quantization", "snr_db"),
    Friction: ("viscous", "coulomb", "stiction", "v_s"),
    PiecewiseConstantDisturbance: ("amplitude", "period"),
    SineDisturbance: ("amplitude", "frequency", "phase"),
    PulseDisturbance: ("amplitude", "period", "width", "start"),
    ArrayDisturbance: ("dt",),
    ElasticJoint: ("stiffness", "damping", "rotor_inertia", "backlash"),
    PickUp: ("time", "mass"),
    Drop: ("time",),
    FrictionChange: ("time", "factor"),
    DriveChange: ("time", "factor"),
    Knock: ("time", "impulse"),
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
    ElasticJoint: {"stiffness": 100.0},
    PickUp: {"time": 1.0, "mass": 1.0},
    Drop: {"time": 1.0},
    FrictionChange: {"time": 1.0, "factor": 1.0},
    DriveChange: {"time": 1.0, "factor": 1.0},
    Knock: {"time": 1.0, "impulse": 1.0},
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
    *[(ArmParameters, name) for name in ("m1", "m2", "L1", "L2")],
    *[(ElasticJoint, name) for name in ("stiffness", "rotor_inertia")],
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
def test_a_field_from_zero_on_refuses_negative_values(cls, name, least):
    assert cls(**{**NEEDED.get(cls, {}), name: least}) is not None
    with pytest.raises(ValueError, match=rf"{name}.* must be .*got -0\.25"):
        cls(**{**NEEDED.get(cls, {}), name: -0.25})


@pytest.mark.parametrize(("cls", "name"), POSITIVE, ids=[f"{c.__name__}.{n}" for c, n in POSITIVE])
def test_a_positive_field_refuses_zero_and_negative_values(cls, name):
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
def test_a_pair_has_two_finite_numbers(cls, name):
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
        (lambda: ArmParameters(inertia=-1.5), "inertia must be a finite number not below 0, got -1.5"),
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
def test_a_time_that_is_no_multiple_of_its_step_names_both(options, first, second):
    with pytest.raises(ValueError, match=r"must (be a multiple of|divide)") as problem:
        Scenario(**options)
    for part in (first, second):
        name, value = part.split("=")
        assert name in str(problem.value)
        assert value in str(problem.value)
