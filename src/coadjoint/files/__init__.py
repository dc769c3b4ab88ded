"""Configuration files, records of runs, archives, and their file formats."""
