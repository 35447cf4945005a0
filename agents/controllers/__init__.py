"""Controllers: steering, speed, the tasks' own, and the benchmark's arms."""
