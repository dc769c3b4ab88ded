"""Functions of the user that compiled code calls by address, their compilation, and digests of what they read."""
