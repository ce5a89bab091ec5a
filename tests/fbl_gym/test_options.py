"""Every option, from its declaration: it survives JSON, reaches the program, may vary as declared, and has clear errors.

`docs/reference/options.md` states every declaration a second time; `tests/benchmarks/test_list.py` compares them.
"""

import contextlib
import dataclasses
import functools
import json
import math
import re
from collections import defaultdict

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from fbl_gym import Scenario, TwoLinkArmEnv
from fbl_gym.kernel.maths.streams import stream_key
from fbl_gym.kernel.memory import layout as memory
from fbl_gym.kernel.memory.layout import EVENT_ROWS, FIRST_VARIED, LANES, VARIED
from fbl_gym.records.descriptions import describe
from fbl_gym.records.record import merged
from tests.fbl_gym.declared import FIELDS, LEAVES, NUMBERS, VARYING
from tests.fbl_gym.episodes import ID, started_batch


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
    if field.path.startswith("plant"):
        pytest.importorskip("mujoco")
    env = gym.make(ID, **field.given(field.values[0])).unwrapped
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
