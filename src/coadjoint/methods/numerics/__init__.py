"""Numerical building blocks of schemes: coefficients, stages, solvers, projections."""
