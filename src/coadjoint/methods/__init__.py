"""By which scheme? Each one a small frozen dataclass: its coefficients and what it declares to keep."""
