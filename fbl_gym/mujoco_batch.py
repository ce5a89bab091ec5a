"""A batch of arms that MuJoCo moves: the plant that is not this package's.

The kernel draws the episode, applies limit, delay, lag and disturbance, and takes the readings.
MuJoCo integrates the torque in between. It holds a torque over a step, so a torque that varies
within a physics step acts with its mean by Simpson's rule.

An elastic joint is two hinges on one axis: the motor with its rotor as armature, then the spring.
MuJoCo's springs have no gap. The difference to a spring with backlash is therefore a torque that is
held over each of MuJoCo's steps, taken at the stretch expected in the step's middle.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from fbl_gym.arm import ArmParameters, Array
from fbl_gym.batch import ArmBatch, Truth
from fbl_gym.checks import Pair
from fbl_gym.kernel import api
from fbl_gym.memory import LANES, RESTART
from fbl_gym.plants import MuJoCo
from fbl_gym.program import Program
from fbl_gym.scenarios import Scenario

_POINT_INERTIA = 1e-12
"""Moment of inertia of a point mass [kg m^2]; MuJoCo refuses zero."""

_NUMBERS = (
    "parameters", "payload", "viscous", "coulomb", "stiction", "stiffness", "damping", "half_backlash"
)  # fmt: skip
"""Fields of a block from which a lane's model is made; it is made again when one changes."""

_MOTION = ("position", "velocity", "motor_position", "motor_velocity")
"""Fields of a block with a lane's state."""

_HINGE = 0.15
"""Place of the hinge of a link that bends, as a fraction of its length."""

_HARD = "0.999 0.999 0.001"
"""Impedance of a motor's friction loss. With MuJoCo's default, a light motor that sticks creeps."""


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
        self._unchanging = not any(self._settings[name] for name in ("torque_varies", "has_payload", "events"))
        self._senses_acceleration = bool(self._settings["senses_acceleration"])
        self._settings["external_physics"] = True
        self._arms: dict[int, _Arm] = {}  # of each lane
        numbers = np.arange(lanes)
        self._place = numbers // LANES, slice(None), numbers % LANES

    @property
    def _step(self) -> Any:
        """The compiled step, of which only the start of episodes and the observation are used."""
        return api.STEPS[2]

    def reset(self, lanes: NDArray[np.int64], out: Array) -> None:
        """Start an episode in some lanes; write all observations to `out` [lanes * size]."""
        self._blocks["status"][lanes // LANES, lanes % LANES] = RESTART
        self._observe(out)

    def step(self, actions: Array, out: Array) -> tuple[int, float, bool, bool]:
        """Advance every lane by one control step; see `ArmBatch.step`."""
        memory, blocks, place = self._memory, self._blocks, self._place
        memory[self._actions] = actions
        substeps, steps = self._scenario.substeps, _plant(self._scenario).substeps
        if self._unchanging:
            substeps, steps = 1, substeps * steps
        for substep in range(substeps):
            problem = api.load(memory, substep)
            if problem >= 0:
                return problem, 0.0, False, False
            torque, load = self._mean("tau"), self._mean("load")
            numbers = self._numbers()
            velocity, motor_velocity = blocks["velocity"][place], blocks["motor_velocity"][place]
            for lane, arm in self._arms.items():
                if not np.array_equal(arm.numbers, numbers[lane]):
                    arm = self._arms[lane] = arm.changed(numbers[lane])
                arm.advance(velocity[lane], motor_velocity[lane], torque[lane], load[lane], steps)
            motions = [arm.motion for arm in self._arms.values()]
            for name in motions[0]:
                blocks[name][place] = [motion[name] for motion in motions]
        if self._senses_acceleration:
            blocks["acceleration"][place] = self._accelerate()[0]
        api.end(memory)
        rewards, terminated, truncated = self.outcomes
        self._observe(out)
        return -1, float(rewards[0]), bool(terminated[0]), bool(truncated[0])

    def step_one(self, action1: float, action2: float, out: Array) -> tuple[int, float, bool, bool]:
        """Advance a batch of one lane, as `step` does."""
        return self.step(np.array([action1, action2]), out)

    def _observe(self, out: Array) -> None:
        """Start the lanes marked RESTART, and write all observations."""
        blocks, place = self._blocks, self._place
        starts = np.flatnonzero(blocks["status"][place[0], place[2]] == RESTART)
        self._step(self._memory, out, 0, 0)
        numbers = self._numbers()
        for lane in starts:
            arm = self._arms[int(lane)] = _Arm(self._scenario, numbers[lane])
            arm.place(*(blocks[name][place][lane] for name in _MOTION))
        if self._senses_acceleration and len(starts):
            blocks["acceleration"][place] = self._accelerate()[0]
            self._step(self._memory, out, 0, 0)

    def _mean(self, torque: str) -> Array:
        """Return the mean of a torque over the physics step, [lanes x 2]."""
        start, half, end = (self._blocks[f"{torque}_{time}"][self._place] for time in ("start", "half", "end"))
        return (start + 4.0 * half + end) / 6.0

    def _numbers(self) -> Array:
        """Return the numbers of each lane's model, [lanes x numbers]."""
        blocks, (row, _, column) = self._blocks, self._place
        parts = [blocks[name].reshape(len(blocks), -1, LANES)[row, :, column] for name in _NUMBERS]
        return np.concatenate(parts, axis=1)

    def _accelerate(self) -> tuple[Array, Array]:
        """Return acceleration and friction torque of each lane now, [lanes x 2] each."""
        torque, load = self._blocks["torque"][self._place], -self._blocks["disturbance"][self._place]
        each = np.array([arm.accelerate(torque[lane], load[lane]) for lane, arm in self._arms.items()])
        return each[:, 0], each[:, 1]

    def truth(self) -> Truth:
        """Return the truth at this instant."""
        truth = super().truth()
        acceleration, friction = self._accelerate()
        leakage = truth.leakage + truth.acceleration - acceleration
        return dataclasses.replace(truth, acceleration=acceleration, friction_torque=friction, leakage=leakage)


class _Arm:
    """MuJoCo's model and state of one lane, from its `_NUMBERS`."""

    def __init__(self, scenario: Scenario, numbers: Array) -> None:
        self._scenario, self.numbers = scenario, numbers
        self._model = mujoco.MjModel.from_xml_string(_describe(scenario, numbers))
        self._data = mujoco.MjData(self._model)
        for warning in self._data.warning:
            warning.number = 1  # MuJoCo writes a file at the first warning of each kind
        # Of each link, the first hinge is the joint or its motor. The next is its spring, if it is
        # elastic. The last is the link's own, if it bends.
        each, elastic = self._model.nv // 2, scenario.joint is not None
        self._joints, self._springs = slice(0, None, each), slice(1, None, each) if elastic else slice(0)
        self._bends = slice(each - 1, None, each) if _plant(scenario).bend is not None else slice(0)
        self._stiffness, self._damping, self._gap = numbers[11:].reshape(3, 2)

    def place(self, position: Array, velocity: Array, motor_position: Array, motor_velocity: Array) -> None:
        """Set the state of the joints, [2] each; links start where their springs carry the load."""
        data, joints, springs, bends = self._data, self._joints, self._springs, self._bends
        data.qpos[joints], data.qvel[joints] = position, velocity
        if self._scenario.joint is not None:
            data.qpos[joints], data.qvel[joints] = motor_position, motor_velocity
            data.qpos[springs], data.qvel[springs] = position - motor_position, velocity - motor_velocity
        for _ in range(3):
            mujoco.mj_forward(self._model, data)
            data.qpos[bends] = -data.qfrc_bias[bends] / self._model.jnt_stiffness[bends]

    def changed(self, numbers: Array) -> _Arm:
        """Return an arm of other numbers in the state of this one."""
        arm = _Arm(self._scenario, numbers)
        arm._data.qpos[:], arm._data.qvel[:] = self._data.qpos, self._data.qvel
        return arm

    def advance(self, velocity: Array, motor_velocity: Array, torque: Array, load: Array, steps: int) -> None:
        """Hold torques for a number of MuJoCo's steps, from these velocities on; [2] each."""
        model, data = self._model, self._data
        if self._scenario.joint is None:
            data.qvel[self._joints] = velocity
        else:
            data.qvel[self._joints], data.qvel[self._springs] = motor_velocity, velocity - motor_velocity
        if not self._gap.any():
            self._push(torque, load)
            mujoco.mj_step(model, data, steps)
            return
        for _ in range(steps):
            self._push(torque, load, 0.5 * model.opt.timestep)
            mujoco.mj_step(model, data)

    def _push(self, torque: Array, load: Array, ahead: float = 0.0) -> None:
        """Apply torques of drives, loads on links, and the difference that a gap makes to springs.

        The stretch of the springs is extrapolated by the time `ahead` [s].
        """
        data, springs = self._data, self._springs
        data.qfrc_applied[self._joints] = torque + load
        if self._scenario.joint is None:
            return
        rate = data.qvel[springs]
        stretch = data.qpos[springs] + ahead * rate
        gap = self._stiffness * np.clip(stretch, -self._gap, self._gap)
        data.qfrc_applied[springs] = load + gap + np.where(np.abs(stretch) < self._gap, self._damping * rate, 0.0)

    def accelerate(self, torque: Array, load: Array) -> tuple[Array, Array]:
        """Return acceleration and friction torque under torques at this instant, [2] each."""
        data, joints, springs = self._data, self._joints, self._springs
        self._push(torque, load)
        mujoco.mj_forward(self._model, data)
        acceleration = data.qacc[joints].copy()
        if self._scenario.joint is not None:
            acceleration += data.qacc[springs]
        return acceleration, -(data.qfrc_passive + data.qfrc_constraint)[joints]

    @property
    def motion(self) -> dict[str, Array]:
        """Return angles [rad] and velocities [rad/s] of joints and motors, [2] each."""
        position, velocity = self._data.qpos[self._joints], self._data.qvel[self._joints]
        if self._scenario.joint is None:
            return {"position": position, "velocity": velocity}
        links = {
            "position": position + self._data.qpos[self._springs],
            "velocity": velocity + self._data.qvel[self._springs],
        }
        return {**links, "motor_position": position, "motor_velocity": velocity}


def _plant(scenario: Scenario) -> MuJoCo:
    assert scenario.plant is not None
    return scenario.plant


def _describe(scenario: Scenario, numbers: Array) -> str:
    """Return the arm in MuJoCo's language: x to the right, y up, hinges about z."""
    plant, (m1, m2, L1, L2, payload), joints = _plant(scenario), numbers[:5], numbers[5:].reshape(6, 2)
    load = f'<body pos="{L2} 0 0">{_mass(payload, 0.0, 0.0)}</body>' if payload > 0 else ""
    second = f'<body pos="{L1} 0 0">{_link(scenario, 1, m2, L2, joints, load)}</body>'
    return f"""
    <mujoco>
      <compiler angle="radian" autolimits="false"/>
      <option timestep="{scenario.physics_dt / plant.substeps}" integrator="{plant.integrator}"
              gravity="0 {-scenario.arm.gravity} 0">
        <flag contact="disable" warmstart="disable" autoreset="disable"/>
      </option>
      <worldbody><body>{_link(scenario, 0, m1, L1, joints, second)}</body></worldbody>
    </mujoco>"""


def _link(scenario: Scenario, joint: int, mass: float, length: float, joints: Array, end: str) -> str:
    """Return the content of a link's body, with the bodies at its end."""
    arm, plant, (viscous, coulomb, stiction, stiffness, damping, _) = scenario.arm, _plant(scenario), joints[:, joint]
    loss = coulomb + stiction if plant.friction == "breakaway" else coulomb
    drive = f'damping="{viscous}" frictionloss="{loss}" armature="{scenario.rotor[joint]}"'
    hinge = f'<joint axis="0 0 1" {drive}/>'
    if scenario.joint is not None:
        hinge = f'<joint axis="0 0 1" {drive} solimpfriction="{_HARD}"/>'
        hinge += f'<joint axis="0 0 1" stiffness="{stiffness}" damping="{damping}"/>'
    centre, inertia = _of(arm.centre, joint) * length, _of(arm.inertia, joint) * mass * length**2
    if plant.bend is None:
        return hinge + _mass(mass, centre, inertia) + end
    # Both halves have the whole link's centre: a link that does not bend is the rigid one.
    half, place = _mass(mass / 2, centre, inertia / 2), _HINGE * length
    rate, moment = 2 * np.pi * _of(plant.bend, joint), _moment_beyond_hinge(arm)[joint]
    stiffness, damping = rate**2 * moment, 2 * plant.bend_damping * rate * moment
    spring = f'<joint axis="0 0 1" pos="{place} 0 0" stiffness="{stiffness}" damping="{damping}"/>'
    return f"{hinge}{half}<body>{spring}{half}{end}</body>"


def _moment_beyond_hinge(arm: ArmParameters) -> tuple[float, float]:
    """Return the moment of inertia that turns on each link's own hinge when the arm is straight."""

    def half(joint: int, mass: float, length: float) -> float:
        return mass / 2 * length**2 * ((_of(arm.centre, joint) - _HINGE) ** 2 + _of(arm.inertia, joint))

    reach = (1 - _HINGE) * arm.L1 + _of(arm.centre, 1) * arm.L2
    first = half(0, arm.m1, arm.L1) + arm.m2 * (reach**2 + _of(arm.inertia, 1) * arm.L2**2)
    return first, half(1, arm.m2, arm.L2)


def _mass(mass: float, centre: float, inertia: float) -> str:
    moment = max(inertia, _POINT_INERTIA)
    return f'<inertial pos="{centre} 0 0" mass="{mass}" diaginertia="{moment} {moment} {moment}"/>'


def _of(pair: Pair | float, joint: int) -> float:
    return pair[joint]  # type: ignore[index]
