"""Controllers, policies, the benchmark and the command line."""
