SETTINGS = {
    ("speed", "nominal"): {"margin": 0.8, "slip_angle": 0.2, "n": 0.3},
    ("speed", "conservative"): {"margin": 0.8, "slip_angle": 0.2},
    ("speed", "aware"): {"margin": 0.8, "slip_angle": 0.2, "z": 1.0},
    ("speed", "oracle"): {"margin": 0.8, "slip_angle": 0.2},
}
