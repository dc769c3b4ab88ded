"""Kinds of pictures of runs, one in each file."""
