"""One kind of picture in each file: what it shows of a run."""
