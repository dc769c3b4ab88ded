"""Casimir shifts, their factors, orders of parts, and the h^2 term that decides between them."""

import json
from itertools import permutations

import numpy as np
import pytest
from scipy.linalg import eigh

import coadjoint as co
from coadjoint.program.modified_energy.second_order import part_derivatives, second_order_term
from coadjoint.program.parts.chosen_parts import ChosenParts
from coadjoint.program.parts.decompose import best_decomposition, best_decompositions, decompose
from coadjoint.program.parts.order_of_parts import best_order
from coadjoint.program.parts.split import split
from coadjoint.program.shifts.pencil import singular_factors
from coadjoint.program.shifts.shift import quadratic_casimirs, shifted_terms

pytestmark = pytest.mark.sensitive

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


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", NAMES)
def test_the_momentum_moves_as_without_a_shift(name):
    system = systems()[name]
    x0 = np.random.default_rng(1).standard_normal(system.dim)
    reference = co.integrate(system, x0, (0, 1), 0.05, co.GaussLegendre(6)).x[-1]
    errors = [
        np.abs(co.integrate(system, x0, (0, 1), h, co.Splitting(order=4)).x[-1] - reference).max() for h in (0.02, 0.01)
    ]
    assert errors[0] < 1e-3 and errors[1] < errors[0] / 12 + 1e-13  # order 4: a factor 16


def test_a_shift_removes_a_part():
    for name, (plain, chosen) in {"so(3)": (3, 2), "so(3), full": (3, 2), "spins": (3, 1 + 1)}.items():
        system = systems()[name]
        assert len(split(system, "auto")) == plain
        found = decompose(system, "auto")
        assert len(found.parts) <= plain
        if name != "spins":
            assert len(found.parts) == chosen and found.shift


def test_the_middle_moment_is_taken_off():
    assert decompose(systems()["so(3)"], "auto").choice.shift == (("|x|^2", 0.25),)  # of |x|^2 = 2 |x|^2/2: m = 1/2


@pytest.mark.parametrize("name", ["so(3)", "so(4)", "e(3)", "A3,7"])
def test_the_same_system_gives_the_same_choice(name):
    first, second = (decompose(systems()[name], "auto") for _ in range(2))
    assert first.choice == second.choice
    again = decompose(systems()[name], first.choice)
    assert again.parts[0].forms == first.parts[0].forms and again.choice == first.choice


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
    found = second_order_term(system.algebra, split(system, "coordinates"), x)
    np.testing.assert_allclose(found, expected, rtol=0, atol=200 * U * np.abs(x).max() ** 4)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", NAMES)
def test_energy_error_is_the_second_order_term(name):
    """H + h^2 H2 is kept to O(h^4): halving h divides its largest change by 16, that of H by 4."""
    system = systems()[name]
    method = co.Splitting(order=2, parts=decompose(system, "auto").choice)
    parts = decompose(system, method.parts).parts
    x0 = 0.5 * np.random.default_rng(2).standard_normal(system.dim)
    changes = []
    for h in (0.05, 0.025):
        sol = co.integrate(system, x0, (0, 2), h, method)
        modified = sol.energy + h**2 * second_order_term(system.algebra, parts, sol.x)
        changes.append((np.abs(sol.energy - sol.energy[0]).max(), np.abs(modified - modified[0]).max()))
    if changes[0][0] > 1e-12:  # one part alone is exact
        assert changes[0][0] / changes[1][0] < 5
        assert changes[0][1] / max(changes[1][1], 1e-15) > 12 or changes[0][1] < 1e-13


def test_the_best_order_is_the_best_of_all():
    system = systems()["so(3)"]
    parts = split(system, "coordinates")
    points = np.random.default_rng(0).standard_normal((50, 3))
    order, size = best_order(system, parts, points)
    sizes = {
        p: np.sqrt(np.mean(second_order_term(system.algebra, parts.take(np.array(p)), points) ** 2))
        for p in permutations(range(3))
    }
    assert order == min(sizes, key=sizes.get) and size == pytest.approx(min(sizes.values()), rel=1e-12)


def test_a_cancelled_entry_is_gone():
    system = systems()["so(3)"]
    (term,) = shifted_terms(system.hamiltonian.terms(), quadratic_casimirs(system), (("|x|^2", 1.0 / 6.0),))
    assert term.rows.tolist() == [0, 1]


def test_refusals():
    system = systems()["so(3)"]
    with pytest.raises(ValueError, match="not a permutation"):
        ChosenParts((0, 2))
    with pytest.raises(ValueError, match="orders 3 parts, but paper_rigid_body has 2"):
        decompose(system, ChosenParts((0, 1, 2), (("|x|^2", 0.25),)))
    with pytest.raises(ValueError, match="the shift names 'C9'; the quadratic Casimirs are"):
        decompose(system, ChosenParts((0, 1), (("C9", 0.25),)))


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
        forms = [part.forms for part in found.parts]
        assert forms == [part.forms for part in decompose(driven, choice).parts] and len(forms) == count
        x = np.array([0.5, -1.0, 0.25])
        gradient = part_derivatives(found.parts, x[None])[0].sum(axis=(0, 1))
        assert np.array_equal(gradient, system.hamiltonian.gradient(x) - 2.0 * x)
    with pytest.raises(ValueError, match=r"parts names coordinate 3; .* has 3 of them"):
        decompose(free, ChosenParts((0, 1), SHIFT, (*linear, 3)))


SHIFT = (("|x|^2", 1.0),)


def test_many_systems_at_once_are_decomposed_as_each_alone():
    """Every choice and factor the same, to the bit: equal moments, full matrices and other structure constants too."""
    rng = np.random.default_rng(7)
    groups = [
        [co.systems.rigid_body(tuple(I)) for I in [*rng.uniform(1, 3, (20, 3)), (2, 2, 1), (1, 1, 1), (1, 2, 2)]],
        [co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(full(3) * rng.uniform(0.5, 2))) for _ in range(4)],
        [co.LiePoissonSystem(co.algebras.get("A3,7", a=a), co.Quadratic([1.0, a, 0.5])) for a in (0.5, 1.0, 2.0, 3.0)],
        [co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(rng.uniform(0.5, 2, 6))) for _ in range(4)],
    ]
    points = rng.standard_normal((5, 6))
    for systems in groups:
        own = points[:, : systems[0].dim]
        for together, system in zip(best_decompositions(systems, own), systems, strict=True):
            alone = best_decomposition(system, own)
            assert together.choice == alone.choice
            assert [part.forms for part in together.parts] == [part.forms for part in alone.parts]


def test_parts_of_one_pattern_have_the_entries_of_each_matrix():
    """What is remembered of a pattern of zeros holds no entry, and another pattern is another one."""
    g = co.algebras.e(3)
    for M, linear in ((np.arange(1.0, 7), None), (np.arange(2.0, 8), None), (np.arange(1.0, 7), np.eye(6)[4])):
        system = co.LiePoissonSystem(g, co.Quadratic(M, linear=linear))
        x = np.linspace(-1, 1, 6)
        gradient = part_derivatives(split(system, "auto"), x[None])[0][:, 0].sum(axis=0)
        assert np.array_equal(gradient, system.hamiltonian.gradient(x))


@pytest.mark.parametrize("size", [1e150, 1e300])
def test_terms_that_leave_float64_are_the_largest(size):
    top = co.LiePoissonSystem(
        co.algebras.e(3), co.Quadratic(np.diag([1, 5, 2, 0, 0, 0]), linear=[size, 0, 0, 0, 0, 1.5])
    )
    assert co.Splitting(order=4).describe(top)
    body = co.systems.paper_a37(masses=(1.0, size / 1e10, 0.01))
    assert co.Splitting().describe(body)


@pytest.mark.parametrize(
    ("matrix", "casimir", "factors"),
    [
        (np.ones((3, 3)), np.eye(3), (0.0, 0.0, 3.0)),
        (np.ones((3, 3)), -2.0 * np.eye(3), (-1.5, 0.0, 0.0)),
        (np.array([[0.0, 1.0], [1.0, 0.0]]), np.diag([1.0, 4.0]), (-0.5, 0.5)),
        # Pivots of very different sizes: the smallest one bounds the factors.
        (np.array([[0.0, 1.0], [1.0, 0.0]]), np.diag([2.0**-10, 2.0**10]), (-1.0, 1.0)),
        (np.ones((2, 2)), -np.diag([2.0**-10, 1.0]), (-1025.0, 0.0)),
    ],
)
def test_known_factors(matrix, casimir, factors):
    """64 halvings of an interval of 4 n^2 max|M| / min|C|, and the float beyond the factor."""
    found = singular_factors(matrix, casimir)
    width = 4.0 * matrix.size * np.abs(matrix).max() / np.abs(np.diag(casimir)).min()
    assert found == pytest.approx(factors, rel=4 * U, abs=width * 2.0**-64)


def test_none_where_there_is_nothing_to_find():
    coupled = np.ones((2, 2))
    assert singular_factors(np.diag([1.0, 2.0]), np.eye(2)) == ()
    assert singular_factors(coupled, np.diag([1.0, -1.0])) == ()
    assert singular_factors(coupled, np.diag([1.0, 0.0])) == ()


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
