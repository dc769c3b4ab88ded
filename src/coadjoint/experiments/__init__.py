"""Reproduced experiments of the literature, and the self-test of the installed package."""
