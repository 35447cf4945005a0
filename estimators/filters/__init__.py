"""Filters for the soil and the vehicle's state, off board and on board."""
