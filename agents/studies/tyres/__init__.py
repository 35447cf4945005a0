"""The flexible tyre against published numbers: stiffness, ruts, resistance, pull over inflation pressure."""
