"""The datasheet: what policies are told of drive, sensors and springs, where that is not so."""

from typing import Any

from fbl_gym.options.sensors import SENSORS
from fbl_gym.records.record import Option, Pair, number, pair

_SPRINGS = ("stiffness", "damping", "rotor_inertia", "backlash")


class Datasheet(Option):
    """The statements that policies get in place of the truth, as fields of `Interface`.

    A field that is None is told as it is: with the range of a number that varies. The real arm
    does not depend on these fields, and oracles do not read them. The number of previous actions in
    an observation remains that of the real drive.

    Args:
        delay: from command to torque, with the delay of `actuator.delay_samples`.
        lag: time constant of the drive.
        rate_limit: largest change of the torque per time.
        latency: age of the readings of position and velocity.
        position_noise: standard deviation of the readings.
        velocity_noise: standard deviation of the readings.
        acceleration_noise: standard deviation of the readings.
        stiffness: of the springs between motors and links.
        damping: of these springs.
        rotor_inertia: inertia of each rotor, reflected to the joint.
        backlash: width of the gap in which motor and link do not touch.
    """

    delay: float | None = number(None, unit="s", low=0)
    lag: float | None = number(None, unit="s", low=0)
    rate_limit: Pair | float | None = pair(None, unit="N m/s", above=0)
    latency: float | None = number(None, unit="s", low=0)
    position_noise: Pair | float | None = pair(None, unit="rad", low=0)
    velocity_noise: Pair | float | None = pair(None, unit="rad/s", low=0)
    acceleration_noise: Pair | float | None = pair(None, unit="rad/s^2", low=0)
    stiffness: Pair | float | None = pair(None, unit="N m/rad", above=0)
    damping: Pair | float | None = pair(None, unit="N m s/rad", low=0)
    rotor_inertia: Pair | float | None = pair(None, unit="kg m^2", above=0)
    backlash: Pair | float | None = pair(None, unit="rad", low=0)

    def check(self, scenario: Any) -> None:
        """Refuse springs of rigid joints, and the noise of a sensor that a scenario leaves out."""
        for name in _SPRINGS if scenario.joint is None else ():
            if getattr(self, name) is not None:
                raise ValueError(f"datasheet.{name} is of elastic joints, but the scenario has no joint")
        for sensor in SENSORS:
            if getattr(self, f"{sensor}_noise") is not None and sensor not in scenario.sensors:
                raise ValueError(f"datasheet.{sensor}_noise is given, but sensors={scenario.sensors} has no {sensor}")

    def stated(self, truth: dict[str, Any]) -> dict[str, Any]:
        """Return the fields of `Interface` that state the truth, with those that are given here."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        noise = zip(SENSORS, truth.get("noise_std", ((0.0, 0.0),) * 3), strict=True)
        noise_std = tuple(given.pop(f"{sensor}_noise", std) for sensor, std in noise)
        ranges = {name: (given[name],) * 2 for name in given.keys() & {"delay", "lag", "stiffness", "damping"}}
        return {**truth, "noise_std": noise_std, **given, **ranges}
