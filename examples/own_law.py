"""Write a law, check it, and compare it with a law of the package.

    python examples/own_law.py
    fbl-gym evaluate examples/own_law.py computed-torque@tuned --scenario servo-payload-2

The file is a policy of every command: each looks for `make_policy` in it.
"""

from dataclasses import dataclass

import numpy as np

import benchmarks
import controllers
from fbl_gym.model.arm import gravity_torque, inertia_matrix
from fbl_gym.records.record import number


@dataclass(frozen=True)
class MyLaw(controllers.TorqueLaw):
    """PD with gravity compensation, with gains in units of the nominal inertia."""

    frequency: float = number(8.0, unit="rad/s", above=0, tune=(2.0, 40.0))

    def torque(self, observation, state):
        q, v, r, dr = self.read(observation, "position", "velocity", "reference_position", "reference_velocity")
        inertia = np.diagonal(inertia_matrix(self.interface.nominal, (0.0, 0.0)))
        pd = inertia * (self.frequency**2 * (r - q) + 2 * self.frequency * (dr - v))
        return pd + gravity_torque(self.interface.nominal, q), state


make_policy = MyLaw

if __name__ == "__main__":
    for policy in (__file__, "computed-torque@tuned"):
        runs = benchmarks.evaluate(policy, "servo-payload-2", seeds=16)  # a row for each seed
        print(f"{policy}: error {runs.error_pct.median():.2f} %, worst seed {runs.error_pct.max():.2f} %")
