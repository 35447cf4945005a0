"""The parts of the demo's page: each runs something, draws it, and says in one sentence what came out."""
