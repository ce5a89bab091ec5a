"""Runs: cells as data, the closed loop, metrics of a trace, and the store of results."""
