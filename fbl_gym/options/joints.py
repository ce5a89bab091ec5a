"""Elastic joints: the motor turns the link through a spring, with a gap if there is backlash.

With the motor's angle th behind its gear, the link's angle q and the rotor's inertia B:

    B th'' = tau - tau_s - F(th')        M(q) q'' + C(q, q') q' + G(q) = tau_s - tau_d
    tau_s = K dz(x) + D x'        x = th - q

dz(x) is zero while x is within half the backlash, and its distance to the gap beyond. In the gap
the damper does not act either: tau_s = 0. Teeth push and never pull: with backlash, tau_s = 0 also
where the sum and x have opposite signs, as where the damper exceeds the spring while teeth part.
Friction F acts on the motor, the disturbance tau_d on the link. The rotors' coupling through the
motion of the links is left out, as is usual for high gear ratios (Spong, "Modeling and control of
elastic joint robots", ASME J. Dyn. Syst. Meas. Control 109, 1987; De Luca and Book, "Robots with
flexible elements", Springer Handbook of Robotics, chapter 11).

In place of K, the natural frequency f [Hz] of each joint may be given. It is that of the stretched
nominal links (q_2 = 0) about this joint alone, with its motor and the other joint held:

    K_i = (2 pi f_i)^2 M_ii

M_ii is without rotors and payload. Both joints together have a slower mode, and a motor that is not
held has a faster one: of joint i alone, f_i sqrt(1 + M_ii / B_i).
"""

from collections.abc import Callable
from typing import Any, ClassVar, Literal

import numpy as np

from fbl_gym.model.arm import ArmParameters, Array, stretched_inertia
from fbl_gym.records.record import Numbers, Option, Pair, choice, ends, pair


class ElasticJoint(Option):
    """Joints with a spring between motor and link.

    Args:
        stiffness: of the spring, K; None: it follows from `frequency`.
        frequency: in place of `stiffness`, natural frequency of each joint alone with its motor
            held, of the stretched nominal links without payload: K = (2 pi frequency)^2 M_ii.
        damping: of the spring, D.
        rotor_inertia: inertia of each rotor, reflected to the joint, B; None: the arm's `rotor`,
            which the nominal model knows.
        backlash: width of the gap in which motor and link do not touch.
        encoder: the side on which position and velocity are measured.
    """

    stiffness: Numbers | None = pair(None, unit="N m/rad", varies=True, above=0, kernel="stiffness")
    frequency: Numbers | None = pair(
        None, unit="Hz", varies=True, above=0, high=1e4, kernel="stiffness", scale=2 * np.pi
    )
    damping: Numbers = pair(0.0, unit="N m s/rad", varies=True, low=0, kernel="damping")
    rotor_inertia: Pair | float | None = pair(None, unit="kg m^2", above=0)
    backlash: Numbers = pair(0.0, unit="rad", varies=True, low=0, kernel="backlash")
    encoder: Literal["motor", "link"] = choice("motor", ("motor", "link"))

    derived: ClassVar = {"elastic": bool, "encoder_on_motor": bool, "stretched_inertia": (float, 2)}

    def validate(self) -> None:
        """Refuse both a stiffness and a frequency, or neither."""
        if (self.stiffness is None) == (self.frequency is None):
            raise ValueError(
                "give one of stiffness [N m/rad] and frequency [Hz], and None (false in TOML) for the other; "
                f"got stiffness={self.stiffness} and frequency={self.frequency}"
            )

    def check(self, scenario: Any) -> None:
        """Refuse joints without rotors."""
        if min(scenario.rotor) <= 0.0:
            raise ValueError(f"elastic joints need rotors: give joint.rotor_inertia or arm.rotor, got {scenario.rotor}")

    def pack(self, packer: Any) -> None:
        """Write the encoders' side, and the inertia by which a frequency becomes a stiffness."""
        packer.settings["elastic"], packer.settings["encoder_on_motor"] = True, self.encoder == "motor"
        if self.frequency is not None:
            packer.settings["stretched_inertia"] = stretched_inertia(packer.scenario.arm)

    def springs(self, arm: ArmParameters, of: Callable[[Any], float]) -> tuple[Array, Array]:
        """Return stiffness [2] N m/rad and frequency [2] Hz, where `of` picks from what varies.

        `arm` is the nominal one.
        """
        given, inertia = np.array([*map(of, self.frequency or self.stiffness)]), stretched_inertia(arm)  # type: ignore[arg-type]
        if self.frequency is None:
            return given, np.sqrt(given / inertia) / (2 * np.pi)
        return inertia * (2 * np.pi * given) ** 2, given

    def facts(self, scenario: Any) -> dict[str, Any]:
        """Return what policies know of the joints, as fields of `Interface`."""
        both = (self.springs(scenario.arm, of)[0] for of in (lambda k: ends(k)[0], lambda k: ends(k)[1]))
        return {
            "stiffness": tuple(tuple(end.tolist()) for end in both),
            "damping": tuple(zip(*map(ends, self.damping), strict=True)),  # type: ignore[arg-type]
            "backlash": tuple(ends(width)[1] for width in self.backlash),  # type: ignore[union-attr]
            "rotor_inertia": scenario.rotor,
            "encoder": self.encoder,
        }
