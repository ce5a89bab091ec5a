"""Real parameters that differ from the nominal ones, and the payload.

The nominal model stays fixed and the real arm varies around it, as in the paper's Table 1. Every
parameter error is a ratio real / nominal.
"""

import itertools
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np

from fbl_gym.exact import log1p
from fbl_gym.model.arm import ArmParameters
from fbl_gym.records.checks import Pair, check_choice, check_number
from fbl_gym.records.record import Number, Numbers, Option, choice, choices, declared, ends, number, pair, record, steps

PARAMETERS = ("m1", "m2", "L1", "L2")

Ratios = tuple[float, float, float, float]


class Payload(Option):
    """A mass at the tip that the nominal model does not include.

    Args:
        mass: mass of the payload.
        pick_up: time at which the arm grasps it, to the nearest physics step. The grasp is
            inelastic, as that of `events.PickUp`.
        drop: time at which the arm releases it, later than `pick_up`; None: never.
        offset: from the tip to its centre, along the second link.
        radius: its radius of gyration about its centre; 0: a point.

    A mass of `events.PickUp` hangs at the tip, with neither.
    """

    mass: Number = number(unit="kg", varies=True, low=0, kernel="payload_mass")
    pick_up: Number = number(0.0, unit="s", varies=True, low=0, kernel="payload_pick_up", scale=steps)
    drop: Number | None = number(None, unit="s", varies=True, kernel="payload_drop", scale=steps, none=np.inf)
    offset: Number = number(0.0, unit="m", varies=True, kernel="payload_offset")
    radius: Number = number(0.0, unit="m", varies=True, low=0, kernel="payload_radius")

    derived: ClassVar = {"has_payload": bool}

    def validate(self) -> None:
        """Refuse a drop that does not come after the pick-up."""
        if self.drop is not None:
            check_number("drop", ends(self.drop)[0], above=ends(self.pick_up)[1])

    def pack(self, packer: Any) -> None:
        """Write that there is a payload."""
        packer.settings["has_payload"] = ends(self.mass)[1] > 0


def _ratios(name: str, value: object) -> tuple[float, ...]:
    """Return the ratios of m1, m2, L1 and L2, from one number, four numbers or a dict."""
    if isinstance(value, Mapping):
        for parameter in value:
            check_choice(f"parameter of {name}", parameter, PARAMETERS)
        value = [value.get(parameter, 1.0) for parameter in PARAMETERS]
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list | tuple):
        return (check_number(name, value, above=0),) * 4
    if len(value) != 4:
        raise ValueError(f"{name} must be one number, four (m1, m2, L1, L2) or a dict of them, got {value!r}")
    return tuple(check_number(f"{name} of {p}", x, above=0) for p, x in zip(PARAMETERS, value, strict=True))


def times(nominal: Any, ratio: Any, end: int) -> Any:
    """Return both joints' least (end 0) or largest (end 1) real numbers."""
    return tuple(number * ends(x)[end] for number, x in zip(nominal, ratio, strict=True))


def _fraction(nominal: Any, ratio: Any, unit: Pair, end: int) -> Any:
    """Return `times` as fractions of a unit real / nominal; without a ratio, the nominal ones."""
    return nominal if ratio is None else tuple(np.divide(times(nominal, ratio, end), unit).tolist())


class ParameterError(Option):
    """Real parameters that differ from the nominal ones.

    Args:
        ratio: real / nominal. A dict such as {"m2": 2.0} leaves the other parameters at 1; four
            numbers are in the order m1, m2, L1, L2.
        radius: r; each episode multiplies the ratio by a factor drawn log-uniformly from
            [1/(1+r), 1+r]. The paper's "100 %" is r = 1: from half to double.
        parameters: the parameters that the radius varies.
        sampling: "each" draws one factor per parameter, "together" one for all.
        payload: a mass carried at the tip.
        centre: real / nominal, of the distance from each joint to its link's centre of mass,
            whatever the length; None: the centre is at the same fraction of the real length.
        inertia: real / nominal, of each link's moment of inertia about its centre, whatever mass
            and length; None: it grows with the real mass and the square of the real length.
        rotor: real / nominal, of each rotor's inertia.
    """

    ratio: float | Ratios | Mapping[str, float] = declared(
        1.0, _ratios, "a number greater than 0, four of them or a dict by parameter", kernel="ratio", dtype=(float, 4)
    )
    radius: float = number(0.0, low=0)
    parameters: tuple[str, ...] = choices(PARAMETERS, PARAMETERS)
    sampling: Literal["each", "together"] = choice("each", ("each", "together"), kernel="drawn_together")
    payload: Payload | Mapping[str, Any] | float | None = record(Payload, None, scalar="mass")
    centre: Numbers | None = pair(None, varies=True, above=0, kernel="centre_ratio", none=(1.0, 1.0))
    inertia: Numbers | None = pair(None, varies=True, low=0, kernel="inertia_ratio", none=(1.0, 1.0))
    rotor: Numbers = pair(1.0, varies=True, above=0, kernel="rotor_ratio")

    derived: ClassVar = {"log_radius": (float, 4), "in_proportion": (int, 2)}

    def lightest(self, arm: ArmParameters) -> list[ArmParameters]:
        """Return the lightest real arms of a nominal one, with their least and largest lengths.

        Their links' centres are the nearest and the farthest ones.
        """
        m1, m2, L1, L2 = (getattr(arm, name) * ratio for name, ratio in zip(PARAMETERS, self.ratio, strict=True))  # type: ignore[arg-type]
        s1, s2, s3, s4 = (1.0 + self.radius if name in self.parameters else 1.0 for name in PARAMETERS)
        m1, m2, rotor = m1 / s1, m2 / s2, times(arm.rotor, self.rotor, 0)
        arms = []
        for x1, x2 in itertools.product({L1 / s3, L1 * s3}, {L2 / s4, L2 * s4}):
            longer = x1 / arm.L1, x2 / arm.L2
            larger = m1 / arm.m1 * longer[0] ** 2, m2 / arm.m2 * longer[1] ** 2
            inertia = _fraction(arm.inertia, self.inertia, larger, 0)
            centres = {_fraction(arm.centre, self.centre, longer, end) for end in (0, 1)}
            arms += [ArmParameters(m1, m2, x1, x2, arm.gravity, centre, inertia, rotor) for centre in centres]
        return arms

    def pack(self, packer: Any) -> None:
        """Write the radius, and where fractions of real lengths and masses count (None)."""
        radius = log1p(self.radius)
        packer.settings["log_radius"] = [radius if name in self.parameters else 0.0 for name in PARAMETERS]
        packer.settings["in_proportion"] = self.centre is None, self.inertia is None
