"""Records: systems and functions as plain data, from which a run can be repeated."""
