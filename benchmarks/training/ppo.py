"""PPO on batches of arms (proximal policy optimisation, Schulman et al. 2017).

It follows CleanRL's `ppo_continuous_action.py`, with observations in units of their running
standard deviation. The value also sees the real arm, which the policy does not (Pinto et al. 2017,
asymmetric actor critic).
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import nn

from benchmarks.agents.network import Actor
from benchmarks.training.progress import Progress
from benchmarks.training.vec_env import VectorAdapter
from fbl_gym.envs.side_by_side import SideBySideVectorEnv
from fbl_gym.model.arm import Array
from fbl_gym.records.checks import check_number


class PPO:
    """PPO as a learner.

    Args:
        envs: the batches, side by side.
        seed: of the first lane of each batch, and of torch.
        learning_rate: of Adam at the begin; it falls to zero.
        n_steps: of each lane in a rollout.
        batch_size: samples of a gradient step.
        n_epochs: passes over a rollout.
        horizon: time over which the discount of later rewards falls to 1 / e [s], about; more than
            that of a decision.
        gae_lambda: lambda of the generalised advantage estimate.
        clip_range: largest change of an action's probability, as a ratio less 1.
        std: standard deviation of the first actions.
        hidden: sizes of the hidden layers of policy and value.
    """

    def __init__(
        self, envs: Sequence[VectorAdapter], seed: int, *, learning_rate: float, n_steps: int = 16,
        batch_size: int = 2048, n_epochs: int = 4, horizon: float = 0.1, gae_lambda: float = 0.9,
        clip_range: float = 0.2, std: float = 0.5, hidden: Sequence[int] = (64, 64),
    ) -> None:  # fmt: skip
        torch.manual_seed(seed)
        self.steps = 0
        self._arms = _Arms(envs)
        self._now = self._arms.reset(seed)
        lengths = (env.unwrapped.scenario.duration / env.decision for env in envs)  # type: ignore[attr-defined]
        self._episode = round(min(lengths))
        self._rate, self._n_steps, self._batch, self._epochs = learning_rate, n_steps, batch_size, n_epochs
        times = np.repeat([env.decision for env in envs], [env.num_envs for env in envs])
        if not check_number("horizon", horizon, above=0) > times.max():
            least = f"more than the time of a decision (--period, or a step), {times.max():g} s"
            raise ValueError(f"horizon must be {least}, got {horizon:g}: --hyperparameters gives another")
        self._gamma = torch.from_numpy(np.round(1.0 - times / horizon, 9)).float()  # of each lane
        self._lambda, self._clip = float(gae_lambda), float(clip_range)
        self._model = _Model(self._arms.observed, self._now.shape[1], std, hidden)
        self._optimizer = torch.optim.Adam(self._model.parameters(), learning_rate, eps=1e-5, fused=True)

    def actor(self) -> Actor:
        """Return the policy without noise; its first layer scales the observations, too."""
        layers = [module for module in self._model.policy if isinstance(module, nn.Linear)]
        arrays = [[x.detach().numpy().astype(float) for x in (layer.weight, layer.bias)] for layer in layers]
        mean, std = (x[: self._arms.observed].numpy().astype(float) for x in (self._model.mean, self._model.std))
        weight, bias = arrays[0]
        arrays[0] = [weight / std, bias - weight @ (mean / std)]
        return Actor(tuple((weight, bias) for weight, bias in arrays), "tanh", "clip")

    def state(self) -> dict[str, Any]:
        """Return all that `load` needs, as plain data."""
        return {"model": self._model.state_dict(), "optimizer": self._optimizer.state_dict(), "steps": self.steps}

    def load(self, state: dict[str, Any]) -> None:
        """Go on from a state; the batches begin their next episodes."""
        self._model.load_state_dict(state["model"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.steps = state["steps"]
        for _ in range(self.steps // (len(self._now) * self._episode)):
            self._now = self._arms.reset(None)  # skip the episodes that the run has trained on

    def learn(self, progress: Progress) -> None:
        """Train until the run is over."""
        while (fraction := progress.fraction(self.steps)) < 1.0:
            progress.check(self)
            self._optimizer.param_groups[0]["lr"] = self._rate * (1.0 - fraction)
            self._update(*self._rollout())

    @torch.no_grad()
    def _rollout(self) -> tuple[torch.Tensor, ...]:
        """Return observations, actions, log-probabilities, advantages and returns of some steps."""
        shape = self._n_steps, len(self._now)
        x, actions = torch.empty(*shape, self._now.shape[1]), torch.empty(*shape, 2)
        logs, rewards, values, ends = (torch.empty(shape) for _ in range(4))
        for t in range(self._n_steps):
            policy, values[t] = self._model(self._now)
            x[t], actions[t] = self._now, policy.sample()
            logs[t] = policy.log_prob(actions[t]).sum(-1)
            self._now, rewards[t], ends[t], cut, last = self._arms.step(actions[t].numpy())
            if cut.any():  # an episode that ends by time alone would have gone on
                rewards[t, cut] += self._gamma[cut] * self._model(last[cut])[1]
        ahead, advantage, advantages = self._model(self._now)[1], torch.zeros(shape[1]), torch.empty(shape)
        for t in reversed(range(self._n_steps)):
            runs = self._gamma * (1.0 - ends[t])
            advantage = rewards[t] + runs * ahead - values[t] + runs * self._lambda * advantage
            advantages[t], ahead = advantage, values[t]
        self.steps += shape[0] * shape[1]
        return x.flatten(0, 1), *(each.flatten(0, 1) for each in (actions, logs, advantages, advantages + values))

    def _update(self, *data: torch.Tensor) -> None:
        """Improve policy and value by a rollout."""
        for _ in range(self._epochs):
            for part in torch.randperm(len(data[0])).split(self._batch):
                observed, action, log, gain, target = (each[part] for each in data)
                policy, value = self._model(observed)
                ratio = (policy.log_prob(action).sum(-1) - log).exp()
                gain = (gain - gain.mean()) / (gain.std() + 1e-8) if len(part) > 1 else gain
                clipped = ratio.clamp(1.0 - self._clip, 1.0 + self._clip)
                loss = -torch.min(ratio * gain, clipped * gain).mean() + 0.5 * (value - target).square().mean()
                self._optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(self._model.parameters(), 0.5)
                self._optimizer.step()
        self._model.watch(data[0])


class _Model(nn.Module):
    """A Gaussian policy of the first entries of an observation, and a value of all, [n x size]."""

    def __init__(self, observed: int, size: int, std: float, hidden: Sequence[int]) -> None:
        super().__init__()
        self.policy, self.value = _network(observed, hidden, 2, 0.01), _network(size, hidden, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((2,), std).log())
        self._observed, self.count = observed, nn.Buffer(torch.tensor(1e-4))
        self.mean, self.variance = nn.Buffer(torch.zeros(size)), nn.Buffer(torch.ones(size))

    @property
    def std(self) -> torch.Tensor:
        """Standard deviation of the observations, which is 0.01 or more [size]."""
        return (self.variance + 1e-4).sqrt()

    def watch(self, x: torch.Tensor) -> None:
        """Take observations into account."""
        change, count = x.mean(0) - self.mean, self.count + len(x)
        variance = x.var(0, correction=0) + change**2 * self.count / count
        self.variance.lerp_(variance, len(x) / float(count))
        self.mean.add_(change, alpha=len(x) / float(count))
        self.count.fill_(count)

    def forward(self, x: torch.Tensor) -> tuple[torch.distributions.Normal, torch.Tensor]:
        """Return the distribution of actions, and the values [n]."""
        x = (x - self.mean) / self.std
        policy = self.policy(x[:, : self._observed])
        return torch.distributions.Normal(policy, self.log_std.exp(), validate_args=False), self.value(x)[:, 0]


def _network(size: int, hidden: Sequence[int], outputs: int, gain: float) -> nn.Sequential:
    """Return a network whose last layer begins with weights of the size `gain`."""
    modules: list[nn.Module] = []
    for inputs, width in pairwise((size, *hidden, outputs)):
        layer = nn.Linear(inputs, width)
        nn.init.orthogonal_(layer.weight, 2**0.5)
        nn.init.zeros_(layer.bias)
        modules += [layer, nn.Tanh()]
    nn.init.orthogonal_(layer.weight, gain)
    return nn.Sequential(*modules[:-1])


class _Arms:
    """Batches side by side. They observe what the agent does, and then the truth, [n x size]."""

    def __init__(self, envs: Sequence[VectorAdapter]) -> None:
        self._batches: list[Any] = [env.unwrapped for env in envs]
        self._cuts = np.cumsum([env.num_envs for env in envs])[:-1]
        self._facts, self._truth = [np.empty(0)] * len(envs), np.empty(0)
        self._side = SideBySideVectorEnv(*envs)
        self.observed = self._side.single_observation_space.shape[0]  # type: ignore[index]

    def reset(self, seed: int | None) -> torch.Tensor:
        """Start an episode in every lane."""
        return torch.from_numpy(self._see(self._side.reset(seed=seed)[0], np.ones(self._side.num_envs, bool))).float()

    def step(self, actions: Array) -> tuple[torch.Tensor, ...]:
        """Take a step with actions [n x 2].

        Returns:
            Observations, rewards, ends of episodes (1, else 0), True where time alone ended one,
            and the last observations of these.
        """
        observed, rewards, terminated, truncated, infos = self._side.step(actions)
        done, last = np.logical_or(terminated, truncated), np.concatenate([observed, self._truth], axis=1)
        if done.any():
            last[done, : self.observed] = np.stack(infos["final_obs"][done])
        seen = self._see(observed, done), rewards, done, last
        now, reward, end, final = (torch.from_numpy(each).float() for each in seen)
        return now, reward, end, torch.from_numpy(done & np.logical_not(terminated)), final

    def _see(self, observed: Array, begun: Array) -> Array:
        """Return observations and truth; parameters are read where an episode has begun."""
        rows = []
        for i, (env, new) in enumerate(zip(self._batches, np.split(begun, self._cuts), strict=True)):
            if new.any():
                self._facts[i] = _facts(env)
            signals, limit = env.true_signals(), env.interface.torque_scale
            error = np.arcsinh(100.0 * (signals["reference"] - signals["position"]))
            moving = error, signals["disturbance"] / limit, signals["payload"][:, None]
            rows.append(np.concatenate([*moving, self._facts[i]], axis=1))
        self._truth = np.concatenate(rows)
        return np.concatenate([observed, self._truth], axis=1)


def _facts(env: Any) -> Array:
    """Return the parameters of the real arms of a batch, [n x k], as numbers of order one."""
    truth, limit = env.truth, env.interface.torque_scale
    lumped = truth.lumped * (10.0, 10.0, 10.0, 1.0, 1.0) / limit[[0, 0, 1, 0, 1]]
    times = 20.0 * np.stack([truth.delay, truth.lag], axis=1)
    friction = [each / limit for each in (truth.viscous, truth.coulomb, truth.stiction)]
    strength = np.where(np.isfinite(limit), limit, 0.0)
    twist = 100.0 * strength / np.maximum(truth.stiffness, 1e-9) * (truth.stiffness > 0)
    return np.concatenate([lumped, times, *friction, truth.load_friction, truth.gain, twist], axis=1)
