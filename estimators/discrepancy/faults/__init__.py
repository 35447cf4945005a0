"""Simulated drives and trials with known faults, implemented independently of the effects."""
