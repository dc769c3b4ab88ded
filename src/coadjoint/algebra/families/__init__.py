"""Families of Lie algebras, and constructions of new ones."""
