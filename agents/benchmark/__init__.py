"""Arms on paired episodes, and what may be said about them."""
