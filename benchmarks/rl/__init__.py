"""Reinforcement learning: training with stable-baselines3, and trained agents as policies in NumPy.

An agent is made of an adapter and an actor network. The adapter turns the environment's observation into the
agent's, and the agent's action into a torque; training and evaluation use the same one.
"""
