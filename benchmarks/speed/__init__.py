"""Speed of the environments, measured beside other environments.

Machines drift, so contestants take turns in the rounds of one run, and results are ratios
of medians over the rounds.
"""
