"""PPO on a batch of arms, in one file: copy it and change it.

    python examples/ppo_batch.py --threads 2
    python examples/ppo_batch.py --device cuda --lanes 4096 --minibatch 16384

It evaluates on a scenario and seeds that the training does not use, and prints the mean absolute
error of both joints. It follows CleanRL's `ppo_continuous_action.py`.
"""

import argparse
import time

import numpy as np
import torch
from torch import nn

from fbl_gym import TwoLinkArmTrackingVectorEnv

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
add = parser.add_argument
add("--scenario", default="servo-practice-nominal", help="to train on")
add("--test", default="servo-nominal", help="scenario to evaluate on")
add("--seed", type=int, default=0, help="of the training")
add("--device", choices=["cpu", "cuda"], default="cpu", help="of the arms and the networks")
add("--threads", type=int, help="of the environment, None: all cores; PyTorch has one")
add("--updates", type=int, default=100, help="number of rollouts, each followed by an update")
add("--lanes", type=int, default=512, help="number of arms")
add("--steps", type=int, default=16, help="of an arm in a rollout")
add("--epochs", type=int, default=4, help="passes over a rollout")
add("--minibatch", type=int, default=2048, help="samples of a gradient step")
add("--rate", type=float, default=3e-3, help="learning rate at the begin; it falls to zero")
add("--discount", type=float, default=0.95, help="of a reward one step later")
add("--trace", type=float, default=0.9, help="lambda of the generalised advantage estimate")
add("--clip", type=float, default=0.2, help="largest change of an action's probability, as a ratio less 1")
add("--std", type=float, default=0.5, help="standard deviation of the first actions")


class Scale(nn.Module):
    """Observations less their running mean, in units of their running standard deviation."""

    def __init__(self, size: int) -> None:
        super().__init__()
        for name, value in (("mean", torch.zeros(size)), ("variance", torch.ones(size)), ("count", torch.tensor(1e-4))):
            self.register_buffer(name, value)

    def update(self, x: torch.Tensor) -> None:
        """Take observations [n x size] into account."""
        change, count = x.mean(0) - self.mean, self.count + len(x)
        self.variance += ((x.var(0, correction=0) - self.variance) + change**2 * self.count / count) * len(x) / count
        self.mean += change * len(x) / count
        self.count.fill_(count)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return scaled observations."""
        return ((x - self.mean) / (self.variance + 1e-8).sqrt()).clamp(-10.0, 10.0)


class Agent(nn.Module):
    """A Gaussian policy and a value, each a network of two hidden layers."""

    def __init__(self, size: int, std: float) -> None:
        super().__init__()
        self.scale = Scale(size)
        self.mean, self.value = network(size, 2, 0.01), network(size, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((2,), std).log())

    def forward(self, x: torch.Tensor) -> tuple[torch.distributions.Normal, torch.Tensor]:
        """Return the distribution of actions and the value of observations [n x size]."""
        x = self.scale(x)
        return torch.distributions.Normal(self.mean(x), self.log_std.exp(), validate_args=False), self.value(x).squeeze(
            -1
        )


def network(size: int, outputs: int, gain: float) -> nn.Sequential:
    """Return a network whose last layer begins with weights of the size `gain`."""
    layers = [nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)]
    for layer, factor in zip(layers[::2], (2**0.5, 2**0.5, gain), strict=True):
        nn.init.orthogonal_(layer.weight, factor)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


def train(args: argparse.Namespace) -> Agent:
    """Return a trained agent."""
    torch.manual_seed(args.seed)
    options = {"autoreset_mode": "SameStep", "threads": args.threads, "device": args.device}
    env = TwoLinkArmTrackingVectorEnv(args.lanes, args.scenario, **options)
    agent = Agent(env.single_observation_space.shape[0], args.std).to(args.device)
    optimizer = torch.optim.Adam(agent.parameters(), args.rate, eps=1e-5, fused=True)
    now = torch.as_tensor(env.reset(seed=1_000_000 * (args.seed + 1))[0])  # evaluation has the seeds from 0 on
    shape, on = (args.steps, args.lanes), {"device": args.device}
    x, actions = torch.empty(*shape, now.shape[1], **on), torch.empty(*shape, 2, **on)
    logs, rewards, values, ends, advantages = (torch.empty(shape, **on) for _ in range(5))
    for update in range(args.updates):
        optimizer.param_groups[0]["lr"] = args.rate * (1.0 - update / args.updates)
        with torch.no_grad():
            for t in range(args.steps):
                policy, values[t] = agent(now)
                x[t], actions[t] = now, policy.sample()
                logs[t] = policy.log_prob(actions[t]).sum(-1)
                *results, infos = env.step(actions[t])
                now, rewards[t], terminated, truncated = map(torch.as_tensor, results)
                ends[t], cut = terminated | truncated, truncated & ~terminated
                if cut.any():  # an episode that ends by time alone would have gone on
                    last = infos["final_obs"][cut if args.device == "cuda" else cut.numpy()]
                    rewards[t, cut] += args.discount * agent(torch.stack([*map(torch.as_tensor, last)]))[1]
            ahead, advantage = agent(now)[1], torch.zeros(args.lanes, **on)
            for t in reversed(range(args.steps)):
                runs = args.discount * (1.0 - ends[t])
                advantage = rewards[t] + runs * ahead - values[t] + runs * args.trace * advantage
                advantages[t], ahead = advantage, values[t]
        data = [each.flatten(0, 1) for each in (x, actions, logs, advantages, advantages + values)]
        for _ in range(args.epochs):
            for part in torch.randperm(args.steps * args.lanes, **on).split(args.minibatch):
                observed, action, log, gain, target = (each[part] for each in data)
                policy, value = agent(observed)
                ratio = (policy.log_prob(action).sum(-1) - log).exp()
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                clipped = ratio.clamp(1.0 - args.clip, 1.0 + args.clip)
                loss = -torch.min(ratio * gain, clipped * gain).mean() + 0.5 * (value - target).square().mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()
        agent.scale.update(data[0])
    return agent


@torch.no_grad()
def evaluate(agent: Agent, scenario: str, seeds: int = 32) -> tuple[float, int]:
    """Return the mean absolute error [mrad] over whole episodes, and how many arms diverged."""
    env = TwoLinkArmTrackingVectorEnv(seeds, scenario, info=True, autoreset_mode="SameStep")
    observations, errors, diverged = env.reset(seed=0)[0], [], np.zeros(seeds, dtype=bool)
    for _ in range(env.scenario.steps - 1):
        action = agent.cpu()(torch.from_numpy(observations))[0].mean
        observations, _, terminated, _, infos = env.step(action.numpy())
        diverged |= terminated
        errors.append(np.abs(infos["tracking_error"]).mean())
    return 1e3 * float(np.mean(errors)), int(diverged.sum())


if __name__ == "__main__":
    arguments = parser.parse_args()
    torch.set_num_threads(1)  # small networks learn fastest so
    begin = time.perf_counter(), time.process_time()
    trained = train(arguments)
    seconds, busy = time.perf_counter() - begin[0], time.process_time() - begin[1]
    steps = arguments.updates * arguments.lanes * arguments.steps
    error, lost = evaluate(trained, arguments.test)
    print(f"{steps:,} steps in {seconds:.1f} s, {busy:.1f} of a processor", end=": ")
    print(f"error {error:.2f} mrad, {lost} of 32 arms diverged")
