"""Unit round-off of float64."""

UNIT_ROUNDOFF = 2.0**-53
"""Half the spacing of floats above 1: the largest relative error of one rounding."""
