"""Output files: atomic replacement, validation, movies."""
