"""Tuning of gains with Optuna."""
