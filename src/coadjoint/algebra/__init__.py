"""Lie algebras: structure constants, brackets, the matrix J(x), Casimirs, representations, the catalogue."""
