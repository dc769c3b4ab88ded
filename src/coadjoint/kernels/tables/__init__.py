"""Tables that the compiled loops read: C structures of arrays, and the functions that they call by address."""
