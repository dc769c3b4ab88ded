"""Ready-made systems: fluids and plasmas."""
