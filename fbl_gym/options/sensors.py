"""Errors of the sensors, and the encoders."""

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from fbl_gym.exact import exp
from fbl_gym.records.record import Number, Numbers, Option, Pair, ends, number, pair, record, scaled, whole

SENSORS = ("position", "velocity", "acceleration")


class SensorError(Option):
    """The error of one sensor: a bias, then white noise, then rounding, in the sensor's unit.

    Args:
        sigma: standard deviation of each sample's noise.
        density: one-sided spectral density of the noise in the sensor's unit / sqrt(Hz), in place
            of `sigma`: sigma = density / sqrt(2 control_dt), so that a faster rate is no better
            sensor.
        bias: constant offset.
        quantization: step to whose multiples the reading is rounded; 0: no rounding.
        snr_db: signal-to-noise ratio, against a signal of unit power, in place of `sigma`, as in
            §3.2 of the paper: sigma = 10^(-snr_db / 20).
    """

    sigma: Numbers = pair(0.0, varies=True, low=0)
    density: Numbers = pair(0.0, varies=True, low=0)
    bias: Numbers = pair(0.0, varies=True)
    quantization: Pair | float = pair(0.0, low=0)
    snr_db: float | None = number(None, unit="dB", low=-6000)

    def validate(self) -> None:
        """Refuse two sizes of the noise."""
        sizes = {name: getattr(self, name) for name in ("sigma", "density", "snr_db")}
        if len(given := {name: size for name, size in sizes.items() if size not in (None, (0.0, 0.0))}) > 1:
            raise ValueError(f"give one of {', '.join(sizes)}, got {given}")

    def std_at(self, control_dt: float) -> Any:
        """Return the standard deviation of each joint's noise."""
        if self.snr_db is not None:
            return (10.0 ** (-self.snr_db / 20.0),) * 2
        if self.density != (0.0, 0.0):
            return scaled(self.density, 1 / math.sqrt(2 * control_dt))
        return self.sigma


class Noise(Option):
    """The errors of the sensors. A sensor without an error is perfect.

    Args:
        position: error of the joint angles [rad].
        velocity: error of the joint velocities [rad/s].
        acceleration: error of the joint accelerations [rad/s^2].
    """

    position: SensorError | Mapping[str, Any] | Pair | float | None = record(SensorError, None, scalar="sigma")
    velocity: SensorError | Mapping[str, Any] | Pair | float | None = record(SensorError, None, scalar="sigma")
    acceleration: SensorError | Mapping[str, Any] | Pair | float | None = record(SensorError, None, scalar="sigma")

    derived: ClassVar = {"noisy": bool, "has_noise": (int, 3), "quantization": (float, (3, 2))}
    drawn: ClassVar = {"noise_std": (float, (3, 2)), "noise_bias": (float, (3, 2))}

    @property
    def errors(self) -> dict[str, SensorError]:
        """Return the error of each sensor that has one, by name."""
        return {name: error for name in SENSORS if (error := getattr(self, name)) is not None}

    def check(self, scenario: Any) -> None:
        """Refuse the noise of a sensor that a scenario leaves out."""
        for sensor in self.errors:
            if sensor not in scenario.sensors:
                raise ValueError(f"noise.{sensor} is given, but sensors={scenario.sensors} has no {sensor} sensor")

    def pack(self, packer: Any) -> None:
        """Write the errors of all sensors."""
        settings = packer.settings
        for name, error in self.errors.items():
            sensor, size = SENSORS.index(name), "sigma" if error.density == (0.0, 0.0) else "density"
            std = error.std_at(packer.scenario.control_dt)
            packer.vary("noise_bias", error.bias, f"noise.{name}.bias", first=2 * sensor)
            packer.vary("noise_std", std, f"noise.{name}.{size}", first=2 * sensor)
            settings["quantization"][sensor] += error.quantization
            settings["has_noise"][sensor] = ends(std) != (0.0, 0.0)
            settings["noisy"] |= any(ends(x) != (0.0, 0.0) for x in (std, error.bias, error.quantization))

    def facts(self, scenario: Any) -> dict[str, Any]:
        """Return what policies know of the noise, as fields of `Interface`."""
        errors = [self.errors.get(name, SensorError()) for name in SENSORS]
        return {
            "noise_std": tuple(tuple(ends(std)[1] for std in error.std_at(scenario.control_dt)) for error in errors)
        }


class Encoder(Option):
    """The encoders of both joints, and the velocity that a drive computes from them.

    The velocity is the difference of two position readings, divided by the time between them, then
    filtered: y += (1 - exp(-2 pi low_pass control_dt)) (x - y).

    Args:
        counts: position readings per turn of the joint; None: no rounding.
        difference: control samples between the two readings; None: the velocity is measured.
        low_pass: cut-off frequency of the filter; None: no filter.
        latency: age of the readings of position and velocity, in control samples.
        dropout: chance, at each control sample, that readings begin to be lost; the last one is
            shown in their place.
        dropout_length: control samples whose readings are lost together.
    """

    counts: Pair | float | None = pair(None, low=1e-3)
    difference: int | None = whole(None, low=1, high=10_000, kernel="difference")
    low_pass: float | None = number(None, unit="Hz", above=0)
    latency: int = whole(0, high=10_000, kernel="latency")
    dropout: Number = number(0.0, varies=True, low=0, high=1, kernel="dropout")
    dropout_length: int = whole(1, low=1, high=10_000)

    derived: ClassVar = {"noisy": bool, "history": int, "low_pass": float, "dropout_length": int}

    def validate(self) -> None:
        """Refuse a filter of a measured velocity."""
        if self.low_pass is not None and self.difference is None:
            raise ValueError(f"low_pass filters a computed velocity: give difference too, got low_pass={self.low_pass}")

    def check(self, scenario: Any) -> None:
        """Refuse a velocity that is not read or measured too, and two kinds of rounding."""
        errors = {} if scenario.noise is None else scenario.noise.errors
        if self.difference is not None and "velocity" not in scenario.sensors:
            raise ValueError(f"encoder.difference computes a velocity, but sensors={scenario.sensors} has none")
        if self.difference is not None and "velocity" in errors:
            raise ValueError(
                "noise.velocity is of a measured velocity, but encoder.difference computes it from the position"
            )
        if self.counts is not None and "position" in errors and errors["position"].quantization != (0.0, 0.0):
            raise ValueError(f"give encoder.counts or noise.position.quantization, not both; got counts={self.counts}")

    def facts(self, scenario: Any) -> dict[str, Any]:
        """Return what policies know of the encoders, as fields of `Interface`."""
        return {"latency": self.latency * scenario.control_dt}

    def pack(self, packer: Any) -> None:
        """Write counts, stored readings, length of a loss, and the filter's share of a reading."""
        settings = packer.settings
        if self.counts is not None:
            settings["quantization"][0] += 2 * np.pi / np.array(self.counts)
            settings["noisy"] = True
        if self.latency or self.difference:
            settings["history"] = 1 + max(self.latency, self.difference or 1)
        if ends(self.dropout)[1] > 0.0:
            settings["dropout_length"] = self.dropout_length
        settings["low_pass"] = 1.0
        if self.low_pass is not None:
            settings["low_pass"] = 1.0 - exp(-2 * math.pi * self.low_pass * packer.scenario.control_dt)
