"""Ready-made systems: spin and Toda lattices."""
