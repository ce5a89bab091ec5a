"""Declarations: one line per field gives checks, conversion, tuning range and documentation."""

from dataclasses import dataclass

import pytest

from fbl_gym.checks import Pair
from fbl_gym.descriptions import describe
from fbl_gym.records import Record, choice, choices, number, pair, record, tuning_ranges, whole


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
