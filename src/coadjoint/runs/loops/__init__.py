"""Compiled loops of a run: members assigned to tables and to threads."""
