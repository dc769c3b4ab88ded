"""Casimir shifts: H - c C, and the motion of the group element that they subtract."""
