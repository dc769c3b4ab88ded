"""Analysis of schemes and runs: modified equations, frequencies, phase errors, round-off, certificates."""
