"""Engines other than the package's own kernel."""
