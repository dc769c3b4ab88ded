"""Saved where, read from what? Configuration files, records of runs, and the files that hold them."""
