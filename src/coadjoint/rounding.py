"""What does rounding to float64 cost?"""

UNIT_ROUNDOFF = 2.0**-53
"""Half of the distance from 1 to the next number: the largest relative error of one rounding."""
