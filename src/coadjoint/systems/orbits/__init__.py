"""Orbits as functions of the time that forces take: Kepler's ellipses, J2 drift, samples, and two-line elements."""
