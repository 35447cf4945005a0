"""Delays, scales and offsets between a command and the vehicle."""
