"""The same arm in MuJoCo."""

from typing import Any

import numpy as np

from benchmarks.speed.timing import Contestant
from fbl_gym.arm import ArmParameters


def mujoco_arm(arm: ArmParameters) -> Contestant:
    """Return a contestant: the same arm in MuJoCo, ten Runge-Kutta steps of 1 ms at once."""
    import mujoco

    model = _model(arm)
    data = mujoco.MjData(model)

    def step() -> int:
        mujoco.mj_step(model, data, 10)
        return 1

    return step


def mujoco_arms(arm: ArmParameters, lanes: int) -> Contestant:
    """Return a contestant: the same for many arms by `mujoco.rollout`, with all physics states."""
    import mujoco
    from mujoco import rollout

    model = _model(arm)
    data = mujoco.MjData(model)
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, start, kind)
    states = np.tile(start, (lanes, 10, 1))

    def step() -> int:
        rollout.rollout(model, data, states[:, -1].copy(), nstep=10, skip_checks=False, state=states)
        return lanes

    return step


def _model(arm: ArmParameters) -> Any:
    import mujoco

    tip = '<geom type="sphere" size="0.01" mass="{}" pos="{} 0 0"/>'
    first, second = tip.format(arm.m1, arm.L1), tip.format(arm.m2, arm.L2)
    joint = '<joint type="hinge" axis="0 0 1"/>'
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler inertiafromgeom="true"/><option timestep="0.001" gravity="0 -{arm.gravity} 0" integrator="RK4">'
        f'<flag contact="disable"/></option><worldbody><body>{joint}{first}<body pos="{arm.L1} 0 0">{joint}{second}</body>'
        "</body></worldbody></mujoco>"
    )
