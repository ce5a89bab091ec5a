"""Describe an arm by its data sheet, and run laws on it.

    python examples/own_arm.py

The robot differs from its data sheet by up to 10 %: a new draw for each seed.
"""

import benchmarks
from fbl_gym import ArmParameters, scenarios

arm = ArmParameters.from_links(  # the Pelican of Kelly, Santibanez and Loria
    mass=(6.5225, 2.0458),  # kg
    length=(0.26, 0.26),  # m
    centre=(0.0983, 0.0229),  # of mass, from the link's joint, m
    inertia=(0.1213, 0.0116),  # about that centre, kg m^2
)
robot = scenarios.get("servo-practice-nominal").replace(
    name="pelican",
    arm=arm,
    actuator={"torque_limit": (15.0, 4.0), "delay": 0.004},  # N m, s
    friction={"coulomb": (0.3, 0.1), "viscous": (0.2, 0.1)},  # N m, N m s/rad
    parameter_error={"radius": 0.1},
    control_dt=0.002,  # s
)
for policy in ("pd-gravity", "computed-torque", "computed-torque-dob", "lqg"):
    runs = benchmarks.evaluate(policy, robot, seeds=8)
    print(f"{policy}: error {runs.error_pct.median():.2f} %, torque {runs.torque_rms.median():.1f} N m (RMS)")
