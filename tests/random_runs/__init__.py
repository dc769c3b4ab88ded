"""Random systems, schemes and crowds, each made again from its seed, and what must not change their bits."""
