"""Polynomials in the momenta: arithmetic, parsing, formatting, evaluation."""
