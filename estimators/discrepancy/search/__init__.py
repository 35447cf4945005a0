"""The search for causes: score tests, pairs, stepwise selection, hold-out tests."""
