"""Simulated experiments on filters: the paper's, and those that go on from it."""
