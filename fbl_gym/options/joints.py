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
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from fbl_gym.records.checks import Pair
from fbl_gym.records.record import Numbers, Option, choice, ends, pair


@dataclass(frozen=True)
class ElasticJoint(Option):
    """Joints with a spring between motor and link.

    Args:
        stiffness: of the spring, K.
        damping: of the spring, D.
        rotor_inertia: inertia of each rotor, reflected to the joint, B; None: the arm's `rotor`,
            which the nominal model knows.
        backlash: width of the gap in which motor and link do not touch.
        encoder: the side on which position and velocity are measured.
    """

    stiffness: Numbers = pair(unit="N m/rad", varies=True, above=0, kernel="stiffness")
    damping: Numbers = pair(0.0, unit="N m s/rad", varies=True, low=0, kernel="damping")
    rotor_inertia: Pair | float | None = pair(None, unit="kg m^2", above=0)
    backlash: Numbers = pair(0.0, unit="rad", varies=True, low=0, kernel="backlash")
    encoder: Literal["motor", "link"] = choice("motor", ("motor", "link"))

    derived: ClassVar = {"elastic": bool, "encoder_on_motor": bool}

    def check(self, scenario: Any) -> None:
        """Refuse joints without rotors, or too stiff for the physics step."""
        if min(scenario.rotor) <= 0.0:
            raise ValueError(f"elastic joints need rotors: give joint.rotor_inertia or arm.rotor, got {scenario.rotor}")
        scenario.check_springs()

    def pack(self, packer: Any) -> None:
        """Write the encoders' side."""
        packer.settings["elastic"], packer.settings["encoder_on_motor"] = True, self.encoder == "motor"

    def facts(self, scenario: Any) -> dict[str, Any]:
        """Return what policies know of the joints, as fields of `Interface`."""
        return {
            "stiffness": tuple(zip(*map(ends, self.stiffness), strict=True)),  # type: ignore[arg-type]
            "damping": tuple(zip(*map(ends, self.damping), strict=True)),  # type: ignore[arg-type]
            "backlash": tuple(ends(width)[1] for width in self.backlash),  # type: ignore[union-attr]
            "rotor_inertia": scenario.rotor,
            "encoder": self.encoder,
        }
