"""With which scheme and step? The least work for a wanted error, found by short runs from the start."""
