"""What a filter is measured against: bounds, consistency, scores."""
