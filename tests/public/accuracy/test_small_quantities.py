"""Thresholds of splittings, from a little on either side: what one that is wrong would do to a motion.

A small quantity eps above a threshold must act. It is followed in one long step, over a time of about 1/(8 eps): left
out, it is missed by an eighth; kept, the result is as good as rounding lets it be. What is rounding must not act: it
would be a flow of its own, or refused.
"""

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co
from commuting_actions import acting
from rounding import UNIT_ROUNDOFF as U

pytestmark = [
    pytest.mark.sensitive,
    pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning", "ignore::coadjoint.RoundingWarning"),
]

COORDINATES = co.Splitting(order=1, parts="coordinates")
TURN = np.array([[0.0, -1.0], [1.0, 0.0]])
SO3, LORENTZ = co.algebras.so(3), co.algebras.get("so(p,q)", p=2, q=1)


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
        co.Splitting(order=2, rotation="rational", parts=parts).flow_table(system)
    except ValueError as refusal:
        assert "would not be a Poisson map" in str(refusal)
        return False
    return True


def parts_of(system):
    return len(co.Splitting().describe(system).parts)


def turned_about(axis, angle):
    with mpmath.workdps(60):
        reduced = float(mpmath.fmod(angle, 2 * mpmath.pi))
    return Rotation.from_rotvec(reduced * np.asarray(axis) / np.linalg.norm(axis)).as_matrix()


@pytest.mark.parametrize("power", [42, 45, 48])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_small_difference_of_moments_turns_a_body(axis, power):
    """Two of three numbers M are 2^-power apart: 4 times the threshold, or more. A shift by either leaves that."""
    M = np.array([1.0, 1.0 + 2.0**-power, 3.0])
    system = co.LiePoissonSystem(SO3, co.Quadratic(M), sign=-1)
    assert co.Splitting().describe(system).shift
    h = 2.0 ** (power - 3)
    A = co.integrate(system, np.eye(3)[axis], (0, h), h, attitude=True).attitude[-1]
    # The angle is exact: a power of two, and an eighth for the longer axis.
    expected = turned_about(np.eye(3)[axis], mpmath.mpf(h) + mpmath.mpf(axis) / 8)
    assert np.abs(A - expected).max() <= 32 * U


def test_what_a_shift_leaves_by_rounding_is_no_part():
    """Of a full inertia tensor two squares are left, with factors that are rounded."""
    rng = np.random.default_rng(7)
    for _ in range(20):
        B = rng.standard_normal((3, 3))
        assert parts_of(co.LiePoissonSystem(SO3, co.Quadratic(B @ B.T + np.eye(3)))) == 2


@pytest.mark.parametrize("power", [36, 39, 42])
def test_two_frequencies_are_not_taken_for_one(power):
    """A generator of so(4) that turns by 2 + eps and by eps: eight times the tolerance of D^3 = lam D, or more."""
    eps, algebra = 2.0**-power, co.algebras.so(4)
    commuting = next(j for j in range(1, 6) if not np.any(algebra.bracket(np.eye(6)[0], np.eye(6)[j])))
    form = np.eye(6)[0] + (1.0 + eps) * np.eye(6)[commuting]
    x = np.array([0.5, 0.7, -0.4, 0.9, 0.3, 0.6])
    h = 2.0**10 / (form @ x)
    sol = co.integrate(co.LiePoissonSystem(algebra, square_of(form)), x, (0, 128 * h), h, COORDINATES, save_every=128)
    # The form is rounded as 1 + eps is, (l.x) h a few times: the angle 2^17 has that relative error. Missed: 2^17 eps.
    assert np.abs(sol.x[-1] - flow_of(algebra, form, x, 128 * h)).max() <= 8 * U * 2.0**18 < 2.0**15 * eps


@pytest.mark.parametrize("power", [36, 40, 43])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_slow_boost_is_not_taken_for_nilpotent(power, sign):
    """D^3 = lam D with lam of size 2 eps, a difference of numbers of size one: seven times the tolerance, or more."""
    eps = sign * 2.0**-power
    forms = [np.eye(3)[i] + (1.0 + eps) * np.eye(3)[j] for i in range(3) for j in range(i)]
    # Of the three pairs of axes two have a boost and a rotation.
    traces = [np.trace(LORENTZ.coadjoint(form) @ LORENTZ.coadjoint(form)) for form in forms]
    slow = [form for form, trace in zip(forms, traces, strict=True) if 0 < abs(trace) < 1e-6]
    assert len(slow) == 2
    for form in slow:
        x = np.array([0.5, 0.7, -0.4])
        h = np.sqrt(0.5 / abs(eps)) / (form @ x)
        system = co.LiePoissonSystem(LORENTZ, square_of(form))
        found, expected = co.integrate(system, x, (0, h), h, COORDINATES).x[-1], flow_of(LORENTZ, form, x, h)
        # lam is as good as its difference, u/eps; taken for 0 it would miss a 24th or so.
        assert np.abs(found - expected).max() <= 64 * U / abs(eps) * np.abs(expected).max()


def full_tensors():
    """Of a full inertia tensor each square turns with one frequency, whatever was rounded."""
    rng = np.random.default_rng(5)
    for _ in range(60):
        B = rng.standard_normal((3, 3))
        yield SO3, co.Quadratic(B @ B.T + np.eye(3))


def null_forms():
    """l = cos(a) e_1 + sin(a) e_2 + e_3 is null in so(2,1) but for rounding."""
    squares = [np.trace(LORENTZ.coadjoint(row) @ LORENTZ.coadjoint(row)) for row in np.eye(3)]
    turning = int(np.argmin(squares))
    boosts = [k for k in range(3) if k != turning]
    for a in np.linspace(0.1, 6.1, 40):
        form = np.zeros(3)
        form[boosts[0]], form[boosts[1]], form[turning] = np.cos(a), np.sin(a), 1.0
        yield LORENTZ, square_of(form)


def sums_that_cancel():
    """A sum of coefficients, zero but for rounding, couples two planes that turn alike."""
    rng, zero, one = np.random.default_rng(6), np.zeros((2, 2)), np.eye(2)
    algebra = acting(*(np.block([[w * TURN, zero], [one, w * TURN]]) for w in (1.0, 2.0, 4.0)))
    for _ in range(40):
        p, q = rng.uniform(0.1, 1.0, 2)
        yield algebra, square_of([0, 0, 0, 0, p, q, -(p + q)])


def angles_along_forms():
    """Above 16 coordinates squares are completed in floats: the weights of an angle are a rounded multiple."""
    m = 18
    B = np.random.default_rng(11).standard_normal((m + 1, m + 1))
    yield acting(np.kron(np.eye(m // 2), TURN)), co.Quadratic(B @ B.T / m + np.eye(m + 1))


@pytest.mark.parametrize("drawn", [full_tensors, null_forms, sums_that_cancel, angles_along_forms])
def test_rational_rotations_serve_up_to_rounding(drawn):
    for algebra, energy in drawn():
        assert is_rational(co.LiePoissonSystem(algebra, energy))


def nearly_commuting(p, q):
    """Forms a1 + p a2 and b1 + q b2 with the bracket (1 - p q) z, in a nilpotent algebra of two steps."""
    brackets = {(0, 2): {4: 1.0}, (1, 3): {4: -1.0}, (0, 1): {5: 1.0}, (2, 3): {5: 1.0}}
    M = np.zeros((6, 6))
    M[:2, :2], M[2:4, 2:4] = np.outer((1, p), (1, p)), np.outer((1, q), (1, q))
    return co.LiePoissonSystem(co.LieAlgebra.from_brackets(6, brackets), co.Quadratic(M))


@pytest.mark.parametrize("power", [36, 42, 46])
def test_forms_that_nearly_commute_have_flows_of_their_own(power):
    """In one part, the step would be no Poisson map, by eps: seen in more digits."""
    system, method = nearly_commuting(1.0, 1.0 - 2.0**-power), co.Splitting(order=2)
    assert parts_of(system) == 2
    with mpmath.workdps(80):
        x, unit = (np.vectorize(mpmath.mpf)(v) for v in (np.linspace(-0.5, 0.75, 6), np.eye(6)))

        def step(state):
            return method.step(system, state, 0, mpmath.mpf(0.5))

        y, small = step(x), mpmath.mpf(10) ** -25
        P = np.stack([(step(x + small * e) - step(x - small * e)) / (2 * small) for e in unit], axis=1)
        constants = [[system.algebra.bracket(a, b) for b in np.eye(6)] for a in np.eye(6)]

        def structure(point):
            return np.array(
                [[sum(c * v for c, v in zip(row, point, strict=True)) for row in rows] for rows in constants]
            )

        assert np.abs(P @ structure(x) @ P.T - structure(y)).max() <= 1e-30


def test_forms_that_commute_up_to_rounding_are_one_part():
    """A bracket 1 - p q that is zero but for rounding leaves two flows that are one; two would cost more."""
    for p in np.random.default_rng(10).uniform(0.3, 0.9, 20):
        assert parts_of(nearly_commuting(p, 1.0 / p)) == 1
        assert parts_of(nearly_commuting(p, (1.0 + 2.0**-46) / p)) == 2


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


@pytest.mark.parametrize(("eps", "accepted"), [(0.0, True), (2.0**-50, True), (2.0**-44, False), (2.0**-40, False)])
def test_rational_rotations_need_one_frequency(eps, accepted):
    """Two planes that turn by w and by (1 + eps) w: with rational angles no Poisson map, by eps."""
    zero = np.zeros((2, 2))
    algebra = acting(np.block([[TURN, zero], [zero, (1.0 + eps) * TURN]]))
    assert is_rational(co.LiePoissonSystem(algebra, square_of([0, 0, 0, 0, 1.0]))) is accepted


@pytest.mark.parametrize("eps", [0.0, 2.0**-50, 2.0**-44, 2.0**-40, 0.25])
def test_rational_rotations_turn_the_group_by_its_own_frequency(eps):
    """A representation that turns by 1 + eps where the momentum turns by 1, and by the angle 2 atan(1) = pi/2."""
    representation = np.zeros((3, 2, 2))
    representation[2] = (1.0 + eps) * TURN
    system = co.LiePoissonSystem(acting(TURN), square_of([0, 0, 1.0]), representation=representation)
    run = (system, (1.0, 0.0, 2.0), (0, 1), 1.0, co.Splitting(rotation="rational"))
    g = co.integrate(*run, attitude=True).attitude[-1]
    with mpmath.workdps(40):
        c, s = (float(f((1 + mpmath.mpf(eps)) * mpmath.pi / 2)) for f in (mpmath.cos, mpmath.sin))
    assert np.abs(np.abs(g) - np.abs([[c, s], [s, c]])).max() <= 8 * U


@pytest.mark.parametrize("size", [1e150, 1e300])
def test_terms_that_leave_float64_are_the_largest(size):
    top = co.Quadratic(np.diag([1, 5, 2, 0, 0, 0]), linear=[size, 0, 0, 0, 0, 1.5])
    assert co.Splitting(order=4).describe(co.LiePoissonSystem(co.algebras.e(3), top)).flows
    assert co.Splitting().describe(co.systems.paper_a37(masses=(1.0, size / 1e10, 0.01))).flows
