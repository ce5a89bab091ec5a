"""Reading of MuJoCo's XML."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fbl_gym.model.arm import Array
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
    data, turns = mujoco.MjData(model), model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)
    bits = mujoco.mjtDisableBit
    falls = not model.opt.disableflags & bits.mjDSBL_GRAVITY
    model.opt.disableflags |= int(bits.mjDSBL_CONTACT | bits.mjDSBL_LIMIT | bits.mjDSBL_FRICTIONLOSS)
    data.qpos[model.jnt_qposadr[turns]] = 0.0  # whatever their angles of reference
    rest, damping = data.qpos.copy(), _damping(model, data)
    levers, bent = (_levers(model, data, angle) for angle in (0.0, 0.5))
    mujoco.mj_kinematics(model, data)
    links = [model.body(i).name or f"body {i}" for i in range(model.nbody)]
    joints: dict[str, Joint | str] = {}
    for i in range(model.njnt):
        name, dof = model.joint(i).name or f"joint {i}", model.jnt_dofadr[i]
        driven, effort, *doubts = _effort(model, levers, i, name)
        doubts += [f"the spring of {name} is neglected"] if model.jnt_stiffness[i] else []
        doubts += ["the friction of tendons is neglected"] if model.ntendon and model.tendon_frictionloss.any() else []
        if (levers[:, i] != bent[:, i]).any():
            doubts.append(f"the lever of an actuator of {name} changes with its angle: that at 0 is taken")
        viscous, loss = (float(x[dof]) if x.any() else None for x in (damping, model.dof_frictionloss))
        numbers = effort, viscous, loss, None
        joint = name, links[model.jnt_bodyid[i]], data.xaxis[i].copy(), data.xanchor[i].copy(), numbers, tuple(doubts)
        rotor = float(model.dof_armature[dof])
        if hasattr(model, "actuator_armature"):
            rotor += float(model.actuator_armature @ levers[:, i] ** 2)
        hinge = model.jnt_type[i] == mujoco.mjtJoint.mjJNT_HINGE
        joints[name] = Joint(*joint, rotor, driven) if hinge else "no hinge"
    axes = data.ximat.reshape(-1, 3, 3)
    inertias = np.einsum("nij,nj,nkj->nik", axes, model.body_inertia, axes)
    masses = dict(zip(links, map(Mass, map(float, model.body_mass), data.xipos, inertias), strict=True))
    parents = {link: links[model.body_parentid[i]] if i else None for i, link in enumerate(links)}
    frames = {link: (link, data.xpos[i].copy()) for i, link in enumerate(links)}
    for i in range(model.nsite):
        name = model.site(i).name or f"site {i}"
        place = links[model.site_bodyid[i]], data.site_xpos[i].copy()
        frames[f"site {name}" if name in frames else name] = place
    if model.body_gravcomp.any():
        raise ValueError("gravcomp must be 0: the weight of links, which it takes off, stays here")

    def torques(names: Sequence[str], motions: Array) -> Array:
        some = [[*joints].index(name) for name in names]
        places, dofs = model.jnt_qposadr[some], model.jnt_dofadr[some]
        found, springs = [], model.jnt_stiffness.copy()
        model.jnt_stiffness[:] = 0.0
        for q, v, a in motions:
            data.qpos[:], data.qvel[:], data.qacc[:] = rest, 0.0, 0.0
            data.qpos[places], data.qvel[dofs], data.qacc[dofs] = q, v, a
            mujoco.mj_inverse(model, data)
            if data.qfrc_constraint[dofs].any():
                raise ValueError(
                    f"{' and '.join(names)} must move freely, but an <equality> of the file ties one of them"
                )
            found.append(data.qfrc_inverse[dofs])
        model.jnt_stiffness[:] = springs
        return np.array(found)

    return Robot(parents, joints, frames, masses.__getitem__, -model.opt.gravity * falls, torques)


def _damping(model: Any, data: Any) -> Array:
    """Return the torque against 1 rad/s of each degree of freedom, but that of a fluid."""
    import mujoco

    torques, fluid = [], (model.opt.density, model.opt.viscosity)
    model.opt.density = model.opt.viscosity = 0.0
    for velocity in np.vstack([np.zeros(model.nv), np.eye(model.nv)]):
        data.qvel[:] = velocity
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        torques.append(data.qfrc_passive.copy())
    data.qvel[:], (model.opt.density, model.opt.viscosity) = 0.0, fluid
    return np.diagonal((torques[0] - torques[1:]).reshape(model.nv, model.nv)).round(12)


def _levers(model: Any, data: Any, angle: float, step: float = 1e-3) -> Array:
    """Return the torque on each joint for a force of 1 [actuators x joints], at an angle [rad]."""
    import mujoco

    lengths = np.zeros((2, model.nu, model.njnt))
    for i in np.flatnonzero(model.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)):
        for k, sign in enumerate((-1.0, 1.0)):
            data.qpos[model.jnt_qposadr[i]] = angle + sign * step
            mujoco.mj_fwdPosition(model, data)
            lengths[k, :, i] = data.actuator_length
        data.qpos[model.jnt_qposadr[i]] = 0.0
    return (np.diff(lengths, axis=0)[0] / (2.0 * step)).round(7)


def _effort(model: Any, levers: Array, joint: int, name: str) -> tuple[Any, ...]:
    """Return whether a joint is driven, its largest torque, None without a limit, and doubts.

    The control of a motor is a force; that of a servo, such as a position, tells none. Forces act
    through the gear, and through tendons. Those of several actuators at one joint add up.
    """
    from mujoco import mjtBias, mjtDyn, mjtGain

    own = np.flatnonzero(levers[:, joint])
    if not len(own):
        return not levers.any(), None
    torques, doubts = np.zeros(2), []
    for i in own:
        force = np.array([-np.inf, np.inf])
        kinds = model.actuator_gaintype[i], model.actuator_biastype[i], model.actuator_dyntype[i]
        motor = kinds == (mjtGain.mjGAIN_FIXED, mjtBias.mjBIAS_NONE, mjtDyn.mjDYN_NONE)
        if motor and model.actuator_ctrllimited[i]:
            force = np.sort(model.actuator_gainprm[i, 0] * model.actuator_ctrlrange[i])
        if model.actuator_forcelimited[i]:
            force = np.clip(force, *model.actuator_forcerange[i])
        torques = torques + np.sort(force * levers[i, joint])
        if np.count_nonzero(levers[i]) > 1:
            doubts = [f"an actuator of {name} drives other joints, too, which is neglected"]
    low, high = np.clip(torques, *model.jnt_actfrcrange[joint]) if model.jnt_actfrclimited[joint] else torques
    if not np.isfinite((low, high)).all():
        return True, None, f"the actuators of {name} have no range of forces: it has no torque limit", *doubts
    if abs(low + high) > 1e-9:
        doubts.append(f"the torque of {name} lies within {low:g} and {high:g} N m, and the larger bound is taken")
    return True, float(max(-low, high)), *doubts
