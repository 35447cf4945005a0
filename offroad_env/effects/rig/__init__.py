"""Errors of the gauges on a wheel rig."""
