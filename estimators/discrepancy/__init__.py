"""From measured data to a better model: what the simulation gets wrong, why, and what it gains to mend it."""
