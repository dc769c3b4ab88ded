"""Casimirs and other invariants: polynomial, rational, logarithmic."""
