"""Matrix algebras whose Casimirs are known as traces of powers, tr X^k."""

from fractions import Fraction

import numpy as np
from flint import fmpq_mat

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial


def from_matrices(rho):
    """The algebra spanned by matrices of whole numbers, and X(x) with x_i = tr(X rho_i), whose traces are Casimirs."""
    n, d = len(rho), rho.shape[1]
    form = np.einsum("iab,jba->ij", rho, rho)
    inverse = fmpq_mat(n, n, [int(v) for v in form.ravel()]).inv()
    dual = np.array([[Fraction(int(inverse[i, j].p), int(inverse[i, j].q)) for j in range(n)] for i in range(n)])
    brackets = np.einsum("iab,jbc->ijac", rho, rho)
    brackets = brackets - brackets.transpose(1, 0, 2, 3)
    constants = np.einsum("ijac,lca->ijl", brackets, rho).astype(object) @ dual
    x = [Polynomial.variable(i, n) for i in range(n)]
    zero = Polynomial({}, dim=n)
    weights = dual @ np.array(rho, dtype=object).reshape(n, d * d)
    entries = [sum((x[i] * weights[i, e] for i in range(n) if weights[i, e]), start=zero) for e in range(d * d)]
    return LieAlgebra(constants.astype(float)), np.array(entries, dtype=object).reshape(d, d)


def units(n, *pairs):
    matrix = np.zeros((n, n), dtype=np.int64)
    for a, b, value in pairs:
        matrix[a, b] += value
    return matrix


def sl(n):
    off = [units(n, (a, b, 1)) for a in range(n) for b in range(n) if a != b]
    return np.array(off + [units(n, (a, a, 1), (a + 1, a + 1, -1)) for a in range(n - 1)])


def so(n):
    return np.array([units(n, (a, b, 1), (b, a, -1)) for a in range(n) for b in range(a + 1, n)])


def sp4():
    symmetric = [units(2, (a, b, 1), *([(b, a, 1)] if a != b else [])) for a in range(2) for b in range(a, 2)]
    zero = np.zeros((2, 2), dtype=np.int64)
    blocks = [np.block([[zero, s], [zero, zero]]) for s in symmetric]
    blocks += [np.block([[zero, zero], [s, zero]]) for s in symmetric]
    diagonal = [units(2, (a, b, 1)) for a in range(2) for b in range(2)]
    return np.array(blocks + [np.block([[m, zero], [zero, -m.T]]) for m in diagonal])


def su(n):
    """i as the matrix ((0, -1), (1, 0)); the last item is i times the identity."""
    imaginary = np.array([[0, -1], [1, 0]])
    pairs = [(a, b) for a in range(n) for b in range(a + 1, n)]
    real = [np.kron(units(n, (a, b, 1), (b, a, -1)), np.eye(2, dtype=np.int64)) for a, b in pairs]
    other = [np.kron(units(n, (a, b, 1), (b, a, 1)), imaginary) for a, b in pairs]
    diagonal = [np.kron(units(n, (a, a, 1), (a + 1, a + 1, -1)), imaginary) for a in range(n - 1)]
    return np.array(real + other + diagonal), np.kron(np.eye(n, dtype=np.int64), imaginary)


def traces(powers, matrix, factor=None):
    result, power = [], matrix
    for exponent in range(2, max(powers) + 1):
        power = power @ matrix
        if exponent in powers:
            odd = factor is not None and exponent % 2
            result.append((power @ factor.astype(object)).trace() if odd else power.trace())
    return result


def classical(name):
    rho, imaginary = su(int(name[3])) if name.startswith("su") else ({"sl": sl, "so": so}[name[:2]](int(name[3])), None)
    g, matrix = from_matrices(rho)
    return g, traces((2, 4) if name == "so(5)" else range(2, int(name[3]) + 1), matrix, imaginary)


def symplectic():
    g, matrix = from_matrices(sp4())
    return g, traces((2, 4), matrix)
