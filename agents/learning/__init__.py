"""Training policies, and the policies that are shipped."""
