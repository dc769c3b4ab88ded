"""Closed-form solutions, and functions that they need."""
