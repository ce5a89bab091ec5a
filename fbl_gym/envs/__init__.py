"""Gymnasium's interfaces: one arm, a batch of arms, MuJoCo's physics, observations for agents."""
