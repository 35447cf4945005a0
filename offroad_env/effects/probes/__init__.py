"""Unnamed forces and torques: no causes, but tests of each equation of motion."""
