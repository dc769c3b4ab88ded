"""Derivatives of whole runs."""
