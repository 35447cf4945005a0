"""Single-wheel rigs: measured trials against predictions."""
