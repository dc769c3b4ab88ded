"""Drawn runs of every registered scheme on every registered system, with options, and what they are compared with."""
