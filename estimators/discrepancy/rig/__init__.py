"""Fit and search for trials of a wheel rig."""
