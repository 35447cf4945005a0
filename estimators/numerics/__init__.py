"""Numerical tools that filters share."""
