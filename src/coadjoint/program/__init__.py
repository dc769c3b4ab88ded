"""As which elementary flows? Parts, generators, the table of rows, and its plain reading in any number type."""
