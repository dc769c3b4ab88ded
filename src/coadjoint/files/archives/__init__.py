"""Archives: runs and ensembles in Zarr stores that survive interruption."""
