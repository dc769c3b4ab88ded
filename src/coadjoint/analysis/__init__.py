"""What is it worth? Orders, defects and phase errors of what was computed."""
