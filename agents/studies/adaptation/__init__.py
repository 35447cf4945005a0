"""Prediction on unseen soils after a few seconds: physical and learned models."""
