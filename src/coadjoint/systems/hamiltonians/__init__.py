"""Hamiltonians: quadratic, polynomial, separable, split, driven, and sums of them."""
