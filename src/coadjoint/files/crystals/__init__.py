"""Crystals from files: CIF and POSCAR."""
