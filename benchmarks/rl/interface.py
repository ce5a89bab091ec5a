"""What an agent sees and what its actions mean, in training and after: the same code serves both."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space

import controllers
from controllers.feedback_linearization import linearize
from controllers.policy import State, TorqueLaw
from fbl_gym.arm import Array
from fbl_gym.batch import Truth
from fbl_gym.checks import check_choice, check_number, check_pair, check_whole
from fbl_gym.interface import Interface, Layout
from fbl_gym.records import set_fields
from fbl_gym.wrappers import ErrorScales

ACTIONS = ("torque", "acceleration", "residual")
SENSORS = ("position", "velocity", "acceleration")
CONTEXT = ("m1", "m2", "L1", "L2", "payload")
"""What an agent with context is told, in this order."""
_SEEN = (*SENSORS, *(f"reference_{name}" for name in SENSORS))


@dataclass(frozen=True)
class AgentInterface:
    """What an agent sees and does, as plain data.

    It sees tracking errors at a fixed scale (`fbl_gym.wrappers.ErrorScales`), now and for `history` steps back, the latest
    first, each of those with the action that followed it; zeros before an episode's start. With `context` it is told the
    true parameters too. It acts in [-1, 1].

    Args:
        action: "torque": a share of `torque`. "acceleration": a share of `acceleration`, through the nominal feedback
            linearisation mapping. "residual": a share `residual` of `torque`, on top of the torque of `base`.
        torque: per joint [N m].
        acceleration: of both joints [rad/s^2].
        residual: reach of the residual.
        base: the policy under the residual.
        gains: its gains, spelt out, so that an agent keeps the base that it was trained on.
        history: how many earlier steps are seen.
        context: whether the true parameters are seen, see `true_parameters`; that makes it an agent of the privileged access.
        scales: of the errors of position [rad], velocity [rad/s] and acceleration [rad/s^2].
    """

    action: str = "torque"
    torque: tuple[float, float] = (2000.0, 800.0)
    acceleration: float = 100.0
    residual: float = 0.5
    base: str = "cascade-flm"
    gains: Mapping[str, Any] = field(
        default_factory=lambda: {"kp": 10.0, "velocity_p": (30.0, 35.0), "velocity_i": (13.0, 20.0)}
    )
    history: int = 0
    context: bool = False
    scales: tuple[float, float, float] = (0.1, 1.0, 10.0)

    def __post_init__(self) -> None:
        if not isinstance(self.context, bool):
            raise ValueError(f"context must be True or False, got {self.context!r}")
        set_fields(
            self,
            action=check_choice("action", self.action, ACTIONS),
            torque=check_pair("torque", self.torque, above=0),
            acceleration=check_number("acceleration", self.acceleration, above=0),
            residual=check_number("residual", self.residual, above=0),
            base=check_choice("base", self.base, controllers.names()),
            gains={name: tuple(gain) if isinstance(gain, list) else gain for name, gain in self.gains.items()},
            history=check_whole("history", self.history),
            scales=tuple(check_number("scale", scale, above=0) for scale in self.scales),
        )


def true_parameters(truth: Truth, interface: Interface) -> Array:
    """The true parameters as an agent with context is told them, [n x 5], cut to [-10, 10] as errors are.

    log(real / nominal) of m1, m2, L1 and L2, and the payload carried now as a share of the nominal m2.
    """
    nominal = interface.nominal
    real = np.concatenate([np.atleast_2d(truth.masses), np.atleast_2d(truth.lengths)], axis=-1)
    ratios = real / np.array([nominal.m1, nominal.m2, nominal.L1, nominal.L2])
    payload = np.reshape(truth.payload, (-1, 1)) / nominal.m2
    return np.clip(np.concatenate([np.log(ratios), payload], axis=-1), -10.0, 10.0)


class Body:
    """An `AgentInterface` joined to an environment's `Interface`. A state is a tuple of arrays with a row for each lane.

    Args:
        agent: what the agent sees and does.
        interface: of the environment; what it observes beyond the three sensors and the reference is left out.
    """

    def __init__(self, agent: AgentInterface, interface: Interface) -> None:
        self.agent, self.interface = agent, interface
        layout = Layout(tuple(slot for slot in interface.layout.slots if slot.name in _SEEN))
        self._errors = ErrorScales(dataclasses.replace(interface, layout=layout), *agent.scales)
        self._frame = self._errors.size + 2
        self.size = self._errors.size + agent.history * self._frame + (len(CONTEXT) if agent.context else 0)
        self._base: TorqueLaw | None = None
        if agent.action == "residual":
            base = controllers.make(agent.base, interface, **agent.gains)
            if not isinstance(base, TorqueLaw):
                raise ValueError(f"base must be a torque law, got {agent.base!r}")
            self._base = base

    def initial(self, observation: Array) -> State:
        """The state at an episode's start.  observation: [n x size of the environment's layout]."""
        past = np.zeros((len(observation), self.agent.history * self._frame))
        return (past, *(() if self._base is None else self._base.initial(observation)))

    def told(self, env: Any, lanes: int) -> Array:
        """What the agent is told of the truth now: [n x 5], or [n x 0] without context.

        Args:
            env: whose truth that is, single or batched; without context, nobody looks at it.
            lanes: n.
        """
        if not self.agent.context:
            return np.empty((lanes, 0))
        found = true_parameters(env.unwrapped.truth, self.interface)
        if len(found) != lanes:
            raise ValueError(
                f"the agent was made for an environment of {len(found)} lanes, whose truth it is told, "
                f"got {lanes} observations"
            )
        return found

    def see(self, observation: Array, state: State, told: Array) -> Array:
        """What the agent sees, [n x size]."""
        return np.concatenate([self._errors(observation), state[0], told], axis=-1)

    def torque(self, action: Array, observation: Array, state: State) -> tuple[Array, State]:
        """The torque [n x 2] N m that the agent's action [n x 2] means, and the next state."""
        action = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        past, base = state[0], state[1:]
        if self.agent.history:
            past = np.concatenate([self._errors(observation), action, past[:, : -self._frame]], axis=-1)
        if self.agent.action == "acceleration":
            q, v = (observation[:, self.interface.layout[name]] for name in ("position", "velocity"))
            return linearize(self.interface.nominal, q, v, self.agent.acceleration * action), (past,)
        limit = np.array(self.agent.torque)
        if self._base is None:
            return limit * action, (past,)
        torque, base = self._base.torque(observation, base)
        return self.interface.saturate(torque) + self.agent.residual * limit * action, (past, *base)


class VectorBody(VectorWrapper):
    """A batched environment as the agent knows it.

    Args:
        env: a `TwoLinkArmVectorEnv` in SAME_STEP mode, unwrapped.
        agent: what the agent sees and does.
    """

    def __init__(self, env: VectorEnv, agent: AgentInterface) -> None:
        super().__init__(env)
        mode = env.metadata["autoreset_mode"]
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f'env must be made with autoreset_mode="SameStep", got {mode.value!r}')
        self._interface: Interface = env.unwrapped.interface  # type: ignore[attr-defined]
        self._body = Body(agent, self._interface)
        self.single_observation_space = spaces.Box(-10.0, 10.0, (self._body.size,), dtype=np.float64)
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), dtype=np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        self._observation, infos = self.env.reset(seed=seed, options=options)
        self._state = self._body.initial(self._observation)
        return self._see(), infos

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        torque, state = self._body.torque(actions, self._observation, self._state)
        q, v = (self._observation[:, self._interface.layout[name]] for name in ("position", "velocity"))
        self._observation, rewards, terminated, truncated, infos = self.env.step(
            self._interface.action_from_torque(torque, q, v)
        )
        if "final_obs" in infos:
            done, final = infos["_final_obs"], infos["final_obs"]
            for lane in np.flatnonzero(done):
                # The truth is the next episode's by now, so a last observation is told what held one step before.
                row, told = tuple(part[lane : lane + 1] for part in state), self._told[lane : lane + 1]
                final[lane] = self._body.see(final[lane][None], row, told)[0]
            fresh = self._body.initial(self._observation)
            state = tuple(
                np.where(done.reshape(-1, *[1] * (old.ndim - 1)), new, old)
                for new, old in zip(fresh, state, strict=True)
            )
        self._state = state
        return self._see(), rewards, terminated, truncated, infos

    def _see(self) -> Array:
        self._told = self._body.told(self.env, self.num_envs)
        return self._body.see(self._observation, self._state, self._told)
