"""Configuration files: parsing, validation, sweeps, dry runs."""
