"""Scenarios in other worlds, which another engine moves."""

import dataclasses

from fbl_gym.options import WORLDS
from fbl_gym.records.checks import check_choice
from fbl_gym.scenarios.scenario import Scenario


def in_world(scenario: Scenario, world: str) -> Scenario:
    """Return a scenario whose real arm another engine moves, in one of `WORLDS`.

    In "mujoco-lab", the arm and the rate are other ones too.
    """
    name = f"{scenario.name}@{check_choice('world', world, WORLDS)}"
    return (_in_lab(scenario) if world == "mujoco-lab" else scenario).replace(name=name, plant=WORLDS[world])


def _in_lab(scenario: Scenario) -> Scenario:
    """Return a scenario with another arm, which policies know, and a rate 5/4 as high.

    Links are heavier, of other lengths, and extended instead of point masses. Torques against
    gravity change by some percent only, so that torque limits and disturbances remain as hard.
    """
    arm, substeps = scenario.arm, scenario.substeps
    (c1, c2), (i1, i2) = arm.centre, arm.inertia  # type: ignore[misc]
    links = dataclasses.replace(
        arm, m1=1.3 * arm.m1, m2=1.2 * arm.m2, L1=0.9 * arm.L1, L2=1.1 * arm.L2,
        centre=(0.75 * c1, 0.75 * c2), inertia=(i1 + 0.05, i2 + 0.05),
    )  # fmt: skip
    control_dt = 0.8 * scenario.control_dt
    return scenario.replace(
        arm=links,
        control_dt=control_dt,
        # A physics step must divide both the control step and the times of the other options.
        physics_dt=scenario.physics_dt if substeps % 5 == 0 else scenario.physics_dt / 5,
        duration=round(scenario.duration / control_dt) * control_dt,
    )
