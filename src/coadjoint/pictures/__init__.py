"""Matplotlib figures and movies of runs; nothing is shown, and no global state is changed."""
