"""Location of events within steps, runs with events, and sections."""
