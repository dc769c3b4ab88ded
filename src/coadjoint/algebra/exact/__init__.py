"""Exact and numerical linear algebra: numbers, ranks, kernels, sparse sums."""
