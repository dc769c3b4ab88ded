"""How fast? The only compiled code: block actions, the loops over steps, saving, watching, members."""
