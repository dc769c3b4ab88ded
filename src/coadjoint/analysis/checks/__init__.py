"""Checks of a certificate, one file for each kind."""
