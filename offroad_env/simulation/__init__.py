"""Plants that move: single wheels, vehicles, fleets, and the sensors on them."""
