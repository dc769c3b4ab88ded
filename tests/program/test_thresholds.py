"""Every threshold of the programs, from a little on either side: what one that is wrong would do to a motion.

A small quantity eps above a threshold must act. It is followed in one long step, over a time of about 1/(8 eps): left
out, it is missed by an eighth; kept, the result is as good as rounding lets it be.
"""

from fractions import Fraction
from functools import cache

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co
from coadjoint.program.interpreter import Interpreter
from coadjoint.program.parts.chosen_parts import ChosenParts
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.order_of_parts import best_order
from coadjoint.program.parts.sparse_squares import _Reduction
from coadjoint.program.parts.split import split
from coadjoint.program.parts.squares import complete_squares
from coadjoint.program.shifts.group_correction import Turn, unshift_tables
from coadjoint.program.shifts.shift import count_parts, quadratic_casimirs, shifted_terms
from coadjoint.program.sparse_rows import SparseRows
from coadjoint.program.table import build_program
from commuting_actions import acting

pytestmark = pytest.mark.sensitive

U = 2.0**-53
COORDINATES = co.Splitting(order=1, parts="coordinates")
TURN = np.array([[0.0, -1.0], [1.0, 0.0]])


def square_of(form):
    """H = (l.x)^2 / 2."""
    return co.Quadratic(np.outer(form, form))


def flow_of(algebra, form, x, time):
    """exp(time (l.x) D_l) x, in 60 digits."""
    with mpmath.workdps(60):
        D = sum(
            mpmath.mpf(c) * mpmath.matrix(algebra.coadjoint(row).tolist())
            for c, row in zip(form, np.eye(len(form)), strict=True)
        )
        angle = mpmath.mpf(time) * sum(mpmath.mpf(c) * mpmath.mpf(v) for c, v in zip(form, x, strict=True))
        return np.array(
            (mpmath.expm(angle * D, method="taylor") * mpmath.matrix(list(x))).tolist(), dtype=float
        ).ravel()


def is_rational(system, parts="coordinates"):
    """Whether rational rotations are Poisson maps for a system, in the judgement of the library."""
    try:
        build_program(system, co.Splitting(order=2, rotation="rational", parts=parts))
    except ValueError as refusal:
        assert "would not be a Poisson map" in str(refusal)
        return False
    return True


def turned_about(axis, angle):
    with mpmath.workdps(60):
        reduced = float(mpmath.fmod(angle, 2 * mpmath.pi))
    return Rotation.from_rotvec(reduced * np.asarray(axis) / np.linalg.norm(axis)).as_matrix()


# What a shift leaves: ROUNDING.


@pytest.mark.parametrize("power", [42, 45, 48])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_small_difference_of_moments_turns_a_body(axis, power):
    """Two of three numbers M are 2^-power apart: 4 times the threshold, or more. A shift by either leaves that."""
    M = np.array([1.0, 1.0 + 2.0**-power, 3.0])
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M), sign=-1)
    assert decompose(system, "auto").shift
    h = 2.0 ** (power - 3)
    A = co.integrate(system, np.eye(3)[axis], (0, h), h, attitude=True).attitude[-1]
    # The angle is exact: a power of two, and an eighth for the longer axis.
    expected = turned_about(np.eye(3)[axis], mpmath.mpf(h) + mpmath.mpf(axis) / 8)
    assert np.abs(A - expected).max() <= 32 * U


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


@pytest.mark.parametrize("power", [40, 47, 49, 51, 52])
def test_parts_are_counted_as_they_are_made(power):
    """78 coordinates are too many for parts to be made for each shift; counting uses a threshold of its own."""
    M = np.random.default_rng(4).uniform(0.5, 2.0, 78)
    M[1] = M[0] * (1.0 + 2.0**-power)
    system = co.LiePoissonSystem(co.algebras.so(13), co.Quadratic(M))
    casimirs = quadratic_casimirs(system)
    ((name, casimir),) = casimirs.items()
    shifts = [((name, M[k] / casimir.values[k]),) for k in range(3)]
    made = [len(split(system, "auto", shifted_terms(system.hamiltonian.terms(), casimirs, s))) for s in shifts]
    assert count_parts(system, casimirs, shifts).tolist() == made


# Kinds of blocks: what counts as D^3 = lam D, or as nilpotent.


@pytest.mark.parametrize("power", [36, 39, 42])
def test_two_frequencies_are_not_taken_for_one(power):
    """A generator of so(4) that turns by 2 + eps and by eps: eight times the tolerance of D^3 = lam D, or more."""
    eps = 2.0**-power
    algebra = co.algebras.so(4)
    commuting = next(j for j in range(1, 6) if not np.any(algebra.bracket(np.eye(6)[0], np.eye(6)[j])))
    form = np.eye(6)[0] + (1.0 + eps) * np.eye(6)[commuting]
    x = np.array([0.5, 0.7, -0.4, 0.9, 0.3, 0.6])
    h = 2.0**10 / (form @ x)
    sol = co.integrate(co.LiePoissonSystem(algebra, square_of(form)), x, (0, 128 * h), h, COORDINATES, save_every=128)
    # The form is rounded as 1 + eps is, (l.x) h a few times: the angle 2^17 has that relative error. Missed: 2^17 eps.
    assert np.abs(sol.x[-1] - flow_of(algebra, form, x, 128 * h)).max() <= 8 * U * 2.0**18 < 2.0**15 * eps


def test_a_rotation_is_one_up_to_rounding():
    """Of a full inertia tensor each square turns with one frequency: rational rotations serve, whatever was rounded."""
    rng = np.random.default_rng(5)
    for _ in range(60):
        B = rng.standard_normal((3, 3))
        assert is_rational(co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(B @ B.T + np.eye(3))))


@pytest.mark.parametrize("power", [36, 40, 43])
def test_a_slow_boost_is_not_taken_for_nilpotent(power):
    """D^3 = lam D with lam of size 2 eps, a difference of numbers of size one: seven times the tolerance, or more."""
    algebra = co.algebras.get("so(p,q)", p=2, q=1)
    for eps in (2.0**-power, -(2.0**-power)):
        forms = [np.eye(3)[i] + (1.0 + eps) * np.eye(3)[j] for i in range(3) for j in range(i)]
        # Of the three pairs of axes two have a boost and a rotation.
        traces = [np.trace(algebra.coadjoint(form) @ algebra.coadjoint(form)) for form in forms]
        slow = [form for form, trace in zip(forms, traces, strict=True) if 0 < abs(trace) < 1e-6]
        assert len(slow) == 2
        for form in slow:
            x = np.array([0.5, 0.7, -0.4])
            h = np.sqrt(0.5 / abs(eps)) / (form @ x)
            system = co.LiePoissonSystem(algebra, square_of(form))
            found, expected = co.integrate(system, x, (0, h), h, COORDINATES).x[-1], flow_of(algebra, form, x, h)
            # lam is as good as its difference, u/eps; taken for 0 it would miss a 24th or so.
            assert np.abs(found - expected).max() <= 64 * U / abs(eps) * np.abs(expected).max()


def test_nilpotent_is_nilpotent_up_to_rounding():
    """l = cos(a) e_1 + sin(a) e_2 + e_3 is null in so(2,1) but for rounding."""
    algebra = co.algebras.get("so(p,q)", p=2, q=1)
    squares = [np.trace(algebra.coadjoint(row) @ algebra.coadjoint(row)) for row in np.eye(3)]
    turning = int(np.argmin(squares))
    boosts = [k for k in range(3) if k != turning]
    for a in np.linspace(0.1, 6.1, 40):
        form = np.zeros(3)
        form[boosts[0]], form[boosts[1]], form[turning] = np.cos(a), np.sin(a), 1.0
        assert is_rational(co.LiePoissonSystem(algebra, square_of(form)))


# What commutes: BRACKET_ROUNDOFF.


def nearly_commuting(p, q):
    """Forms a1 + p a2 and b1 + q b2 with the bracket (1 - p q) z, in a nilpotent algebra of two steps."""
    brackets = {(0, 2): {4: 1.0}, (1, 3): {4: -1.0}, (0, 1): {5: 1.0}, (2, 3): {5: 1.0}}
    algebra = co.LieAlgebra.from_brackets(6, brackets)
    M = np.zeros((6, 6))
    M[:2, :2], M[2:4, 2:4] = np.outer((1, p), (1, p)), np.outer((1, q), (1, q))
    return co.LiePoissonSystem(algebra, co.Quadratic(M))


@pytest.mark.parametrize("power", [36, 42, 46])
def test_forms_that_nearly_commute_have_flows_of_their_own(power):
    """In one part, the step would be no Poisson map, by eps: seen in more digits."""
    system = nearly_commuting(1.0, 1.0 - 2.0**-power)
    read = Interpreter(build_program(system, co.Splitting(order=2), number=mpmath.mpf))
    with mpmath.workdps(50):
        x, unit = (np.vectorize(mpmath.mpf)(v) for v in (np.linspace(-0.5, 0.75, 6), np.eye(6)))
        y, P = read.steps(x, mpmath.mpf(0.5), 2, tangent=unit)
        constants = [[system.algebra.bracket(a, b) for b in np.eye(6)] for a in np.eye(6)]

        def structure(point):
            return np.array(
                [[sum(c * v for c, v in zip(row, point, strict=True)) for row in rows] for rows in constants]
            )

        assert np.abs(P @ structure(x) @ P.T - structure(y)).max() <= 1e-30


def test_forms_that_commute_up_to_rounding_are_one_part():
    """A bracket 1 - p q that is zero but for rounding leaves two flows that are one; two would cost more."""
    for p in np.random.default_rng(10).uniform(0.3, 0.9, 40):
        assert len(decompose(nearly_commuting(p, 1.0 / p), "auto").parts) == 1
        assert len(decompose(nearly_commuting(p, (1.0 + 2.0**-46) / p), "auto").parts) == 2


# Entries of a generator: sums that cancel.


@pytest.mark.parametrize("power", [41, 44, 47])
def test_a_slow_rotation_that_is_a_difference_turns(power):
    """Of two generators one plane gets eps, 8 times the threshold or more, the other one 1 + eps."""
    eps, zero = 2.0**-power, np.zeros((2, 2))
    algebra = acting(np.block([[TURN, zero], [zero, 2 * TURN]]), np.block([[TURN, zero], [zero, TURN]]))
    form = np.array([0, 0, 0, 0, 1.0, -(1.0 - eps)])
    x = np.array([1.0, 0.0, 1.0, 0.0, 1.0, 0.0])
    h = 2.0 ** (power - 3)
    found = co.integrate(co.LiePoissonSystem(algebra, square_of(form)), x, (0, h), h, COORDINATES).x[-1]
    assert np.abs(found - flow_of(algebra, form, x, h)).max() <= 16 * U
    assert found[0] == pytest.approx(np.cos(0.125), abs=4 * U)


def test_what_cancels_up_to_rounding_ties_nothing_together():
    """A sum of coefficients, zero but for rounding, couples two planes that turn alike; kept, it would be refused."""
    rng, zero, one = np.random.default_rng(6), np.zeros((2, 2)), np.eye(2)
    algebra = acting(*(np.block([[w * TURN, zero], [one, w * TURN]]) for w in (1.0, 2.0, 4.0)))
    for _ in range(40):
        p, q = rng.uniform(0.1, 1.0, 2)
        assert is_rational(co.LiePoissonSystem(algebra, square_of([0, 0, 0, 0, p, q, -(p + q)])))


# Completed squares: those below the rounding of the entries.


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


@pytest.mark.long
def test_squares_that_a_shift_leaves_by_rounding_are_no_parts():
    rng = np.random.default_rng(7)
    for _ in range(60):
        B = rng.standard_normal((3, 3))
        system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(B @ B.T + np.eye(3)))
        assert len(decompose(system, "auto").parts) == 2


def triangular_product(last):
    """A matrix of 20 rows with the squares 1, ..., 1 and a last one, all in whole numbers but that."""
    L = np.tril(np.random.default_rng(8).integers(-1, 2, (20, 20)), -1) + np.eye(20)
    return L @ np.diag([*[1.0] * 19, last]) @ L.T


def squares_by_rows(matrix, linear):
    rows = [np.flatnonzero(row).tolist() for row in matrix]
    values = [[float(row[k]) for k in own] for row, own in zip(matrix, rows, strict=True)]
    found = _Reduction(SparseRows.of_lists(rows, values), linear).squares()
    forms = np.zeros((len(found.weights), len(linear)))
    forms[found.forms.owner, found.forms.coordinate] = found.forms.value
    return forms, found.weights


@pytest.mark.parametrize(
    "complete", [lambda *given: complete_squares(*given)[:2], squares_by_rows], ids=["dense", "sparse"]
)
def test_squares_of_many_coordinates_leave_out_what_is_rounding_and_nothing_else(complete):
    """Above 16 coordinates squares are completed in floats: n u times the largest entry is rounding."""
    singular = triangular_product(0.0)
    floor = 4 * 20 * U * np.abs(singular).max()
    forms, weights = complete(singular, np.zeros(20))
    assert len(weights) == 19
    for small in (16 * floor, 256 * floor):
        # The last square stands at the last coordinate alone.
        matrix = triangular_product(0.0)
        matrix[-1, -1] += small
        forms, weights = complete(matrix, np.zeros(20))
        assert np.abs(np.einsum("r,ri,rj->ij", weights, forms, forms) - matrix).max() <= floor


# Rational rotations: which frequencies are one.


@pytest.mark.parametrize(("eps", "accepted"), [(0.0, True), (2.0**-50, True), (2.0**-44, False), (2.0**-40, False)])
def test_rational_rotations_need_one_frequency(eps, accepted):
    """Two planes that turn by w and by (1 + eps) w: with rational angles no Poisson map, by eps."""
    zero = np.zeros((2, 2))
    algebra = acting(np.block([[TURN, zero], [zero, (1.0 + eps) * TURN]]))
    assert is_rational(co.LiePoissonSystem(algebra, square_of([0, 0, 0, 0, 1.0]))) is accepted


def test_angles_along_their_forms_are_so_up_to_rounding():
    """Above 16 coordinates squares are completed in floats: the weights of an angle are a rounded multiple."""
    m = 18
    algebra = acting(np.kron(np.eye(m // 2), TURN))
    B = np.random.default_rng(11).standard_normal((m + 1, m + 1))
    assert is_rational(co.LiePoissonSystem(algebra, co.Quadratic(B @ B.T / m + np.eye(m + 1))))


@pytest.mark.parametrize("eps", [0.0, 2.0**-50, 2.0**-44, 2.0**-40, 0.25])
def test_rational_rotations_turn_the_group_by_its_own_frequency(eps):
    """A representation that turns by 1 + eps where the momentum turns by 1, and by the angle 2 atan(1) = pi/2."""
    representation = np.zeros((3, 2, 2))
    representation[2] = (1.0 + eps) * TURN
    system = co.LiePoissonSystem(acting(TURN), square_of([0, 0, 1.0]), representation=representation)
    g = co.integrate(system, (1.0, 0.0, 2.0), (0, 1), 1.0, co.Splitting(rotation="rational"), attitude=True).attitude[
        -1
    ]
    with mpmath.workdps(40):
        c, s = (float(f((1 + mpmath.mpf(eps)) * mpmath.pi / 2)) for f in (mpmath.cos, mpmath.sin))
    assert np.abs(np.abs(g) - np.abs([[c, s], [s, c]])).max() <= 8 * U


# The order of parts: what is clearly smaller.


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
        order, _ = best_order(system, split(system, [[0], [1], [j]]), points)
        if abs(order.index(1) - order.index(2)) == 1:
            neighbours += 1
            assert order.index(1) < order.index(2)
    assert neighbours > 10


# What a shift does to the group: which closed form.


def elements(algebra, carried, shift, x, time, exactly=True):
    """exp(t X) of the library and in 60 digits."""
    from coadjoint.kernels.tables.casimir_shift import CompiledShiftCorrection
    from coadjoint.kernels.tables.recording import schedule_of

    tables = unshift_tables(algebra, carried, -1, shift)
    held, out = np.tile(np.eye(tables.size).reshape(1, 1, -1), (2, 1, 1)), np.empty((2, 1, tables.size, tables.size))
    CompiledShiftCorrection(tables, 1.0).fill(
        out, held.ctypes.data, np.array([x]), np.eye(tables.size)[None], 0, 1, schedule_of(0.0, time, 1, 1, False)
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


def test_cubic_is_found_in_rounded_bases():
    """so(2,1) turns or stretches by D^3 = lam D."""
    lorentz = co.algebras.get("so(p,q)", p=2, q=1)
    inverse = fractions(np.diag([1 / np.trace(lorentz.coadjoint(row) @ lorentz.coadjoint(row)) for row in np.eye(3)]))
    for seed in range(16):
        algebra, Q = in_rounded_basis(lorentz, seed)
        tables = unshift_tables(algebra, None, -1, ((quadratic(Q.dot(inverse).dot(Q.T)), 1.0),))
        assert [Turn(kind).name for kind in tables.kind] == ["CUBIC"]


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
