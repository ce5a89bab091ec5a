"""Identification: from the log of a robot to a scenario, with the uncertainty of its numbers."""
