"""Saved where, read from what? Configuration files, formulas, records of runs, and the files that hold them."""
