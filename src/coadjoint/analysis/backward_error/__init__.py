"""Backward error analysis: modified Hamiltonians and fields."""
