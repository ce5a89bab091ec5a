"""Untrained agents for tests."""

import numpy as np

from benchmarks.agents.adapter import AgentAdapter
from benchmarks.agents.network import Actor

PAYLOAD_OPTIONS = {
    "scenario": "everything-2",
    "duration": 0.3,
    "parameter_error": {"radius": 0.5, "payload": {"mass": 10.0, "pick_up": 0.1, "drop": 0.2}},
}
"""Short episodes in which a payload is picked up and dropped."""


def random_actor(settings, interface, seed=0):
    """Return a network with random weights for an adapter."""
    rng, size = np.random.default_rng(seed), AgentAdapter(settings, interface).size
    layers = ((rng.normal(0, 0.3, (8, size)), rng.normal(0, 0.1, 8)), (rng.normal(0, 0.3, (2, 8)), np.zeros(2)))
    return Actor(tuple((np.float32(w).astype(float), np.float32(b).astype(float)) for w, b in layers), "tanh", "clip")
