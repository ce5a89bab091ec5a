"""Disturbances: one record for each kind of torque tau_d of equation (1)."""

from typing import Any, ClassVar, TypeAlias

import numpy as np

from fbl_gym.records.checks import Pair, check_number
from fbl_gym.records.record import Numbers, Option, ends, number, pair, table

#: Fields that are counted in physics steps, with the fewest.
TIMES = {"period": 1, "width": 1, "start": 0, "dt": 1}


class _Timed(Option):
    """Base of the disturbances."""

    derived: ClassVar = {
        "disturbance_kind": int, "disturbance_phase_drawn": bool, "torque_varies": bool,
        "disturbance_period": float, "disturbance_width": float, "disturbance_start": float,  # [physics steps]
        "disturbance_table": int, "disturbance_samples": int,
    }  # fmt: skip

    def check(self, scenario: Any) -> None:
        """Refuse times that are no multiples of a physics step."""
        for name, least in TIMES.items():
            if hasattr(self, name):
                scenario.check_multiple(f"disturbance.{name}", getattr(self, name), "physics_dt", least)

    def pack(self, packer: Any) -> None:
        """Write kind and times."""
        settings, scenario = packer.settings, packer.scenario
        settings["disturbance_kind"] = 1 + DISTURBANCES.index(type(self))
        for name in TIMES.keys() & vars(self).keys():
            steps = round(vars(self)[name] / scenario.physics_dt)
            settings["disturbance_period" if name == "dt" else f"disturbance_{name}"] = steps
            settings["torque_varies"] |= steps % scenario.substeps > 0


class PiecewiseConstantDisturbance(_Timed, kind="piecewise-constant"):
    """A torque that jumps to a new level at regular times (§3.2 of the paper).

    Args:
        amplitude: bound of the levels, drawn uniformly from [-amplitude, amplitude].
        period: time between two jumps, a multiple of physics_dt.
    """

    amplitude: Numbers = pair(unit="N m", varies=True, low=0, kernel="disturbance_amplitude")
    period: float = number(0.5, unit="s", above=0)


class SineDisturbance(_Timed, kind="sine"):
    """A torque amplitude * sin(2 pi frequency t + phase).

    Args:
        amplitude: amplitude of the torque.
        frequency: frequency of the torque, at most a quarter of 1 / physics_dt.
        phase: phase of the torque; None: drawn per episode.
    """

    amplitude: Numbers = pair(unit="N m", varies=True, low=0, kernel="disturbance_amplitude")
    frequency: Numbers = pair(1.0, unit="Hz", varies=True, low=0, high=1e6, kernel="disturbance_rate", scale=2 * np.pi)
    phase: Pair | float | None = pair(None, unit="rad", low=-1e6, high=1e6, kernel="disturbance_phase")

    def check(self, scenario: Any) -> None:
        """Refuse a frequency that the physics step does not resolve."""
        fastest, limit = ends(self.frequency)[1], 0.25 / scenario.physics_dt
        if fastest > limit * (1 + 1e-9):
            raise ValueError(
                f"disturbance.frequency must be at most {limit:g} Hz, a quarter of 1 / physics_dt, got {fastest:g} Hz"
            )

    def pack(self, packer: Any) -> None:
        """Write that the torque varies, perhaps with a drawn phase."""
        super().pack(packer)
        packer.settings["disturbance_phase_drawn"], packer.settings["torque_varies"] = self.phase is None, True


class PulseDisturbance(_Timed, kind="pulses"):
    """A torque in pulses. Times are multiples of physics_dt.

    Args:
        amplitude: torque during a pulse, of either sign.
        period: time from one pulse to the next.
        width: duration of a pulse, at most `period`.
        start: time of the first pulse.
    """

    amplitude: Numbers = pair(unit="N m", varies=True, kernel="disturbance_amplitude")
    period: float = number(2.0, unit="s", above=0)
    width: float = number(0.1, unit="s", above=0)
    start: float = number(0.0, unit="s", low=0)

    def validate(self) -> None:
        """Refuse a pulse longer than the period."""
        check_number("width", self.width, above=0, high=self.period)


class ArrayDisturbance(_Timed, kind="array"):
    """A torque given by samples, each held until the next; the last one holds on.

    Args:
        torque: samples of the torque.
        dt: time between two samples, a multiple of physics_dt.
    """

    torque: tuple[Pair, ...] = table(unit="N m")
    dt: float = number(0.01, unit="s", above=0)

    def pack(self, packer: Any) -> None:
        """Write the samples."""
        super().pack(packer)
        packer.settings["disturbance_samples"] = len(self.torque)
        packer.settings["disturbance_table"] = packer.table(np.ravel(self.torque))


Disturbance: TypeAlias = PiecewiseConstantDisturbance | SineDisturbance | PulseDisturbance | ArrayDisturbance
#: The kinds of disturbances, in the order of their numbers in the kernel, from 1.
DISTURBANCES = (PiecewiseConstantDisturbance, SineDisturbance, PulseDisturbance, ArrayDisturbance)
