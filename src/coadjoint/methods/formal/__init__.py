"""Evaluation of schemes in formal power series."""
