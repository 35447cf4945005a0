"""Forces and suspension that the vehicle model lacks, and its uncertain masses."""
