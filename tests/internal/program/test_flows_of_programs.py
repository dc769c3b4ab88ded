"""Steps of programs in many digits, and against dense matrices."""

import dataclasses

import mpmath
import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from coadjoint.program.interpreter import Interpreter
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.second_order import part_derivatives
from coadjoint.program.table import build_flow_table
from drawn_matrices import constants_of


def top(sign=+1):
    return co.LiePoissonSystem(co.algebras.e(3), co.Quadratic([1.0, 0.5, 0.25, 2.0, 3.0, 4.0]), sign=sign)


@dataclasses.dataclass(frozen=True)
class SweepAndAdjoint(co.methods.FlowMethod):
    """A sweep over 0.1 h and its adjoint over 0.9 h, of one moment; in 53 bits the floats 0.1 and 0.9 add up to 1."""

    order, explicit, symmetric = 1, True, False

    def properties(self, system):
        return co.Splitting().properties(system)

    def sweeps(self, number=float):
        return [co.methods.Sweep(k == 0, number(c), number(0.5)) for k, c in enumerate((0.1, 0.9))]


@pytest.mark.thinned(3)
@pytest.mark.parametrize("scheme", [co.Splitting(scheme="suzuki4"), SweepAndAdjoint()], ids=str)
def test_steps_in_more_digits_do_not_use_the_numbers_of_fewer(scheme):
    """Coefficients of 50 digits, and sums of coefficients, against the sweeps one after the other."""
    s, sweep = top(), {k: co.Splitting(order=1, adjoint=not k) for k in (0, 1)}

    def step_of(method, h):
        return method.step(s, x, mpmath.mpf(0), h)

    x = np.array([mpmath.mpf(v) for v in np.linspace(-0.5, 0.75, s.dim)], dtype=object)
    step_of(scheme, mpmath.mpf(0.125))
    with mpmath.workdps(40):
        end = step_of(scheme, mpmath.mpf(0.125))
        for each in scheme.sweeps(mpmath.mpf):
            x = step_of(sweep[each.forward], each.coefficient * mpmath.mpf(0.125))
        assert max(abs(end - x)) < 1e-38


U = 2.0**-53
BASES = {
    "so(3)": co.algebras.so(3),
    "sl(2)": co.algebras.sl(2),
    "e(3)": co.algebras.e(3),
    "Heisenberg": co.algebras.heisenberg(1),
    "spiral": co.algebras.get("A3,7", a=0.5),
    "scaling": co.LieAlgebra([(0, 1, 1, -1.0), (0, 2, 2, 2.0), (0, 2, 1, 1.0)], dim=3),
}


def drawn_basis(rng, n):
    """A matrix of whole numbers with determinant one or minus one, times powers of two with signs."""
    lower, upper = rng.integers(-1, 2, (2, n, n))
    T = (np.tril(lower, -1) + np.eye(n)) @ (np.triu(upper, 1) + np.eye(n))
    return np.diag(rng.choice([-2.0, -1.0, -0.5, 0.5, 1.0, 2.0], n)) @ T


def of_one_pattern(name, rng):
    """Three copies of an algebra in one basis up to the sizes and signs of its elements."""
    algebra = BASES[name]
    if rng.random() < 0.6:
        algebra = co.algebras.change_of_basis(algebra, drawn_basis(rng, algebra.dim))
    scales = [np.diag(rng.choice([-3.0, -1.0, -0.5, 0.5, 1.0, 2.0], algebra.dim)) for _ in range(3)]
    if rng.random() < 0.5:
        scales = [np.eye(algebra.dim) * factor for factor in (1.0, -2.0, 0.5)]
    return co.algebras.direct_sum(*(co.algebras.change_of_basis(algebra, scale) for scale in scales))


def drawn_system(name, seed):
    rng = np.random.default_rng([seed, *map(ord, name)])
    algebra = of_one_pattern(name, rng)
    n = algebra.dim
    if seed % 2:  # one full matrix for all copies, with other linear terms
        A = np.triu(rng.integers(-4, 5, (n // 3, n // 3)) / 8.0)
        M = np.kron(np.eye(3), A + A.T - np.diag(np.diag(A) * rng.choice([1.0, 2.0])))
    else:
        A = np.triu(rng.integers(-4, 5, (n, n)) / 4.0 * (rng.random((n, n)) < 0.25))
        M = np.diag(rng.integers(-4, 5, n) / 4.0) + 0.25 * (A + A.T)
    linear = rng.integers(-2, 3, n) / 2.0 * (rng.random(n) < 0.5)
    system = co.LiePoissonSystem(algebra, co.Quadratic(M, linear=linear), sign=int(rng.choice([-1, 1])))
    return system, 0.5 * rng.uniform(-1, 1, n), float(rng.choice([-0.2, 0.2]))


def strang(count):
    """Pairs of a part and its fraction of a step of order two."""
    half = [(p, 0.5) for p in range(count)]
    return [*half, *half[::-1]]


def dense_step(system, parts, x, g, h):
    """A step on the momentum x and the group element g, in the coadjoint representation, and the amplification."""
    c, size = constants_of(system.algebra), 1.0
    for p, fraction in strang(len(parts)):
        slope = part_derivatives(parts, x[None])[0][p, 0]
        D = fraction * h * system.sign * np.einsum("ijk,j->ik", c, slope)  # D x = J(x) grad of the piece
        size *= np.linalg.norm(expm(np.abs(D)), np.inf)
        x, g = expm(D) @ x, g @ expm(-D)
    return x, g, size


def check_step(system, choice, x, h):
    """Compare a step in Python, with its group element, and the compiled one with dense matrices."""
    n, decomposition = system.dim, decompose(system, choice)
    parts = decomposition.parts
    # The pieces add up to the energy minus the Casimirs, up to a constant.
    pieces = part_derivatives(parts, x[None])[0].sum(axis=0)[0]
    casimirs = sum((factor * C.gradient(x) for C, factor in decomposition.shift), np.zeros(n))
    expected = system.hamiltonian.gradient(x) - casimirs
    assert np.abs(pieces - expected).max() <= 2.0**-40  # squares amplify rounding by at most some hundreds
    wanted, moved, size = dense_step(system, parts, x, np.eye(n), h)
    method = co.Splitting(order=2, parts=choice)
    end, group = Interpreter(build_flow_table(system, method, group="coadjoint")).steps(x, h, 1, group=np.eye(n))
    # Rounding of each flow, amplified by all: n products in a sum, some dozens in the series of expm.
    tolerance = 64 * n * len(parts) * U * size
    assert np.abs(end - wanted).max() <= tolerance
    assert np.abs(group - moved).max() <= tolerance * size
    assert np.abs(co.stepper(system, method, h)(x) - wanted).max() <= tolerance


@pytest.mark.thinned(15)
@pytest.mark.parametrize(
    ("seed", "choice"), [(0, "coordinates"), (1, "coordinates"), (2, "coordinates"), (3, "auto"), (4, "auto")]
)
@pytest.mark.parametrize("name", BASES)
def test_a_step_is_that_of_dense_matrices(name, seed, choice):
    system, x, h = drawn_system(name, seed)
    check_step(system, choice, x, h)


@pytest.mark.parametrize("first", ["auto", "coordinates"])
def test_choices_and_linear_terms_of_one_pattern_in_turn(first):
    """Tables of equal forms are cached: neither the grouping of the forms nor the linear term may be that of another.

    In the algebra e1, e2 commute, so that the parts are {e1, e2}, {e3} or one each, with the same forms.
    """
    x = np.array([0.5, -0.25, 0.75])
    for factor in (1.0, 2.0):
        algebra = co.LieAlgebra([(0, 2, 0, factor), (0, 2, 1, -1.0), (1, 2, 0, 1.0), (1, 2, 1, factor)], dim=3)
        for linear in ([0.0, 0.0, 0.0], [0.5, 0.0, -1.0], [0.0, -2.0, 0.0]):
            for M in ([1.0, 0.5, -0.25], [0.0, 0.5, 1.0]):
                system = co.LiePoissonSystem(algebra, co.Quadratic(M, linear=linear))
                for choice in (first, {"auto": "coordinates", "coordinates": "auto"}[first]):
                    check_step(system, choice, x, 0.2)
