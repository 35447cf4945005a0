"""Process and measurement models of the filters."""
