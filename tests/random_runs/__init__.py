"""Random runs from seeds."""
