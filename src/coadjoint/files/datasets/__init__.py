"""Solutions as xarray datasets, and their files."""
