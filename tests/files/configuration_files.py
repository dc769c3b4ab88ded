"""Configuration files of a ready-made system, of an algebra of its own, and of a motion that overflows."""

READY_MADE = """
[system]
name = "rigid_body"
[system.parameters]
inertia = [1.0, 2.0, 2.5]
[initial]
x = [1.0, 0.1, 0.5]
[method]
name = "Splitting"
order = 4
[run]
t_span = [0, 1]
step = 0.1
"""

OWN = """
name = "mine"
sign = -1
[algebra]
dim = 3
brackets = ["[e1, e2] = e3", "[e2, e3] = e1", "[e3, e1] = e2"]
[hamiltonian]
M = [1.0, 0.5, 0.25]
[casimirs]
"|x|^2" = "x1^2 + x2^2 + x3^2"
[initial]
x = [1.0, 0.1, 0.5]
[run]
t_span = [0.0, 1.0]
step = 0.1
"""

# [e1, e2] = e2 with H = x1 gives x2' = x2, which overflows at t = 709.78.
GROWING = """
sign = -1
[algebra]
dim = 2
brackets = ["[e1, e2] = e2"]
[hamiltonian]
linear = [1.0, 0.0]
[initial]
x = [1.0, 1.0]
[run]
t_span = [0.0, 1000.0]
step = 1.0
save_every = 100
"""
