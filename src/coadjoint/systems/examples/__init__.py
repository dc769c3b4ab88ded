"""Ready-made systems: examples of other brackets and Hamiltonians."""
