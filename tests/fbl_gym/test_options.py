"""Options as records: made from plain data, through JSON into the program, some of them drawn; and all their errors.

Most tests run over every option, from its declaration. `docs/reference/options.md` states every declaration a second
time; `tests/benchmarks/test_cli.py` compares them.
"""

import contextlib
import dataclasses
import functools
import json
import math
import re
import tomllib
from collections import defaultdict
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from controllers.laws.simple import PdGravity
from fbl_gym import SECTION_2_2, Friction, ParameterError, Scenario, SensorError, TwoLinkArmEnv, options
from fbl_gym.kernel.maths.streams import stream_key
from fbl_gym.kernel.memory import layout as memory
from fbl_gym.kernel.memory.layout import EVENT_ROWS, FIRST_VARIED, LANES, VARIED
from fbl_gym.records.descriptions import describe
from fbl_gym.records.record import merged
from tests.fbl_gym.declared import FIELDS, LEAVES, NUMBERS, TABLE, VARYING
from tests.fbl_gym.episodes import ID, started, started_batch


def each(fields):
    return pytest.mark.parametrize("field", fields, ids=lambda field: field.path)


def wrong(options, message):
    """Check that options are an error of a message, and return all of it."""
    with pytest.raises(ValueError, match=message) as problem:
        TwoLinkArmEnv(**options)
    return str(problem.value)


def refused(field, value, *right):
    """Check that a value of a field is an error with the field, the value and what is right."""
    text = wrong(field.given(value), rf"(?s){field.error}\b.* must be ")
    assert all(part in text for part in (repr(value), *right)), text


def bounds_of(field):
    """Return the bounds of a field as they stand in its errors."""
    return [f"{word} {bound:g}" for word, bound in field.bounds]


def is_fixed(value):
    """Return True if a value is immutable and plain, all through."""
    if dataclasses.is_dataclass(value):
        value = tuple(getattr(value, field.name) for field in dataclasses.fields(value))
    return all(map(is_fixed, value)) if isinstance(value, tuple) else isinstance(value, int | float | str | None)


@each(LEAVES)
def test_an_option_survives_json_and_a_spec(field):
    """Pairs and tables are arrays here; `test_fuzz.py` has plain data."""
    if field.path.startswith("plant"):
        pytest.importorskip("mujoco")
    value = field.values[0]
    env = gym.make(ID, **field.given(np.array(value) if field.is_pair or field.is_table else value)).unwrapped
    assert (env.scenario, env._reward) != ((base := TwoLinkArmEnv(**field.options())).scenario, base._reward)
    assert Scenario.from_dict(json.loads(json.dumps(env.scenario.to_dict()))) == env.scenario
    again = gym.make(EnvSpec.from_json(env.spec.to_json())).unwrapped
    assert (again.scenario, again.interface, again._reward) == (env.scenario, env.interface, env._reward)
    assert is_fixed(env.scenario)
    assert hash(dataclasses.replace(env.scenario)) == hash(env.scenario)


def packed(options):
    """Return the program of an environment as bytes."""
    batch = TwoLinkArmEnv(**options)._batch
    return batch.settings.tobytes() + batch._memory[batch._parts["tables"]].tobytes()


@each([field for field in LEAVES if not field.path.startswith(("plant", "datasheet"))])
def test_an_option_reaches_the_program(field):
    assert packed(field.given(field.values[0])) != packed(field.options())


def test_a_number_of_the_kernel_has_one_option():
    """Kinds of one field take turns, and so do the two fields of a spring."""
    streams = defaultdict(set)
    for field in LEAVES:
        streams[field.declaration.kernel].add(field.stream)
    assert {name for name, paths in streams.items() if len(paths) > 1} == {"", "stiffness"}


WRONG = (math.nan, math.inf, -math.inf, True, np.bool_(False), "1.0", b"1", 1j, {1.0}, object, object())


@each(NUMBERS)
def test_a_number_must_be_finite_and_within_its_bounds(field):
    right = "a whole number" if field.is_whole else "a finite number"
    for value in (*WRONG, *([1.5] if field.is_whole else [10**400]), *([] if field.declaration.optional else [None])):
        refused(field, value, right, *bounds_of(field))
    for bound in field.highest:
        refused(field, round(bound) + 1 if field.is_whole else 1.5 * bound, right, f"not above {bound:g}")
    for word, bound in field.bounds:
        least = round(bound) if field.is_whole else bound
        refused(field, least - 1, right, *bounds_of(field))
        if word == "greater than":
            refused(field, least, right, *bounds_of(field))
        else:
            TwoLinkArmEnv(**field.given(least))


@each([field for field in NUMBERS if field.is_pair])
def test_a_pair_has_two_finite_numbers(field):
    for value in ((), (1.0,), (1.0, 2.0, 3.0), [1.0] * 4, np.ones(3)):
        wrong(field.given(value), f"{field.error} must be one number, or one for each of the two joints, got")
    good = field.values[0][1]
    for joint, value in ((1, (good, math.nan)), (0, (True, good)), (0, ("a", good)), (1, (good, (1.0, 2.0)))):
        wrong(field.given(value), rf"{field.error}\[{joint}\] must be a finite number.*got")
    alone = [TwoLinkArmEnv(**field.given(value)).scenario for value in (good, (good, good), np.full(2, good))]
    assert alone[0] == alone[1] == alone[2]


@each([field for field in LEAVES if field.is_table])
def test_a_table_has_rows_of_two_finite_numbers(field):
    for value in ([], 3.0, "ab", [1.0, 2.0], [[1.0, 2.0, 3.0]], [[1.0, 2.0], [3.0]], np.ones((2, 2, 2)), [["a", "b"]]):
        wrong(field.given(value), rf"{field.error} must be an array of shape \[n x 2\]")
    wrong(field.given([[0.0, 1.0], [2.0, math.nan]]), rf"{field.error} must be finite, got \[ *2. nan\] in row 1")
    table = field.values[0]
    assert TwoLinkArmEnv(**field.given(np.array(table))).scenario == TwoLinkArmEnv(**field.given(table)).scenario


@each([field for field in LEAVES if field.names or field.form.startswith("some of ")])
def test_a_choice_is_one_of_its_names(field):
    name, word = np.atleast_1d(field.values[0])[-1], field.name.removesuffix("s")
    for value in (5, object(), None):
        assert repr(value) in wrong(field.given(value), word)
    wrong(field.given([["a"]]), word)
    if isinstance(name, str):
        wrong(field.given(f"{name}x"), f"unknown .*{word} '{name}x'; did you mean '{name}'")


@each([field for field in FIELDS if field.is_record])
def test_a_record_is_built_from_its_fields_alone(field):
    refused(field, object())
    if "None" not in field.form and not field.declaration.optional and field.path != "events":
        refused(field, None)
    for inner in FIELDS:
        if not inner.path.startswith(field.path) or inner.owner not in field.declaration.classes:
            continue
        name = inner.name
        wrong(inner.options(**{f"{name}x": 1.0}), f"unknown field of .* '{name}x'; did you mean '{name}'")
        if inner.default is dataclasses.MISSING:
            kind = {"kind": inner.base["kind"]} if "kind" in inner.base else {}
            wrong(inner.wrap(kind), f"{re.escape(field.name)}.* must give .*{name}")


@each(FIELDS)
def test_an_option_is_described_and_frozen(field):
    (text,) = [text for text in describe(field.owner) if text.path == field.name]
    assert text.meaning
    assert text.form.startswith(field.form)
    record = object.__new__(field.owner)
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(record, field.name, 1.0)


# Numbers that vary.


def drawn(options, lanes=64):
    """Return the numbers of many arms that may vary, [numbers x lanes], and the number and stream of each draw."""
    env = started_batch(lanes, **options, seed=3)
    batch, program = env._batch, env._batch.settings
    blocks = batch._memory[batch._parts["blocks"]].reshape(-(-lanes // LANES), -1, LANES)
    first, count = int(program["event_row"]), EVENT_ROWS * int(program["events"])
    rows = [*range(FIRST_VARIED, FIRST_VARIED + VARIED.itemsize // 8), *range(first, first + count)]
    draws = batch._memory[batch._parts["tables"]][int(program["draw_table"]) :].reshape(-1, 7)
    streams = [(rows.index(row), int(high) << 32 | int(low)) for row, *_, high, low in draws]
    numbers = blocks[:, rows].swapaxes(0, 1).reshape(len(rows), -1)
    delay, samples = (memory.rows(name)[0] - FIRST_VARIED for name in ("delay", "delay_samples"))
    numbers[delay] -= numbers[samples] * program["substeps"]  # the row of the delay has both
    return numbers, streams


def choice(field):
    """Return the choice between the two values of a field, for each joint."""
    if not field.is_pair:
        return {"choice": list(field.values)}
    return tuple({"choice": both} for both in zip(*field.values, strict=True))


@functools.cache
def crowd():
    """Return options in which as many numbers as possible vary."""
    options = {}
    for field in VARYING:
        with contextlib.suppress(ValueError):  # such as a second kind of disturbance
            Scenario(**(more := merged(options, field.given(choice(field)))))
            options = more
    return options


def among_many(options):
    """Return the options and all others that vary beside them."""
    try:
        Scenario(**merged(crowd(), options))
    except ValueError:
        return {**crowd(), **options}
    return merged(crowd(), options)


@each(VARYING)
def test_a_number_that_varies_is_drawn_from_the_stream_of_its_own_name(field):
    """An arm that draws a value is the arm with that value, and draws the same whatever else varies."""
    first, second = (drawn(field.given(value))[0] for value in field.values)
    ours, draws = drawn(field.given(choice(field)))
    own = [number for number, stream in draws if stream == stream_key(field.stream)]
    assert own == np.flatnonzero((first != second).any(axis=1)).tolist()
    assert len(own) == (2 if field.is_pair else 1)
    assert np.all((ours == first) | (ours == second))
    assert np.all(np.abs(np.mean(ours[own] == first[own], axis=1) - 0.5) < 0.3)
    many, draws = drawn(among_many(field.given(choice(field))))
    assert len(draws) > 20
    np.testing.assert_array_equal(many[own], ours[own])


@each([field for field in NUMBERS if not field.varies])
def test_a_number_that_may_not_vary_says_so(field):
    refused(field, {"uniform": [1, 2]}, "a whole number" if field.is_whole else "a finite number")


@each(VARYING)
def test_a_distribution_is_within_the_bounds_of_its_number(field):
    for word, bound in field.bounds:
        message = rf"{field.error}.*, a distribution, must be .* {word} {bound:g}\b.*, got -1"
        wrong(field.given({"uniform": [-1, 1]}), message)
    for bound in field.highest:
        message = rf"{field.error}.*, a distribution, .* {re.escape(f'{bound:g}')}\b.*, got"
        wrong(field.given({"uniform": [bound, 2 * bound]}), message)
    wrong(field.given({"choice": [1, math.nan]}), rf"{field.error}.*: choice\[1\] must be a finite number, got nan")


# Errors of options that contradict each other, are too large or have a wrong name.


ERRORS = tomllib.loads(Path(__file__).with_name("option_errors.toml").read_text(encoding="utf-8"))
BEYOND_TOML = "needs a torque limit", {"actuator": None}


@pytest.mark.filterwarnings("ignore::fbl_gym.scenarios.files.UnitsWarning")
@pytest.mark.parametrize(("message", "options"), [*ERRORS["wrong"], BEYOND_TOML], ids=str)
def test_wrong_options_are_named(message, options):
    """By one that was given, though another one, which follows from it or comes from the base, is wrong by it."""
    with pytest.raises(ValueError, match=message):
        TwoLinkArmEnv(**options)


@pytest.mark.parametrize(("cause", "speed", "options"), ERRORS["too_long"], ids=str)
def test_a_step_too_long_is_refused_with_one_that_does(cause, speed, options):
    """It divides all other times too, and the speeds of an arm that starts with 10 rad/s stay below `speed`."""
    with pytest.raises(ValueError, match=rf"physics_dt=\S+ s is too long for {cause}") as error:
        TwoLinkArmEnv(**options)
    step = float(re.search(r"physics_dt=([0-9.e-]+) s would do", str(error.value)).group(1))
    env = started(**options | {"physics_dt": step, "initial_velocity": 10.0})
    assert not env.step((0.0, 0.0))[2]
    assert np.abs(env.truth.velocity).max() < speed


@pytest.mark.parametrize("name", ["friction", "action", "reward", "scenario"])
def test_an_unknown_option_is_a_type_error_in_pythons_words(name):
    """TorchRL tries `frameskip` on every environment, and goes on after this error alone."""
    with pytest.raises(TypeError, match=rf"unexpected keyword argument '{name}x'; did you mean '{name}'\?"):
        gym.make(ID, **{f"{name}x": 100})


def test_an_unknown_slot_or_field_is_named():
    with pytest.raises(ValueError, match=r"did you mean 'reference_position'.* Known: "):
        TwoLinkArmEnv().layout["referense_position"]
    with pytest.raises(ValueError, match="unknown option 'rate'"):
        TwoLinkArmEnv().scenario.replace(rate=3)


def test_a_payload_that_is_never_picked_up_is_no_error():
    env = started(parameter_error={"payload": {"mass": 1.0, "pick_up": 1.7e308}})
    env.step(np.zeros(2))
    assert env.truth.payload == 0.0


# Records from plain data.


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
