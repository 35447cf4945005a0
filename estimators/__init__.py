"""Terrain estimation: filters, their references, and measured data against the model."""
