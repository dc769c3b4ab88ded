"""For how long, and saved where? Integration, solutions, steppers, configuration files."""
