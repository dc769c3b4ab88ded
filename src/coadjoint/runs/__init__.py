"""For how long? Integration, prepared runs, solutions, steppers."""
