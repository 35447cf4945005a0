"""Checks of a fitted model: whiteness, open-loop prediction, hold-out gain, unmodelled forces, profiles."""
