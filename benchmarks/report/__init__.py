"""Presentation of stored results: terminal, Markdown, CSV, one HTML page, plots and films.

Only films simulate.
"""
