"""Measure how much of an arm's next motion an observation leaves open.

    python examples/markov.py servo-practice-nominal

A network predicts the change of the true velocity over the next step from the observation, the
action, and the earlier observations. It prints the share of the variance that it does not explain,
on arms of other seeds. The arms follow a law with noise on its actions. The last column also has
the context: the true numbers of each arm.
"""

import argparse

import numpy as np
import torch
from torch import nn

import controllers
from fbl_gym import TwoLinkArmTrackingVectorEnv, TwoLinkArmVectorEnv

parser = argparse.ArgumentParser()
parser.add_argument("scenarios", nargs="+")
parser.add_argument("--lanes", type=int, default=256, help="arms, half of them for the test")
parser.add_argument("--epochs", type=int, default=30)
parser.add_argument("--law", default="computed-torque@tuned")
arguments = parser.parse_args()
HISTORIES, LANES = (1, 4, 16), arguments.lanes


def transitions(scenario):
    """Return observations, contexts, actions and changes of velocity, [steps x lanes x ...]."""
    # Equal seeds and actions make equal motions: the law observes one batch, the network another.
    options = {"scenario": scenario, "limits": {"error": None}}
    arms = TwoLinkArmVectorEnv(LANES, **options)
    agents = TwoLinkArmTrackingVectorEnv(LANES, **options, fine=(0.002, 0.05), history=max(HISTORIES) - 1, context=True)
    law, noise, state, rows = controllers.make(arguments.law, arms), np.random.default_rng(0), None, []
    (seen, _), (observation, infos) = arms.reset(seed=0), agents.reset(seed=0)
    for _ in range(min(arms.scenario.steps, 400) - 1):
        action, state = law.predict(seen, state)
        action = np.clip(action + 0.2 * noise.standard_normal((LANES, 2)), -1.0, 1.0)
        before = arms.truth.velocity
        seen, observed = arms.step(action)[0], agents.step(action)[0]
        rows.append((observation, infos["context"], action, arms.truth.velocity - before))
        observation = observed
    return [torch.tensor(np.array(values), dtype=torch.float32)[max(HISTORIES) :] for values in zip(*rows, strict=True)]


def unexplained(x, y):
    """Return the share of the variance of y that a network of x does not explain, on other arms."""
    half = LANES // 2
    (x, test), (y, goal) = ((z[:, :half].flatten(0, 1), z[:, half:].flatten(0, 1)) for z in (x, y))
    mean, scale = x.mean(dim=0), x.std(dim=0) + 1e-6
    network = nn.Sequential(
        nn.Linear(x.shape[1], 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, y.shape[1])
    )
    optimizer = torch.optim.Adam(network.parameters(), 3e-3)
    batches = len(x) // 1024 + 1
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 3e-3, total_steps=arguments.epochs * batches)
    for _ in range(arguments.epochs):
        for rows in torch.randperm(len(x)).chunk(batches):
            loss = (network((x[rows] - mean) / scale) - y[rows] / y.std(dim=0)).square().mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    with torch.no_grad():
        error = network((test - mean) / scale) * y.std(dim=0) - goal
    return float((error.square().mean(dim=0) / goal.var(dim=0)).mean())


torch.manual_seed(0)
torch.set_num_threads(1)
print(f"{'unexplained with samples':<30}" + "".join(f"{n:>8}" for n in HISTORIES) + f"{'context':>9}")
for scenario in arguments.scenarios:
    observations, context, actions, change = transitions(scenario)
    size = observations.shape[-1] // max(HISTORIES)
    inputs = [torch.cat([observations[..., -n * size :], actions], dim=-1) for n in HISTORIES]
    shares = [unexplained(x, change) for x in (*inputs, torch.cat([inputs[-1], context], dim=-1))]
    print(f"{scenario:<30}" + "".join(f"{share:>8.3f}" for share in shares[:-1]) + f"{shares[-1]:>9.3f}", flush=True)
