"""Integration, prepared runs, solutions, steppers, events."""
