"""Trained agents as policies.

An agent is made of an adapter and an actor network. The adapter turns the environment's observation
into the agent's, and the agent's action into a torque. Training and evaluation use the same
adapter.

    adapter.py, network.py, agent.py    an agent as a policy, and its folder
    policy.py                           the shipped agents
    sb3.py                              classes and archives of stable-baselines3
"""
