"""Terms of the modified Hamiltonian of splittings and compositions."""
