"""The drives of the joints."""

import math
from typing import Any, ClassVar

from fbl_gym.records.record import Distribution, Number, Numbers, Option, Pair, ends, number, pair, steps, whole

_NONE = (math.inf, math.inf)


class Actuator(Option):
    """The joint drives: the torque command passes limit, delay, rate limit, lag and gain in turn.

    Args:
        torque_limit: largest torque, 0 of a joint without a drive; None: no limit.
        delay: time from command to torque, a multiple of physics_dt; a draw is rounded to one.
        lag: time constant of a first-order lag after the delay; 0: no lag.
        gain: real / nominal torque, the error of the torque constant.
        delay_samples: control samples from reading to command, which adds to `delay`; a draw is
            rounded to a whole number.
        rate_limit: largest change of the torque per time, before the lag; None: no limit.
        jitter: longest further delay of a command, a multiple of physics_dt; each command has its
            own draw between 0 and this. The newest command that has arrived acts; an older one
            that arrives after it is ignored, as on a sampled fieldbus.
        ripple: amplitude of a torque that is a sine of the drive's angle, with a phase that each
            episode draws: cogging, and the errors of current sensors and gears.
        ripple_order: periods of the ripple in a turn of the joint.
    """

    torque_limit: Pair | float | None = pair(
        (2000.0, 800.0), unit="N m", low=0, high=1e30, optional=True, kernel="torque_limit", none=_NONE
    )
    delay: Number = number(0.0, unit="s", varies=True, low=0, high=100, kernel="delay", scale=steps)
    lag: Number = number(0.0, unit="s", varies=True, low=0, kernel="lag", scale=steps)
    gain: Numbers = pair(1.0, varies=True, low=0, kernel="gain")
    delay_samples: Number = whole(0, high=10_000, varies=True, kernel="delay_samples")
    rate_limit: Numbers | None = pair(
        None, unit="N m/s", varies=True, above=0, kernel="rate_limit", scale=lambda task: task.physics_dt, none=_NONE
    )
    jitter: Number = number(0.0, unit="s", varies=True, low=0, high=100, kernel="jitter", scale=steps)
    ripple: Numbers = pair(0.0, unit="N m", varies=True, low=0, kernel="ripple")
    ripple_order: Pair | float = pair(36.0, above=0, high=1e6, kernel="ripple_order")

    derived: ClassVar = {
        "torque_scale": (float, 2), "delay_steps": int, "past_actions": int,
        "torque_varies": bool, "jittered": bool, "rippled": bool,
    }  # fmt: skip
    drawn: ClassVar = {"ripple_phase": (float, 2)}

    def check(self, scenario: Any) -> None:
        """Refuse times that are no multiple of a physics step."""
        for name in ("delay", "jitter"):
            if isinstance(getattr(self, name), float):
                scenario.check_multiple(f"actuator.{name}", getattr(self, name), "physics_dt")
        if (latest := ends(self.delay)[1]) >= scenario.duration:
            raise ValueError(f"actuator.delay must be below the duration of {scenario.duration:g} s, got {latest:g} s")

    def pack(self, packer: Any) -> None:
        """Write the longest delay in control steps, rounded up, and what acts later."""
        settings, scenario = packer.settings, packer.scenario
        settings["torque_scale"] = [limit or 1.0 for limit in self.torque_limit or _NONE]  # type: ignore[union-attr]
        h, samples = scenario.physics_dt, round(ends(self.delay_samples)[1])
        longest, latest = ends(self.delay)[1], ends(self.jitter)[1]
        delay = samples * scenario.substeps + round(longest * (1 / h)) + round(latest * (1 / h))
        late = -(-delay // scenario.substeps)
        settings["delay_steps"] = late
        # The state has the actions on their way, and the one that a slow drive still follows.
        slow = ends(self.lag)[1] > 0 or self.rate_limit is not None
        settings["past_actions"] = delay // scenario.substeps + 1 if slow else late
        settings["jittered"], settings["rippled"] = latest > 0.0, ends(self.ripple)[1] > 0.0
        settings["torque_varies"] |= late > 0 or slow or settings["rippled"]
        if settings["rippled"]:
            packer.vary("ripple_phase", (Distribution(uniform=(0.0, 2 * math.pi)),) * 2, "actuator.ripple phase")

    def facts(self, scenario: Any) -> dict[str, Any]:
        """Return what policies are told, as fields of `Interface`."""
        both = zip(ends(self.delay), ends(self.delay_samples), (0.0, ends(self.jitter)[1]), strict=True)
        rate = self.rate_limit
        return {
            "torque_limit": self.torque_limit,
            "delay": tuple(delay + round(samples) * scenario.control_dt + late for delay, samples, late in both),
            "lag": ends(self.lag),
            "rate_limit": None if rate is None else tuple(ends(limit)[0] for limit in rate),  # type: ignore[union-attr]
        }
