"""Systems whose state is a matrix."""
