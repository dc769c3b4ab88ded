"""Parts: decompositions of a Hamiltonian into pieces with exact flows."""
