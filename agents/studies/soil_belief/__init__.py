"""The online belief over whole soils on simulated drives."""
