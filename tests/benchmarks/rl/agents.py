"""Untrained agents for tests, arms to train on, and mistakes."""

import tomllib
from pathlib import Path

import numpy as np

from benchmarks.agents.adapter import AgentAdapter
from benchmarks.agents.network import Actor
from benchmarks.training.vec_env import VectorAdapter
from fbl_gym import TwoLinkArmVectorEnv

MISTAKES = tomllib.loads(Path(__file__).with_name("mistakes.toml").read_text(encoding="utf-8"))


def batch(lanes, settings, scenario=None, **options):
    """Return a batch of arms with an agent's view of it."""
    return VectorAdapter(TwoLinkArmVectorEnv(lanes, scenario, autoreset_mode="SameStep", **options), settings)


def random_actor(settings, interface, seed=0):
    """Return a network with random weights for an adapter."""
    rng, size = np.random.default_rng(seed), AgentAdapter(settings, interface).size
    layers = ((rng.normal(0, 0.3, (8, size)), rng.normal(0, 0.1, 8)), (rng.normal(0, 0.3, (2, 8)), np.zeros(2)))
    return Actor(tuple((np.float32(w).astype(float), np.float32(b).astype(float)) for w, b in layers), "tanh", "clip")
