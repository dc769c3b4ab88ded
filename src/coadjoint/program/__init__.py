"""Splittings as tables of elementary flows: parts, generators, rows, and a reference interpreter."""
