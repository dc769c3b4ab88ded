"""Rounding of double precision, for derived tolerances."""

UNIT_ROUNDOFF = 2.0**-53
"""Largest relative error of a rounded number."""
