"""What exists before anything moves: soils, vehicles, terrain, paths, measured data sets."""
