"""Structure-preserving integration of Lie-Poisson systems, generalized Euler equations x' = J(x) grad H(x).

A system combines a Lie algebra, of any finite dimension, and a Hamiltonian; `integrate` runs it with a scheme:

>>> import coadjoint as co
>>> body = co.systems.rigid_body(inertia=(1, 2, 3))
>>> sol = co.integrate(body, (0.1, 1.0, 0.1), t_span=(0, 100), step=0.1, method=co.Splitting(order=4))
>>> sol.x.shape
(1001, 3)

Main names, each with `help(co.integrate)` and so on; `dir(co)` lists all, and docs/api.md describes them.

- Systems: `systems` (ready-made), `LieAlgebra`, `algebras`, `LiePoissonSystem`, `PoissonSystem`, `MatrixSystem`
- Hamiltonians and forces: `Quadratic`, `Polynomial`, `Separable`, `SplitHamiltonian`, `Hamiltonian`, `forces`
- Schemes: `Splitting`, `GaussLegendre`, `IsospectralGauss`, `Taylor`, `ReversibleSteps`, ...; `choose`, `methods`
- Runs: `integrate`, `prepare`, `stepper`, `batch`, `integrate_ensemble`, `Event`, `poincare_section`, `Solution`
- Files: `load`, `resume`, `open_archive`, `results`; `orbits`, `attitudes`; crystals: `spins`
- Analysis: `certify`, `fit`, `modified_hamiltonian`, `lyapunov`, `analysis`; pictures: `plotting`

Names are loaded lazily: importing this package loads NumPy and nothing heavier.
"""

from __future__ import annotations

from coadjoint.shortcuts import attach

__version__ = "1.0.0"

# The names are listed in __init__.pyi. There is no __all__, since `help` would print the help of each of them.
__getattr__, __dir__, _names = attach("coadjoint", __file__)
_names.append("__version__")
