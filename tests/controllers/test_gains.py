"""Gains are declared once: bounds, units, tuning ranges."""

import inspect
import math
from dataclasses import dataclass

import numpy as np
import pytest

import controllers
from controllers.simple import PdGravity
from fbl_gym import TwoLinkArmEnv
from fbl_gym.records import declarations, number, tuning_ranges
from fbl_gym.scenarios.classes import CLASSES
from tests.fbl_gym.declared import fields

LAWS = [name for name in controllers.names() if controllers.kind(name) == "classical"]


@pytest.mark.parametrize("name", LAWS)
def test_the_unit_of_a_gain_is_in_the_docstring(name):
    law = controllers.factory(name)
    text = "".join(inspect.getdoc(base) or "" for base in law.__mro__)
    for gain, declaration in declarations(law).items():
        assert declaration.unit == "" or f"[{declaration.unit}]" in text, gain


@pytest.mark.parametrize("name", [name for robot in CLASSES for name in controllers.tuned(robot)])
def test_tuned_gains_are_in_the_tuning_range(name):
    ranges = tuning_ranges(controllers.factory(name))
    assert ranges
    for gain, value in controllers.registry.tuned_gains(name).items():
        low, high = ranges[gain]
        assert (low <= np.array(value)).all()
        assert (np.array(value) <= high).all()


def test_a_plain_default_in_a_subclass_keeps_the_declaration():
    @dataclass(frozen=True)
    class Faster(PdGravity):
        frequency: float = 20.0

    assert tuning_ranges(Faster) == tuning_ranges(PdGravity)
    assert Faster(TwoLinkArmEnv().interface).frequency == (20.0, 20.0)


def test_a_declaration_in_a_subclass_replaces_that_of_its_parent():
    @dataclass(frozen=True)
    class Undamped(PdGravity):
        damping: float = number(0.5, low=0, high=1)

    assert list(tuning_ranges(Undamped)) == ["frequency"]
    with pytest.raises(ValueError, match="damping must be a finite number not below 0 and not above 1"):
        Undamped(TwoLinkArmEnv().interface, damping=2.0)


@pytest.mark.parametrize("name", LAWS)
def test_a_gain_out_of_bounds_is_named(name):
    env, law = TwoLinkArmEnv(), controllers.factory(name)
    for gain in (gain for gain in fields(law) if gain.owner is law):
        right = "whole number" if gain.is_whole else "finite number"
        for word, bound in gain.bounds if gain.is_number else ():
            for value in [round(bound) - 1, *([round(bound)] if word == "greater than" else []), math.nan, "1"]:
                with pytest.raises(
                    ValueError, match=rf"{gain.name} must be a {right} {word} {bound:g}.*, got {value!r}"
                ):
                    controllers.make(name, env, **{gain.name: value})
