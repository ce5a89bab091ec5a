"""Gains are declared once: bounds, units, tuning ranges."""

import inspect
from dataclasses import dataclass

import pytest

import controllers
from controllers.simple import PdGravity
from fbl_gym import TwoLinkArmEnv
from fbl_gym.records import declarations, number, tuning_ranges

LAWS = [name for name in controllers.names() if controllers.kind(name) == "classical"]


@pytest.mark.parametrize("name", LAWS)
def test_the_unit_of_a_gain_is_in_the_docstring(name):
    law = controllers.factory(name)
    text = "".join(inspect.getdoc(base) or "" for base in law.__mro__)
    for gain, declaration in declarations(law).items():
        assert declaration.unit == "" or f"[{declaration.unit}]" in text, gain


@pytest.mark.parametrize("name", [name.removesuffix("@tuned") for name in controllers.tuned()])
def test_tuned_gains_are_in_the_tuning_range(name):
    ranges = tuning_ranges(controllers.factory(name))
    assert ranges
    for gain, value in controllers.registry.tuned_gains(f"{name}@tuned").items():
        low, high = ranges[gain]
        assert low <= value <= high


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


@pytest.mark.parametrize(
    ("name", "gain", "value", "message"),
    [
        ("adaptive-flm", "alpha", 3.0, "alpha must be four numbers"),
        ("adaptive-flm", "alpha", ((1, 2), (3, -4)), "alpha must be four numbers"),
        ("adaptive-flm", "v_s", 0.0, "v_s must be"),
        ("adaptive-flm", "total_mass", -1.0, "total_mass must be"),
        ("adaptive-flm", "weakest", 0.0, "weakest must be"),
        *(
            ("adaptive-flm-ls", gain, 0.0, f"{gain} must be")
            for gain in ("memory", "bandwidth", "prior", "excitation", "moving", "turn")
        ),
        ("computed-torque", "frequency", -1, "frequency must be"),
        ("computed-torque-dob", "bandwidth", 0, "bandwidth must be"),
        ("slotine-li", "reach", 1.0, "reach must be"),
        ("slotine-li", "damping", -1.0, "damping must be"),
        ("slotine-li", "friction", -1.0, "friction must be"),
        ("slotine-li-composite", "composite", -1.0, "composite must be"),
        ("spong-robust", "epsilon", 0.0, "epsilon must be"),
        ("spong-robust", "slope", 0.0, "slope must be"),
        ("sliding-mode", "slope", 0.0, "slope must be"),
        ("sliding-mode", "bound", -1.0, "bound must be"),
        ("sliding-mode", "layer", -0.1, "layer must be"),
        ("pid-gravity", "integral", -1, "integral must be"),
    ],
)
def test_a_gain_out_of_bounds_is_named(name, gain, value, message):
    with pytest.raises(ValueError, match=message):
        controllers.make(name, TwoLinkArmEnv(), **{gain: value})
