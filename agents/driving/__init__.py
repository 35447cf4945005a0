"""Episodes driven, recorded and drawn."""
