"""What does it look like? Matplotlib figures of runs; nothing is shown, no global state is touched."""
