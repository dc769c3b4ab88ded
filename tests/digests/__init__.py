"""Digests of the bits of runs, and systems, schemes and measures that tests of accuracy share."""
