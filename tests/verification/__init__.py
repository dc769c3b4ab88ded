"""Numerical verification: each lemma, remark and example of the paper, and every property that a scheme declares."""
