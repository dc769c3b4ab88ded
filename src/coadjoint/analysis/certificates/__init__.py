"""Certificates: checks of the claims of a scheme."""
