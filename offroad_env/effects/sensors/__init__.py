"""Errors of the sensors on a vehicle."""
