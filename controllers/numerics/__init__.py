"""Compiled mathematics that laws share."""
