"""Reinforcement learning: the adapter for stable-baselines3, training, and the agents that are shipped."""
