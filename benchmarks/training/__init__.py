"""Training of agents on a batch of arms, by PPO or with stable-baselines3."""
