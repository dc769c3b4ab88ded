"""Ready-made systems: rigid bodies, tops, satellites, pendulums."""
