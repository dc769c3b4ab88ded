"""Parts of commuting forms: few of them, on every algebra of the catalogue, whose pieces add up to the Hamiltonian."""

import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from scipy.sparse import coo_array

import coadjoint as co
from catalogue_cases import EXAMPLES
from coadjoint.algebra.catalogue import entries
from coadjoint.program.interpreter import Interpreter
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.split import split
from coadjoint.program.table import build_flow_table
from drawn_matrices import whole_matrix
from guards import bounded_work


def lattice(count, seed=1):
    """Exchange of neighbours and of random pairs, different along x, y and z, and a field."""
    rng = np.random.default_rng(seed)
    a = np.concatenate([np.arange(count - 1), rng.integers(0, count, count)])
    b = np.concatenate([np.arange(1, count), rng.integers(0, count, count)])
    a, b = a[a != b], b[a != b]
    rows = np.concatenate([3 * a + axis for axis in range(3)])
    columns = np.concatenate([3 * b + axis for axis in range(3)])
    J = coo_array((rng.uniform(0.5, 1.5, len(rows)), (rows, columns)), shape=(3 * count, 3 * count))
    return co.Quadratic((J + J.T).tocsr(), linear=rng.standard_normal(3 * count))


def full(n, seed):
    A = np.random.default_rng(seed).standard_normal((n, n))
    return A + A.T


E3, SO4, SL2, SO3 = co.algebras.e(3), co.algebras.so(4), co.algebras.sl(2), co.algebras.so(3)
A37, HEISENBERG, SO5 = co.algebras.get("A3,7", a=1.75), co.algebras.heisenberg(2), co.algebras.so(5)
HOLLOW = np.array([[0.0, 1.0, 0.5], [1.0, 0.0, -2.0], [0.5, -2.0, 0.0]])
COUPLED = np.diag([1.0, 2.0, 3.0, 0.5, 0.25, 0.75])
COUPLED[3, 4] = COUPLED[4, 3] = 0.125
COUPLED[3, 5] = COUPLED[5, 3] = -0.5


def kepler(y):
    return 1.0 / (1.0 + y[0] * y[0] + y[1] * y[1])


def kepler_slope(y):
    r = 1.0 + y[0] * y[0] + y[1] * y[1]
    return np.array([-2.0 * y[0] / (r * r), -2.0 * y[1] / (r * r)])


QUARTIC = {
    (4, 0, 0): 0.25,
    (2, 0, 0): 0.5,
    (0, 3, 0): 1.0,
    (0, 0, 4): -0.125,
    (1, 0, 1): 0.75,
    (0, 1, 0): 2.0,
    (0, 0, 0): 3.0,
}
CUBIC_IN_P = {(0, 0, 0, 2, 1, 0): 0.5, (0, 0, 0, 0, 1, 3): -0.25, (2, 0, 0, 0, 0, 0): 1.0, (0, 1, 0, 0, 0, 0): 0.5}
PIECES = [
    ((3, 4), co.Hamiltonian(kepler, kepler_slope)),
    ((0,), co.Quadratic(2.0)),
    ((5, 3), co.Polynomial({(1, 2): 0.5})),
    ((1, 4), co.Quadratic([[1.0, 0.5], [0.5, 2.0]])),
]
SYSTEMS = {
    "e(3) diagonal": (E3, co.Quadratic([1.0, 0.5, 0.25, 2.0, 3.0, 4.0], linear=[0, 0, 1, 0, 0.5, 0])),
    "e(3) couplings inside commuting sets": (E3, co.Quadratic(COUPLED)),
    "e(3) full": (E3, co.Quadratic(full(6, 2), linear=np.arange(6.0))),
    "so(4) full": (SO4, co.Quadratic(full(6, 3))),
    "so(4) diagonal": (SO4, co.Quadratic(np.arange(1.0, 7.0))),
    "sl(2) indefinite": (SL2, co.Quadratic(full(3, 4), linear=[1.0, 0, -1.0])),
    "A3,7 full": (A37, co.Quadratic(full(3, 5), linear=[0, 0, 0.5])),
    "A3,7 diagonal": (A37, co.Quadratic([1.0, 2.0, 0.01])),
    "Heisenberg singular": (HEISENBERG, co.Quadratic(np.outer(np.arange(5.0), np.arange(5.0)))),
    "so(5) diagonal": (SO5, co.Quadratic(np.arange(1.0, 11.0))),
    "so(5) full": (SO5, co.Quadratic(full(10, 6))),
    "so(3) zero diagonal": (SO3, co.Quadratic(HOLLOW, linear=[1.0, 2.0, 3.0])),
    "so(3) permuted": (co.algebras.change_of_basis(SO3, np.eye(3)[[2, 0, 1]]), co.Quadratic([1.0, 2.0, 4.0])),
    "so(3) other basis": (co.algebras.change_of_basis(SO3, whole_matrix(3, 7)), co.Quadratic([1.0, 2.0, 4.0])),
    "e(3) other basis": (co.algebras.change_of_basis(E3, whole_matrix(6, 8)), co.Quadratic(full(6, 9))),
    "3 spins": (co.algebras.copies(SO3, 3), lattice(3)),
    "3 spins full": (co.algebras.copies(SO3, 3), co.Quadratic(full(9, 10))),
    "quartic on so(3)": (SO3, co.Polynomial(QUARTIC)),
    "cubic in p on e(3)": (E3, co.Polynomial(CUBIC_IN_P)),
    "pieces on e(3)": (E3, co.SplitHamiltonian(PIECES)),
    "separable on sl(2)": (
        SL2,
        co.Separable(
            {0: (math.cosh, math.sinh), 2: (lambda y, t: 0.5 * y * y * (2.0 + t), lambda y, t: y * (2.0 + t))}
        ),
    ),
}


def system(name):
    return co.LiePoissonSystem(*SYSTEMS[name])


def bracket_is_zero(algebra, f, g):
    """Exactly, in rationals; forms in floats may miss by the rounding of their entries, 4 u of what is added up."""
    u, v = (
        {i: value if isinstance(value, Fraction) else Fraction(value) for i, value in zip(*form, strict=True)}
        for form in (f, g)
    )
    sums, sizes = {}, {}
    for i, j, k, c in zip(*(a.tolist() for a in algebra.triples), strict=True):
        plus, minus = u.get(i, 0) * v.get(j, 0), u.get(j, 0) * v.get(i, 0)
        sums[k] = sums.get(k, 0) + Fraction(c) * (plus - minus)
        sizes[k] = sizes.get(k, 0) + abs(Fraction(c)) * (abs(plus) + abs(minus))
    return all(abs(sums[k]) <= 4 * 2.0**-53 * sizes[k] for k in sums)


@pytest.mark.parametrize("choice", ["auto", "coordinates"])
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_forms_of_a_part_commute(name, choice):
    algebra = SYSTEMS[name][0]
    parts = split(system(name), choice)
    for part in parts:
        for a, f in enumerate(part):
            assert all(bracket_is_zero(algebra, f, g) for g in part[:a])


@pytest.mark.thinned(10)
@pytest.mark.parametrize("choice", ["auto", "coordinates"])
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_pieces_add_up_to_the_hamiltonian(name, choice):
    """sum of angle_a l_a = grad H, at points in 40 digits: within 10^-36 of what is added up."""
    s = system(name)
    functions = name in ("pieces on e(3)", "separable on sl(2)")
    number = float if functions else mpmath.mpf
    tolerance = 16 * s.dim * 2.0**-53 if functions else 1e-36  # functions of floats; or 40 digits less a few roundings
    with mpmath.workdps(40):
        read = Interpreter(build_flow_table(s, co.Splitting(parts=choice), number=number))
        for seed in range(3):
            x = np.random.default_rng(seed).uniform(-1, 1, s.dim)
            x = x if functions else np.array([mpmath.mpf(v) for v in x])
            total, size = [0 * x[0]] * s.dim, [0 * x[0]] * s.dim
            for p, part in enumerate(read.flow_table.parts):
                angles = read.angles(p, x, 0.25)
                assert len(angles) == len(part)
                for angle, form in zip(angles, part, strict=True):
                    for i, value in zip(*form, strict=True):
                        exact = Fraction(value)
                        term = angle * (x[0] * 0 + exact.numerator) / exact.denominator
                        total[i], size[i] = total[i] + term, size[i] + abs(term)
            gradient = s.hamiltonian.gradient(x, 0.25)
            for casimir, factor in read.flow_table.shift:
                gradient = gradient - number(factor) * casimir.gradient(x)
                tolerance = 16 * s.dim * 2.0**-53  # the entries of the shifted M are floats
            assert all(abs(a - b) <= tolerance * (c + abs(b)) for a, b, c in zip(total, gradient, size, strict=True))


@pytest.mark.parametrize("count", [1, 40, 2000])
def test_any_lattice_of_spins_has_three_parts(count):
    """Found in time nearly linear in the spins: 2000 take about a second."""
    s = co.LiePoissonSystem(co.algebras.copies(SO3, count), lattice(count))
    with bounded_work():
        parts = split(s)
        program = build_flow_table(s, co.Splitting(order=2))
    assert [sorted(i for (i,), _ in part) for part in parts] == [list(range(axis, 3 * count, 3)) for axis in range(3)]
    assert len(program.state.kind) == 3  # one run for each part, however many spins


# Numbers of sets of commuting coordinates; two elsewhere.
THREE = """A3_8 A3_9 A4_7 A4_8 A4_9 A4_10 A4_11 A5_3 A5_6 A5_19 A5_20 A5_21 A5_23 A5_24 A5_25 A5_26 A5_28 A5_29 A5_30
A5_31 A5_36 A5_37 A5_39 A5_40""".split()


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", entries())
def test_as_few_parts_as_commuting_sets_that_cover_the_coordinates(name):
    count, algebra = 3 if name in THREE else 2, co.algebras.get(name, **EXAMPLES.get(name, {}))
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.linspace(1.0, 2.0, algebra.dim)))
    parts = split(system, "auto")
    assert len(parts) <= count
    assert len(decompose(system, "auto").parts) <= len(parts)
    covered = sorted(i for part in parts for form, _ in part for i in form)
    assert covered == list(range(algebra.dim))
    for part in parts:
        chosen = [i for form, _ in part for i in form]
        assert all(algebra.commuting(i, j) for i in chosen for j in chosen)


def ring(copies, algebra, seed):
    """Random couplings of neighbours in a ring of copies of an algebra, of all components and within each copy."""
    rng, n = np.random.default_rng(seed), algebra.dim
    M = np.zeros((copies * n, copies * n))
    for k in range(copies):
        here, there = slice(n * k, n * k + n), slice(n * ((k + 1) % copies), n * ((k + 1) % copies) + n)
        M[here, here] = rng.standard_normal((n, n))
        M[here, there] += rng.standard_normal((n, n)) * (rng.random((n, n)) < 3 / n)
    energy = co.Quadratic(M + M.T, linear=rng.standard_normal(copies * n), constant=2.0)
    return co.LiePoissonSystem(co.algebras.copies(algebra, copies), energy, sign=-1)


SYSTEMS_SEPARATED = {
    "square, vector in the plane": lambda: co.systems.spin_lattice("square", (4, 4), periodic=True, dm=(0, 0, 0.3)),
    "square, all terms": lambda: co.systems.spin_lattice(
        "square", (3, 4), dm=(0.1, 0.2, 0.3), field=(0.1, 0.2, 0.3), on_site=(0.1, -0.2, 0.4)
    ),
    "odd ring": lambda: co.systems.spin_lattice("chain", 9, periodic=True, dm=(0.1, 0.2, 0.3)),
    "so(3)": lambda: ring(7, co.algebras.so(3), 1),
    "sl(2)": lambda: ring(6, co.algebras.sl(2), 2),
    "e(3)": lambda: ring(4, co.algebras.e(3), 3),
}


@pytest.mark.parametrize("name", SYSTEMS_SEPARATED)
def test_parts_commute_and_add_up_to_the_energy(name):
    system, rng = SYSTEMS_SEPARATED[name](), np.random.default_rng(4)
    parts, x = split(system), rng.standard_normal(SYSTEMS_SEPARATED[name]().dim)
    rates = parts.offset.copy()
    np.add.at(rates, parts.weights.owner, parts.weights.value * x[parts.weights.coordinate])
    gradient = np.zeros(system.dim)
    np.add.at(gradient, parts.forms.coordinate, parts.forms.value * rates[parts.forms.owner])
    scale = np.abs(system.hamiltonian.gradient(x)).max()
    np.testing.assert_allclose(gradient, system.hamiltonian.gradient(x), rtol=0, atol=1e-13 * scale)
    structure = system.structure_matrix(x)
    for first, last in zip(parts.angle[:-1], parts.angle[1:], strict=True):
        forms = np.zeros((last - first, system.dim))
        entries = slice(parts.forms.start[first], parts.forms.start[last])
        forms[parts.forms.owner[entries] - first, parts.forms.coordinate[entries]] = parts.forms.value[entries]
        assert np.abs(forms @ structure @ forms.T).max() < 1e-12 * scale
