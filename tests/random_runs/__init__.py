"""Random runs from seeds, and comparisons that must preserve their bits."""
