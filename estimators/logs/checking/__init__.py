"""Findings about a log all at once, each with the line of its YAML that mends it."""
