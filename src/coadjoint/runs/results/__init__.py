"""What a run returns: solutions over their records, observed quantities, states at other times."""
