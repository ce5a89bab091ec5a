"""Benchmarks of policies: runs, analysis, reports, the paper's claims, and the command line."""
