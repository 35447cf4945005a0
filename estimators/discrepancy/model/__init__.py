"""The model that a diagnosis fits to measured runs, and its noise."""
