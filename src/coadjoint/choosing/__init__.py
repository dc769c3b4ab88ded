"""Choice of a scheme and a step: least work for a given accuracy, by short trial runs from the initial state."""
