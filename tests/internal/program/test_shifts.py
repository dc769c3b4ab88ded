"""Casimir shifts, their factors, orders of parts, the h^2 term that decides between them, and turns of the group."""

import json
from fractions import Fraction
from functools import cache
from itertools import permutations

import mpmath
import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

import coadjoint as co
from coadjoint.program.blocks import Turn
from coadjoint.program.group_correction import _cholesky, unshift_tables
from coadjoint.program.parts.casimir_shifts import (
    candidate_shifts,
    count_parts,
    quadratic_casimirs,
    shifted_terms,
    singular_factors,
)
from coadjoint.program.parts.decompose import ChosenParts, best_decomposition, decompose, sample_points
from coadjoint.program.parts.second_order import best_orders, part_derivatives
from coadjoint.program.parts.split import split
from refusals import refused
from second_order_terms import second_order_term

U = 2.0**-53


def full(n, seed=0):
    matrix = np.random.default_rng(seed).standard_normal((n, n))
    return matrix @ matrix.T / n + np.eye(n)


def systems():
    rng = np.random.default_rng(3)
    return {
        "so(3)": co.systems.paper_rigid_body(),
        "so(3), full": co.systems.rigid_body(((2.0, 0.3, 0.1), (0.3, 3.0, 0.2), (0.1, 0.2, 4.0))),
        "A3,7": co.systems.paper_a37(),
        "e(3)": co.LiePoissonSystem(
            co.algebras.e(3), co.Quadratic(rng.uniform(0.5, 2, 6), linear=rng.uniform(size=6)), -1
        ),
        "so(4)": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(rng.uniform(0.5, 2, 6))),
        "so(4), full": co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(full(6))),
        "sl(2)": co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic((1.0, 2.0, 3.0))),
        "spins": co.LiePoissonSystem(
            co.algebras.copies(co.algebras.so(3), 4), co.Quadratic(np.diag(np.tile((0.4, 0.4, 1.0), 4)) + chain(4))
        ),
    }


def chain(count):
    coupled = np.zeros((3 * count, 3 * count))
    for k in range(3 * count - 3):
        coupled[k, k + 3] = coupled[k + 3, k] = -0.3
    return coupled


NAMES = list(systems())


@pytest.mark.sensitive
@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", NAMES)
def test_parts_add_up_to_the_shifted_hamiltonian(name):
    system = systems()[name]
    found = decompose(system, "auto")
    x = np.random.default_rng(0).standard_normal(system.dim)
    gradient = part_derivatives(found.parts, x[None])[0][:, 0].sum(axis=0)
    expected = system.hamiltonian.gradient(x) - sum(
        (c * np.asarray(C.gradient(x), dtype=float) for C, c in found.shift), np.zeros(system.dim)
    )
    # Each component is a sum of at most 2 n rounded products.
    assert np.abs(gradient - expected).max() <= 16 * system.dim * U * max(1.0, np.abs(x).max()) * 8


@pytest.mark.sensitive
def test_the_middle_moment_is_taken_off():
    assert decompose(systems()["so(3)"], "auto").choice.shift == (("|x|^2", 0.25),)  # of |x|^2 = 2 |x|^2/2: m = 1/2


@pytest.mark.sensitive
def test_second_order_term_of_the_rigid_body():
    """The polynomial of the modified Hamiltonian of the free rigid body, parts 1 2 3."""
    system = systems()["so(3)"]
    m1, m2, m3 = 1.0, 0.5, 1.0 / 3.0
    x = np.random.default_rng(5).standard_normal((20, 3))
    a, b, c = (x**2).T
    expected = (
        a * b * (m1**2 * m2 - m1**2 * m3 - 2 * m1 * m2**2 + 2 * m1 * m2 * m3 - m2**2 * m3)
        + a * c * (-(m1**2) * m2 + m1**2 * m3 + 2 * m1 * m2 * m3 - 2 * m1 * m3**2 + 2 * m2 * m3**2)
        + b * c * (2 * m1 * m2**2 - 4 * m1 * m2 * m3 + 2 * m1 * m3**2 + m2**2 * m3 - 2 * m2 * m3**2)
    ) / 24
    found = second_order_term(system.algebra, part_derivatives(split(system, "coordinates"), x), x)
    np.testing.assert_allclose(found, expected, rtol=0, atol=200 * U * np.abs(x).max() ** 4)


@pytest.mark.sensitive
def test_the_best_order_is_the_best_of_all():
    system = systems()["so(3)"]
    parts = split(system, "coordinates")
    points = np.random.default_rng(0).standard_normal((50, 3))
    ((order, size),) = best_orders(system, [parts], points)
    sizes = {
        p: np.sqrt(
            np.mean(second_order_term(system.algebra, part_derivatives(parts.take(np.array(p)), points), points) ** 2)
        )
        for p in permutations(range(3))
    }
    assert order == min(sizes, key=sizes.get) and size == pytest.approx(min(sizes.values()), rel=1e-12)


@pytest.mark.sensitive
@pytest.mark.parametrize("linear", [(), (2,), (0, 2)])
def test_a_choice_is_written_read_and_taken_again_with_all_that_it_holds(linear):
    """Coordinates whose linear coefficients count as present have parts of their own, for any coefficients."""
    algebra, M = co.algebras.so(3), (1.0, 2.0, 2.0)  # the shift by |x|^2 takes the last two coordinates off
    driven = co.LiePoissonSystem(algebra, co.Quadratic(M, linear=[0.5 * (k in linear) for k in range(3)]))
    count = len(split(driven, "auto", shifted_terms(driven.hamiltonian.terms(), quadratic_casimirs(driven), SHIFT)))
    assert count == len({0, *linear})
    choice = ChosenParts(tuple(range(count))[::-1], SHIFT, linear)
    again = ChosenParts.from_mapping(json.loads(json.dumps(choice.to_mapping())))
    assert again == choice and eval(repr(choice)) == choice
    assert (again.order, again.shift, again.linear) == (choice.order, choice.shift, linear)
    free = co.LiePoissonSystem(algebra, co.Quadratic(M))
    for system in (driven, free):
        found = decompose(system, again)
        assert found.choice == choice and [factor for _, factor in found.shift] == [1.0]
        forms = [part for part in found.parts]
        assert forms == [part for part in decompose(driven, choice).parts] and len(forms) == count
        x = np.array([0.5, -1.0, 0.25])
        gradient = part_derivatives(found.parts, x[None])[0].sum(axis=(0, 1))
        assert np.array_equal(gradient, system.hamiltonian.gradient(x) - 2.0 * x)


SHIFT = (("|x|^2", 1.0),)


@pytest.mark.sensitive
@pytest.mark.parametrize(
    ("given", "named"),
    [
        (((0, 2),), ("not a permutation",)),
        (((0, 1, 2), (("|x|^2", 0.25),)), ("3 parts", "paper_rigid_body has 2")),
        (((0, 1), (("C9", 0.25),)), ("'C9'", "quadratic Casimirs")),
        (((0, 1), SHIFT, (0, 3)), ("coordinate 3", "3 of them")),
    ],
)
def test_choices_that_do_not_fit_are_refused(given, named):
    with refused(ValueError, *named):
        decompose(systems()["so(3)"], ChosenParts(*given))


@pytest.mark.sensitive
def test_many_systems_at_once_are_decomposed_as_each_alone():
    """Every choice and factor the same, to the bit: equal moments, full matrices and other structure constants too."""
    rng = np.random.default_rng(7)
    groups = [
        [co.systems.rigid_body(tuple(I)) for I in [*rng.uniform(1, 3, (20, 3)), (2, 2, 1), (1, 1, 1), (1, 2, 2)]],
        [co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(full(3) * rng.uniform(0.5, 2))) for _ in range(4)],
        [co.LiePoissonSystem(co.algebras.get("A3,7", a=a), co.Quadratic([1.0, a, 0.5])) for a in (0.5, 1.0, 2.0, 3.0)],
        [co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(rng.uniform(0.5, 2, 6))) for _ in range(4)],
    ]
    found = 0
    for systems in groups:
        points = sample_points(systems[0].dim)
        alone = [best_decomposition(system, points) for system in systems]
        for stack in co.Splitting(order=2).split_jointly(systems):
            choices = [alone[m].choice for m in stack.numbers.tolist()]
            assert len({(choice.order, tuple(name for name, _ in choice.shift)) for choice in choices}) == 1
            for m, numbers in zip(stack.numbers.tolist(), stack.split.T, strict=True):
                terms = shifted_terms(
                    systems[m].hamiltonian.terms(), quadratic_casimirs(systems[m]), alone[m].choice.shift
                )
                own = np.concatenate([terms[0].linear, terms[0].values, [0.0]])
                assert numbers.tolist() == own.tolist()
                found += 1
    assert found >= 20


@pytest.mark.sensitive
@pytest.mark.parametrize(
    ("matrix", "casimir", "factors"),
    [
        (np.ones((3, 3)), np.eye(3), (0.0, 0.0, 3.0)),
        (np.ones((3, 3)), -2.0 * np.eye(3), (-1.5, 0.0, 0.0)),
        (np.array([[0.0, 1.0], [1.0, 0.0]]), np.diag([1.0, 4.0]), (-0.5, 0.5)),
        # Pivots of very different sizes: the smallest one bounds the factors.
        (np.array([[0.0, 1.0], [1.0, 0.0]]), np.diag([2.0**-10, 2.0**10]), (-1.0, 1.0)),
        (np.ones((2, 2)), -np.diag([2.0**-10, 1.0]), (-1025.0, 0.0)),
        # Nothing to find: no coupling, and Casimirs that are indefinite or singular.
        (np.diag([1.0, 2.0]), np.eye(2), ()),
        (np.ones((2, 2)), np.diag([1.0, -1.0]), ()),
        (np.ones((2, 2)), np.diag([1.0, 0.0]), ()),
    ],
)
def test_known_factors(matrix, casimir, factors):
    """64 halvings of an interval of 4 n^2 max|M| / min|C|, and the float beyond the factor."""
    found = singular_factors(matrix, casimir)
    width = 4.0 * matrix.size * np.abs(matrix).max() / max(np.abs(np.diag(casimir)).min(), 2.0**-10)
    assert found == pytest.approx(factors, rel=4 * U, abs=width * 2.0**-64)


@pytest.mark.sensitive
@pytest.mark.parametrize("size", [2, 3, 5, 8])
@pytest.mark.parametrize("scale", [1.0, 2.0**40, 2.0**-40])
def test_they_are_generalized_eigenvalues(size, scale):
    """Found to the last bit; the eigenvalues of LAPACK are within n^2 u times the size of the pencil."""
    rng = np.random.default_rng(size)
    A, B = rng.standard_normal((2, size, size))
    M, C = scale * (A + A.T), np.eye(size) + 0.1 * (B + B.T) / size
    expected = eigh(M, C, eigvals_only=True)
    found = singular_factors(M, C)
    assert len(found) == size
    assert np.abs(found - expected).max() <= 16 * size**2 * U * np.abs(expected).max() * np.linalg.cond(C)


# Algebras with a nondegenerate quadratic Casimir x.A x/2, diagonal in the basis, up to a factor.
FACTORS = {
    "so(3)": (co.algebras.so(3), [1.0, 1.0, 1.0]),
    "so(2,1)": (
        co.LieAlgebra.from_brackets(3, {(0, 1): {2: -1.0}, (1, 2): {0: 1.0}, (0, 2): {1: -1.0}}),
        [1.0, 1.0, -1.0],
    ),
    "so(4)": (co.algebras.so(4), [1.0] * 6),
}


def drawn(names, seed):
    """Return a sum of the algebras with Casimirs of random coefficients, and the diagonals A (factors, n)."""
    rng, parts = np.random.default_rng(seed), [FACTORS[name] for name in names]
    algebra = co.algebras.direct_sum(*(algebra for algebra, _ in parts)) if len(parts) > 1 else parts[0][0]
    edges = np.cumsum([0, *(len(form) for _, form in parts)])
    A = np.zeros((len(parts), algebra.dim))
    for k, (_, form) in enumerate(parts):
        A[k, edges[k] : edges[k + 1]] = np.array(form) * rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 5.0)
    casimirs = {
        f"C{k}": co.Polynomial({tuple(2 * (i == j) for j in range(algebra.dim)): a / 2 for i, a in enumerate(row) if a})
        for k, row in enumerate(A)
    }
    return rng, algebra, casimirs, A, edges


SUMS = [
    ("so(3)",),
    ("so(4)",),
    ("so(3)", "so(3)"),
    ("so(3)", "so(2,1)"),
    ("so(2,1)", "so(4)"),
    ("so(3)", "so(2,1)", "so(4)"),
    ("so(2,1)", "so(3)", "so(3)", "so(2,1)", "so(3)"),
]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("names", SUMS, ids=" + ".join)
def test_a_sum_of_symmetric_bodies_is_one_exact_flow(names, seed):
    """H = sum_f c_f C_f + m_f x_i^2/2 turns each factor about its axis i, and nothing else."""
    rng, algebra, casimirs, A, edges = drawn(names, seed)
    factor = rng.choice([-1.0, 1.0], len(names)) * rng.uniform(0.3, 3.0, len(names))
    axes = edges[:-1] + 2
    M = factor @ A
    M[axes] += rng.uniform(0.5, 2.0, len(names))
    system = co.LiePoissonSystem(algebra, co.Quadratic(M), casimirs=casimirs)
    found = decompose(system, "auto")
    assert len(split(system)) > len(found.parts) == 1
    assert found.parts.forms.coordinate.tolist() == axes.tolist()
    assert dict(found.choice.shift) == pytest.approx({f"C{k}": c for k, c in enumerate(factor)}, rel=4 * 2.0**-53)
    # One step of any length is the motion.
    x = rng.normal(size=algebra.dim) / 2
    exact = co.integrate(system, x, (0.0, 1.0), 1 / 16, co.GaussLegendre(6), watch=False).x[-1]
    np.testing.assert_allclose(co.stepper(system, co.Splitting(order=2), 1.0)(x), exact, rtol=0, atol=1e-11)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("names", SUMS, ids=" + ".join)
def test_shifts_take_a_coordinate_of_every_factor_off_each_part(names, seed):
    """Up to four Casimirs are also tried one by one, for every coordinate."""
    rng, algebra, casimirs, A, _ = drawn(names, seed)
    M = rng.choice([-1.0, 1.0], algebra.dim) * rng.uniform(0.3, 3.0, algebra.dim)
    system = co.LiePoissonSystem(algebra, co.Quadratic(M), casimirs=casimirs)
    known, parts = quadratic_casimirs(system), split(system)
    shifts = list(candidate_shifts(system, parts, known))
    factors = np.array([[dict(shift).get(f"C{k}", 0.0) for k in range(len(names))] for shift in shifts])
    left = M - factors @ A
    gone = np.abs(left) <= 4 * 2.0**-53 * np.abs(M)
    home = np.argmax(A != 0.0, axis=0)
    for p in range(len(parts)):
        rows = parts.forms
        own = np.unique(rows.coordinate[slice(*rows.start[parts.angle[[p, p + 1]]])])
        assert any({*home[own].tolist()} == {*home[own[row[own]]].tolist()} for row in gone)
    if len(names) <= 4:
        alone = np.count_nonzero(factors, axis=1) == 1
        assert np.all(np.any(gone[alone], axis=0))
    for shift, row, zero in zip(shifts, left, gone, strict=True):
        (term,) = (one.form for one in shifted_terms(system.hamiltonian.terms(), known, shift))
        assert term.rows.tolist() == term.indices.tolist() == np.flatnonzero(~zero).tolist()
        np.testing.assert_allclose(term.values, row[~zero], rtol=0, atol=4 * 2.0**-53 * np.abs(M).max())


def turned_about(axis, angle):
    with mpmath.workdps(60):
        reduced = float(mpmath.fmod(angle, 2 * mpmath.pi))
    return Rotation.from_rotvec(reduced * np.asarray(axis) / np.linalg.norm(axis)).as_matrix()


@pytest.mark.sensitive
def test_what_a_shift_leaves_by_rounding_is_no_part():
    """Factors M/6 of su(3) are rounded; what is left of M would be a part of its own, and a flow in each step."""
    rng = np.random.default_rng(3)
    for _ in range(40):
        system = co.LiePoissonSystem(co.algebras.su(3), co.Quadratic(rng.uniform(0.5, 2.0, 8)))
        name, casimir = next(iter(quadratic_casimirs(system).items()))
        factor = float(system.hamiltonian.terms()[0].values[0]) / 6.0
        (term,) = shifted_terms(system.hamiltonian.terms(), {name: casimir}, ((name, factor),))
        assert 0 not in term.rows
        found = count_parts(system, {name: casimir}, [((name, factor),)])[0]
        assert found in (0, len(split(system, "auto", (term,))))


@pytest.mark.sensitive
@pytest.mark.parametrize("power", [38, 41, 44])
def test_a_small_square_that_a_shift_leaves_acts(power):
    """The body turns about its momentum, along a small square of a full M and across the large one."""
    large, small = np.array([1.0, 0.5, 0.5]), np.array([0.0, 1.0, -1.0])
    M = np.eye(3) + 2 * np.outer(large, large) + 2.0**-power * np.outer(small, small)
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M), sign=-1)
    method, h = co.Splitting(order=1, parts=ChosenParts((0, 1), (("|x|^2", 0.5),))), 2.0 ** (power - 4)
    A = co.integrate(system, small, (0, h), h, method, attitude=True).attitude[-1]
    expected = turned_about(small, mpmath.sqrt(2) * (mpmath.mpf(h) + mpmath.mpf(1) / 8))
    # The length of the momentum is rounded, in the angle of the shift.
    assert np.abs(A - expected).max() <= 8 * U * h


@pytest.mark.sensitive
def test_rounding_does_not_choose_between_orders_that_are_equal():
    """Two of three parts commute: where they follow each other, either of them may be the first, but for rounding."""
    rng = np.random.default_rng(9)
    algebra = co.algebras.so(4)
    units = np.eye(6)
    j = next(j for j in range(2, 6) if not np.any(algebra.bracket(units[1], units[j])))
    points, neighbours = rng.standard_normal((16, 6)), 0
    for _ in range(60):
        M = np.zeros(6)
        M[[0, 1, j]] = rng.uniform(0.5, 2.0, 3)
        system = co.LiePoissonSystem(algebra, co.Quadratic(M))
        ((order, _),) = best_orders(system, [split(system, [[0], [1], [j]])], points)
        if abs(order.index(1) - order.index(2)) == 1:
            neighbours += 1
            assert order.index(1) < order.index(2)
    assert neighbours > 10


def elements(algebra, carried, shift, x, time, exactly=True):
    """exp(t X) of the library and in 60 digits."""
    from coadjoint.kernels.tables.recording import schedule_of
    from coadjoint.runs.loops.shifted_attitude import unshifting

    tables = unshift_tables(algebra, carried, -1, shift)
    held, out = np.tile(np.eye(tables.size).reshape(1, 1, -1), (2, 1, 1)), np.empty((2, 1, tables.size, tables.size))
    unshifting(tables)(
        1.0, out, held.ctypes.data, np.array([x]), np.eye(tables.size)[None], 0, 1, schedule_of(0.0, time, 1, 1, False)
    )
    if not exactly:
        return out[1, 0], None
    with mpmath.workdps(60):
        X = mpmath.matrix(tables.size)
        for i in range(algebra.dim):
            slope = sum(mpmath.mpf(c) * mpmath.mpf(float(C.derivative(i)(x))) for C, c in shift)
            matrix = algebra.coadjoint(np.eye(algebra.dim)[i]) if carried is None else carried[i]
            X += slope * mpmath.matrix(matrix.tolist())
        exact = np.array(mpmath.expm(mpmath.mpf(time) * X, method="taylor").tolist(), dtype=float)
    return out[1, 0], exact.reshape(tables.size, tables.size)


@pytest.mark.sensitive
@pytest.mark.parametrize("power", [38, 42, 45])
def test_a_slow_turn_beside_a_fast_one(power):
    """so(6): planes that turn by 1 and by eps, 6 times what counts as no turn or more."""
    algebra = co.algebras.so(6)
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.ones(15)))
    ((casimir, _),) = [(found.polynomial, 1.0) for found in quadratic_casimirs(system).values()]
    units = np.eye(15)
    j = next(j for j in range(1, 15) if not np.any(algebra.bracket(units[0], units[j])))
    x = 0.5 * (units[0] + 2.0**-power * units[j])
    found, exact = elements(algebra, system.representation, ((casimir, 1.0),), x, 2.0 ** (power - 3))
    assert np.abs(found - exact).max() <= 32 * U


@pytest.mark.sensitive
@pytest.mark.parametrize("power", [38, 41, 44])
def test_two_parts_of_so4_of_which_one_is_slow(power):
    """|x|^2 and nearly the whole of the other Casimir: a turn of all vectors alike, and one by eps the other way."""
    algebra = co.algebras.so(4)
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.ones(6)))
    first, second = (found.polynomial for found in quadratic_casimirs(system).values())
    scale = np.abs(first.gradient(np.ones(6))).max() / np.abs(second.gradient(np.ones(6))).max()
    shift = ((first, 1.0), (second, scale * (1.0 - 2.0**-power)))
    x = np.array([0.5, 0.25, -0.5, 0.75, 0.125, 0.25])
    h = 2.0 ** (power - 3)
    found, exact = elements(algebra, system.representation, shift, x, h)
    # Products of factors and gradients are rounded, and act for the whole time on the fast part.
    spread = 4 * U * h
    assert np.abs(found.T @ found - np.eye(4)).max() <= 32 * U
    assert np.abs(found - exact).max() <= 8 * spread + 32 * U
    assert [Turn(kind).name for kind in unshift_tables(algebra, system.representation, -1, shift).kind] == ["PAIR"]
    whole = ((first, 1.0), (second, scale))
    assert [Turn(kind).name for kind in unshift_tables(algebra, system.representation, -1, whole).kind] == ["CUBIC"]


@cache
def in_rounded_basis(algebra, seed):
    """The same algebra in an orthonormal basis of rational numbers, every constant rounded once; and that basis."""
    rng, n, Q = np.random.default_rng(seed), algebra.dim, fractions(np.eye(algebra.dim))
    for _ in range(2):
        normal = fractions(rng.integers(1, 6, n) * rng.choice([-1, 1], n))
        Q = Q - 2 * np.multiply.outer(Q.dot(normal), normal) / normal.dot(normal)
    c = fractions([[algebra.bracket(a, b) for b in np.eye(n)] for a in np.eye(n)])
    turned = np.tensordot(Q, np.tensordot(Q, c.dot(Q.T), axes=(1, 1)), axes=(1, 1))
    return co.LieAlgebra(turned.astype(float)), Q


def fractions(values):
    return np.array([Fraction(v) for v in np.ravel(values).tolist()]).reshape(np.shape(values))


def quadratic(form):
    n = len(form)
    pairs = {(i, j): float(form[i, j]) * (0.5 if i == j else 1.0) for i in range(n) for j in range(i, n)}
    return co.Polynomial({tuple(int(k == i) + int(k == j) for k in range(n)): c for (i, j), c in pairs.items()})


@pytest.mark.sensitive
def test_cubic_is_found_in_rounded_bases():
    """so(2,1) turns or stretches by D^3 = lam D."""
    lorentz = co.algebras.get("so(p,q)", p=2, q=1)
    inverse = fractions(np.diag([1 / np.trace(lorentz.coadjoint(row) @ lorentz.coadjoint(row)) for row in np.eye(3)]))
    for seed in range(16):
        algebra, Q = in_rounded_basis(lorentz, seed)
        tables = unshift_tables(algebra, None, -1, ((quadratic(Q.dot(inverse).dot(Q.T)), 1.0),))
        assert [Turn(kind).name for kind in tables.kind] == ["CUBIC"]


@pytest.mark.sensitive
@pytest.mark.parametrize("power", [38, 41, 44])
def test_a_shift_that_is_nilpotent_or_nearly_so(power):
    """e(3) in rounded bases: |p|^2 shifts by X with X^2 = 0, and with eps m.p beside it turns by eps as well."""
    euclid, eps = co.algebras.e(3), 2.0**-power
    system = co.LiePoissonSystem(euclid, co.Quadratic(np.ones(6)))
    forms = []
    for found in quadratic_casimirs(system).values():
        form = np.zeros((6, 6))
        form[found.rows, found.columns] = found.values
        forms.append(fractions(form))
    forms.sort(key=lambda form: not np.any(np.diag(form)))
    x = np.linspace(-0.4, 0.6, 6)
    for seed in range(8):
        algebra, Q = in_rounded_basis(euclid, seed)
        whole, near = (quadratic(Q.dot(forms[0] + Fraction(c) * forms[1]).dot(Q.T)) for c in (0.0, eps))
        tables = unshift_tables(algebra, None, -1, ((whole, 1.0),))
        assert [(Turn(kind).name, order) for kind, order in zip(tables.kind, tables.order, strict=True)] == [
            ("NILPOTENT", 1)
        ]
        # In the basis that is not rounded, where it is known: rounding there is a turn of its own, by sqrt(u).
        plain = elements(euclid, None, ((quadratic(forms[0] + Fraction(eps) * forms[1]), 1.0),), x, 1 / (64 * eps))[1]
        Q = Q.astype(float)
        found = elements(algebra, None, ((near, 1.0),), Q @ x, 1 / (64 * eps), exactly=False)[0]
        # The second power is a 64th of the first, the third one 4096th of it, over 3; rounding is far below.
        assert np.abs(found - Q @ plain @ Q.T).max() <= np.abs(plain).max() / 1024


@pytest.mark.parametrize(("pivot", "definite"), [(2.0**-19, True), (2.0**-21, False), (0.0, False), (-1.0, False)])
def test_a_nearly_singular_form_is_not_definite(pivot, definite):
    assert (_cholesky(np.diag([1.0, pivot])) is not None) is definite


def many_moments():
    """78 coordinates are too many for parts to be made for each shift: (M, linear), with a name for each."""
    rng = np.random.default_rng(1)
    for driven in (0, 3, 40):
        M, linear = np.round(rng.uniform(0.0, 2.0, 78) * 4) / 4, np.zeros(78)
        linear[rng.permutation(78)[:driven]] = -0.5
        yield pytest.param(M, linear, id=f"{driven} linear terms")
    for power in (40, 47, 49, 51, 52):
        M = np.random.default_rng(4).uniform(0.5, 2.0, 78)
        M[1] = M[0] * (1.0 + 2.0**-power)
        yield pytest.param(M, None, id=f"2^-{power}")


@pytest.mark.sensitive
@pytest.mark.parametrize(("M", "linear"), [*many_moments()])
def test_parts_are_counted_as_they_are_made(M, linear):
    """Counting has a threshold of its own; a coordinate with a linear term stays when a shift cancels its square."""
    system = co.LiePoissonSystem(co.algebras.so(13), co.Quadratic(M, linear=linear))
    terms, casimirs = system.hamiltonian.terms(), quadratic_casimirs(system)
    ((name, casimir),) = casimirs.items()
    shifts = [((name, M[k] / casimir.values[k]),) for k in range(3)]
    if linear is not None:
        shifts = list(candidate_shifts(system, split(system), casimirs))
    counts = count_parts(system, casimirs, shifts).tolist()
    made = [len(split(system, "auto", shifted_terms(terms, casimirs, shift))) for shift in shifts]
    assert set(counts) != {0} and all(count in (0, parts) for count, parts in zip(counts, made, strict=True))
    assert linear is not None or counts == made
