"""A batch of arms that MuJoCo moves: the plant that is not this package's.

The kernel draws the episode, applies limit, delay, lag and disturbance, and takes the readings.
MuJoCo integrates the torque in between. It holds a torque over a step, so a torque that varies
within a physics step acts with its mean by Simpson's rule.

An elastic joint is two hinges on one axis: the motor with its rotor as armature, then the spring.
MuJoCo's springs have no gap. The difference to a spring with backlash is therefore a torque that is
held over each of MuJoCo's steps, taken at the stretch expected in the step's middle.
"""

import copy
import dataclasses
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from fbl_gym.kernel.batch import ArmBatch, Truth
from fbl_gym.kernel.memory.layout import BLOCK, LANES, RESTART
from fbl_gym.kernel.memory.program import Program
from fbl_gym.kernel.step import api
from fbl_gym.model.arm import Array
from fbl_gym.model.chain import HINGE
from fbl_gym.options import MuJoCo, ParameterError
from fbl_gym.scenarios import Scenario

#: Moment of inertia of a point mass [kg m^2]; MuJoCo refuses zero.
_POINT_INERTIA = 1e-12

_REAL = (
    "parameters", "centre_ratio", "inertia_ratio", "rotor_ratio", "payload", "held_payload", "payload_offset", "payload_radius",
    "viscous", "coulomb", "stiction", "load_friction", "stiffness", "damping", "backlash", "bend_rate",
)  # fmt: skip
#: The fields of a block from which a lane's model is made; it is made again when one changes.
_MODEL = np.dtype([(name, np.float64, BLOCK[name].shape[:-1]) for name in _REAL])

#: Fields of a block with a lane's state.
_MOTION = ("position", "velocity", "motor_position", "motor_velocity", "bend", "bend_velocity")

_VELOCITIES = _MOTION[1::2]

#: Impedance of a motor's friction loss. With MuJoCo's default, a light motor that sticks creeps.
_HARD = "0.999 0.999 0.001"


class MuJoCoBatch(ArmBatch):
    """A batch of arms of one scenario, each with a MuJoCo model of its real parameters.

    Lanes are advanced one after the other, so that a lane equals the single environment.

    Args:
        scenario: the task; its `plant` is a `MuJoCo`.
        program: the scenario in numbers.
        lanes: number of arms, one or more.
    """

    def __init__(self, scenario: Scenario, program: Program, lanes: int) -> None:
        super().__init__(program, lanes)
        self._scenario = scenario
        self._arms_change = any(self.settings[name] for name in ("has_payload", "events"))
        self._arms: dict[int, _Arm] = {}  # of each lane
        self._lanes = np.arange(lanes) // LANES, slice(None), np.arange(lanes) % LANES

    def state(self) -> Any:
        """Return a copy of all that a step depends on, for `restore`."""
        return super().state(), copy.deepcopy(self._arms)

    def restore(self, state: Any) -> bool:
        """Go on from what `state` of a batch like this one returned; False: it is not like this."""
        if not (isinstance(state, tuple) and len(state) == 2 and super().restore(state[0])):
            return False
        self._arms = copy.deepcopy(state[1])
        return True

    def reset(self, lanes: NDArray[np.int64], out: Array) -> None:
        """Start an episode in some lanes; write all observations to `out` [lanes x size]."""
        self._blocks["status"][lanes // LANES, lanes % LANES] = RESTART
        self._observe(out)

    @np.errstate(over="ignore", invalid="ignore")  # of an arm that diverges, whose episode ends
    def step(self, actions: Array, out: Array) -> int:
        """Advance every lane by one control step; see `ArmBatch.step`."""
        memory, blocks, lanes = self._memory, self._blocks, self._lanes
        memory[self._actions] = actions.reshape(-1)
        substeps, steps = self._scenario.substeps, _plant(self._scenario).substeps
        if not (self.settings["torque_varies"] or self._arms_change):
            substeps, steps = 1, substeps * steps
        for substep in range(substeps):
            problem = api.load(memory, substep)
            if problem >= 0:
                return problem
            torque, load, drive = self._mean("tau"), self._mean("load"), self.field("torque")
            models = self._models() if self._arms_change else None
            velocities = np.stack([blocks[name][lanes] for name in _VELOCITIES], axis=1)
            for lane, arm in self._arms.items():
                if models is not None and arm.real.tobytes() != models[lane].tobytes():
                    arm = self._arms[lane] = arm.changed(models[lane])
                arm.advance(velocities[lane], torque[lane], load[lane], drive[lane], steps)
            motions = [arm.motion for arm in self._arms.values()]
            for name in motions[0]:
                blocks[name][lanes] = [motion[name] for motion in motions]
        if self.settings["senses_acceleration"]:
            blocks["acceleration"][lanes] = self._accelerate()[0]
        api.end(memory)
        self._observe(out)
        return -1

    def step_one(self, action1: float, action2: float, out: Array) -> tuple[int, float, bool, bool]:
        """Advance a batch of one lane, as `step` does."""
        problem = self.step(np.array([action1, action2]), out)
        rewards, terminated, truncated = self.outcomes
        return problem, float(rewards[0]), bool(terminated[0]), bool(truncated[0])

    def _observe(self, out: Array) -> None:
        """Start the lanes marked RESTART, and write all observations, by the compiled step."""
        blocks, lanes = self._blocks, self._lanes
        starts = np.flatnonzero(self.field("status") == RESTART)
        self.sense(out)
        if not len(starts):
            return
        models = self._models()
        for lane in starts:
            arm = self._arms[int(lane)] = _Arm(self._scenario, models[lane])
            arm.start(*(blocks[name][lanes][lane] for name in _MOTION))
        if self.settings["senses_acceleration"]:
            blocks["acceleration"][lanes] = self._accelerate()[0]
            self.sense(out)

    def _mean(self, torque: str) -> Array:
        """Return the mean of a torque over the physics step, [lanes x 2]."""
        start, half, end = self.field(torque).swapaxes(0, 1)
        return (start + 4.0 * half + end) / 6.0

    def _models(self) -> NDArray[np.void]:
        """Return what each lane's model is made from, [lanes] of the type `_MODEL`."""
        models = np.empty(self.lanes, _MODEL)
        for name in _REAL:
            models[name] = self.field(name)
        return models

    def _accelerate(self) -> tuple[Array, Array]:
        """Return acceleration and friction torque of each lane now, [lanes x 2] each."""
        torque, load = self.field("torque"), -self.field("disturbance")
        both = np.array([arm.accelerate(torque[lane], load[lane]) for lane, arm in self._arms.items()])
        return both[:, 0], both[:, 1]

    def truth(self) -> Truth:
        """Return the truth at this instant."""
        acceleration, friction = self._accelerate()
        return dataclasses.replace(super().truth(), acceleration=acceleration, friction_torque=friction)


class _Arm:
    """MuJoCo's model and state of one lane.

    Args:
        scenario: the task.
        real: the lane's parameters, a record of the type `_MODEL`.
    """

    def __init__(self, scenario: Scenario, real: np.void) -> None:
        self._scenario, self.real = scenario, real
        self._model = mujoco.MjModel.from_xml_string(_describe(scenario, real))
        self._data = mujoco.MjData(self._model)
        for warning in self._data.warning:
            warning.number = 1  # MuJoCo writes a file at the first warning of each kind
        # Of each link, the first hinge is the joint or its motor. The next is its spring, if it is
        # elastic. The last is the link's own, if it bends.
        hinges, elastic = self._model.nv // 2, scenario.joint is not None
        self._joints, self._springs = slice(0, None, hinges), slice(1, None, hinges) if elastic else slice(0)
        self._bends = slice(hinges - 1, None, hinges) if scenario.link is not None else slice(0)
        self._gap, self._loss = 0.5 * real["backlash"], self._model.dof_frictionloss[self._joints].copy()

    def start(self, *motion: Array) -> None:
        """Set the state: angles and velocities as in `_MOTION`, [2] each."""
        self._set(self._data.qpos, *motion[0::2])
        self._set(self._data.qvel, *motion[1::2])

    def _set(self, values: Array, links: Array, motors: Array, bends: Array) -> None:
        """Set MuJoCo's angles or velocities, from those of links and motors, and the bends."""
        values[self._joints] = links
        if self._scenario.joint is not None:
            values[self._joints], values[self._springs] = motors, links - motors
        if self._scenario.link is not None:
            values[self._bends] = bends

    def changed(self, real: np.void) -> Self:
        """Return an arm of other parameters in the state of this one."""
        arm = type(self)(self._scenario, real)
        arm._data.qpos[:], arm._data.qvel[:] = self._data.qpos, self._data.qvel
        return arm

    def advance(self, velocities: Array, torque: Array, load: Array, drive: Array, steps: int) -> None:
        """Hold torques, see `_push`, for some of MuJoCo's steps, from `_VELOCITIES` on."""
        model, data = self._model, self._data
        self._set(data.qvel, *velocities)
        times, ahead = (steps, 0.5 * model.opt.timestep) if self._gap.any() else (1, 0.0)
        for _ in range(times):
            self._push(torque, load, drive, ahead)
            mujoco.mj_step(model, data, steps // times)

    def _push(self, torque: Array, load: Array, drive: Array, ahead: float = 0.0) -> None:
        """Apply torques to joints, loads on links, and the difference that a gap makes to springs.

        Friction grows with the torque of the `drive`, of which disturbances are no part. The
        stretch of the springs is extrapolated by the time `ahead` [s].
        """
        data, springs = self._data, self._springs
        data.qfrc_applied[self._joints] = torque + load
        self._model.dof_frictionloss[self._joints] = self._loss + self.real["load_friction"] * np.abs(drive)
        if self._scenario.joint is None:
            return
        rate = data.qvel[springs]
        stretch = data.qpos[springs] + ahead * rate
        free = np.clip(stretch, -self._gap, self._gap)
        gap = self.real["stiffness"] * free + np.where(np.abs(stretch) < self._gap, self.real["damping"] * rate, 0.0)
        pull = self.real["stiffness"] * stretch + self.real["damping"] * rate - gap
        gap += np.where((self._gap > 0) & (pull * stretch < 0), pull, 0.0)  # teeth push and never pull
        data.qfrc_applied[springs] = load + gap

    def accelerate(self, torque: Array, load: Array) -> tuple[Array, Array]:
        """Return acceleration and friction torque under torques at this instant, [2] each."""
        data, joints, springs = self._data, self._joints, self._springs
        self._push(torque, load, torque)
        mujoco.mj_forward(self._model, data)
        acceleration = data.qacc[joints].copy()
        if self._scenario.joint is not None:
            acceleration += data.qacc[springs]
        return acceleration, -(data.qfrc_passive + data.qfrc_constraint)[joints]

    @property
    def motion(self) -> dict[str, Array]:
        """Return angles [rad] and velocities [rad/s] of the joints, motors and bends, [2] each."""
        motion = {}
        for names, x in ((_MOTION[0::2], self._data.qpos), (_VELOCITIES, self._data.qvel)):
            motion[names[0]] = x[self._joints]
            if self._scenario.joint is not None:
                motion[names[0]], motion[names[1]] = x[self._joints] + x[self._springs], x[self._joints]
            if self._scenario.link is not None:
                motion[names[2]] = x[self._bends]
        return motion


def _plant(scenario: Scenario) -> MuJoCo:
    assert scenario.plant is not None
    return scenario.plant


def _describe(scenario: Scenario, real: np.void) -> str:
    """Return the arm in MuJoCo's language: x to the right, y up, hinges about z."""
    plant, (_, _, L1, L2) = _plant(scenario), real["parameters"]
    held = real["held_payload"]
    loads = (held, real["payload_offset"], held * real["payload_radius"] ** 2), (real["payload"] - held, 0.0, 0.0)
    load = "".join(f'<body pos="{L2} 0 0">{_mass(*load)}</body>' for load in loads if load[0] > 0)
    second = f'<body pos="{L1} 0 0">{_link(scenario, real, 1, load)}</body>'
    return f"""
    <mujoco>
      <compiler angle="radian" autolimits="false"/>
      <option timestep="{scenario.physics_dt / plant.substeps}" integrator="{plant.integrator}"
              gravity="0 {-scenario.arm.gravity} 0">
        <flag contact="disable" warmstart="disable" autoreset="disable"/>
      </option>
      <worldbody><body>{_link(scenario, real, 0, second)}</body></worldbody>
    </mujoco>"""


def _link(scenario: Scenario, real: np.void, joint: int, end: str) -> str:
    """Return the content of a link's body, with the bodies at its end."""
    arm, plant = scenario.arm, _plant(scenario)
    mass, length = real["parameters"][joint], real["parameters"][2 + joint]
    loss = real["coulomb"][joint] + (real["stiction"][joint] if plant.friction == "breakaway" else 0.0)
    rotor = scenario.rotor[joint] * real["rotor_ratio"][joint]
    drive = f'damping="{real["viscous"][joint]}" frictionloss="{loss}" armature="{rotor}"'
    hinge = f'<joint axis="0 0 1" {drive}/>'
    if scenario.joint is not None:
        hinge = f'<joint axis="0 0 1" {drive} solimpfriction="{_HARD}"/>'
        hinge += f'<joint axis="0 0 1" stiffness="{real["stiffness"][joint]}" damping="{real["damping"][joint]}"/>'
    error, m, L = scenario.parameter_error or ParameterError(), (arm.m1, arm.m2)[joint], (arm.L1, arm.L2)[joint]
    centre = arm.centre[joint] * real["centre_ratio"][joint] * (length if error.centre is None else L)  # type: ignore[index]
    moment = mass * length**2 if error.inertia is None else m * L**2
    inertia = arm.inertia[joint] * real["inertia_ratio"][joint] * moment  # type: ignore[index]
    if scenario.link is None:
        return hinge + _mass(mass, centre, inertia) + end
    # Both halves have the whole link's centre: a link that does not bend is the rigid one.
    half = _mass(mass / 2, centre, inertia / 2)
    stiffness, damping = (both[joint] for both in scenario.link.springs(arm, real["bend_rate"]))
    spring = f'<joint axis="0 0 1" pos="{HINGE * length} 0 0" stiffness="{stiffness}" damping="{damping}"/>'
    return f"{hinge}{half}<body>{spring}{half}{end}</body>"


def _mass(mass: float, centre: float, inertia: float) -> str:
    moment = max(inertia, _POINT_INERTIA)
    return f'<inertial pos="{centre} 0 0" mass="{mass}" diaginertia="{moment} {moment} {moment}"/>'
