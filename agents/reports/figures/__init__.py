"""Figures: functions that turn results into matplotlib figures, without pyplot or files."""
