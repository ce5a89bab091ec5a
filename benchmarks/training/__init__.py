"""Training agents with stable-baselines3 on a batch of arms."""
