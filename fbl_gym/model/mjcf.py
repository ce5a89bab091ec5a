"""Reading of MuJoCo's XML."""

from typing import Any

import numpy as np

from fbl_gym.model.bodies import Joint, Mass, Robot


def read_mjcf(path: str) -> Robot:
    """Return the robot of a file of MuJoCo's XML.

    Raises:
        ValueError: without the extra `mujoco`, or MuJoCo refuses the file.
    """
    try:
        import mujoco
    except ImportError:
        raise ValueError("MuJoCo's XML needs the extra: pip install 'fbl-gym[mujoco]'") from None
    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0 if model.nq == model.nv else model.qpos0
    mujoco.mj_kinematics(model, data)
    links = [model.body(i).name or f"body {i}" for i in range(model.nbody)]
    joints: dict[str, Joint | str] = {}
    for i in range(model.njnt):
        name, dof = model.joint(i).name or f"joint {i}", model.jnt_dofadr[i]
        driven, effort, *doubts = _effort(model, i, name)
        doubts += [f"the spring of {name} is neglected"] if model.jnt_stiffness[i] else []
        damping, loss = (float(x.flat[dof]) if x.any() else None for x in (model.dof_damping, model.dof_frictionloss))
        numbers = effort, damping, loss, None
        joint = name, links[model.jnt_bodyid[i]], data.xaxis[i].copy(), data.xanchor[i].copy(), numbers, tuple(doubts)
        hinge = model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE
        joints[name] = Joint(*joint, float(model.dof_armature[dof]), driven) if hinge else "no hinge"
    sites = {model.site(i).name: (links[model.site_bodyid[i]], data.site_xpos[i].copy()) for i in range(model.nsite)}
    turns = data.ximat.reshape(-1, 3, 3)
    inertias = np.einsum("nij,nj,nkj->nik", turns, model.body_inertia, turns)
    masses = dict(zip(links, map(Mass, map(float, model.body_mass), data.xipos, inertias), strict=True))
    parents = {link: links[model.body_parentid[i]] if i else None for i, link in enumerate(links)}
    frames = {link: (link, data.xpos[i].copy()) for i, link in enumerate(links)} | sites
    if model.body_gravcomp.any():
        raise ValueError("gravcomp must be 0: the weight of links, which it takes off, stays here")
    falls = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    return Robot(parents, joints, frames, masses.__getitem__, -model.opt.gravity * falls)


def _effort(model: Any, joint: int, name: str) -> tuple[Any, ...]:
    """Return whether a joint is driven, its largest torque, None without a limit, and doubts.

    The control of a motor is a force; that of a servo, such as a position, tells none. Forces act
    through the gear. Those of several actuators at one joint add up.
    """
    from mujoco import mjtBias, mjtDyn, mjtGain, mjtTrn

    drives = np.isin(model.actuator_trntype, (mjtTrn.mjTRN_JOINT, mjtTrn.mjTRN_JOINTINPARENT))
    own = np.flatnonzero(drives & (model.actuator_trnid[:, 0] == joint))
    if not len(own):
        return not drives.any(), None
    torques = np.zeros(2)
    for i in own:
        force = np.array([-np.inf, np.inf])
        kinds = model.actuator_gaintype[i], model.actuator_biastype[i], model.actuator_dyntype[i]
        motor = kinds == (mjtGain.mjGAIN_FIXED, mjtBias.mjBIAS_NONE, mjtDyn.mjDYN_NONE)
        if motor and model.actuator_ctrllimited[i]:
            force = np.sort(model.actuator_gainprm[i, 0] * model.actuator_ctrlrange[i])
        if model.actuator_forcelimited[i]:
            force = np.clip(force, *model.actuator_forcerange[i])
        torques = torques + np.sort(force * model.actuator_gear[i, 0])
    low, high = np.clip(torques, *model.jnt_actfrcrange[joint]) if model.jnt_actfrclimited[joint] else torques
    if not np.isfinite((low, high)).all():
        return True, None, f"the actuators of {name} have no range of forces: it has no torque limit"
    effort = float(max(-low, high))
    if abs(low + high) <= 1e-9:
        return True, effort
    return True, effort, f"the torque of {name} lies within {low:g} and {high:g} N m, and the larger bound is taken"
