"""exp(t X) of what a Casimir shift leaves out, X from every kind of algebra: against a general exponential, at huge
times, near equal frequencies, and for sizes from underflow to overflow.
"""

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.tables.recording import schedule_of
from coadjoint.program.group_correction import unshift_tables
from coadjoint.program.parts.casimir_shifts import quadratic_casimirs
from coadjoint.runs.loops.shifted_attitude import unshifting

pytestmark = pytest.mark.thinned(3)

U = 2.0**-53
FACTORS = (0.75, -0.4375, 0.3125)
COMPACT = ("so(3)", "so(4)", "so(5)", "so(6)", "so(7)", "su(2)", "su(3)", "su(4)", "u(2)", "two su(3)")


def algebras():
    g = co.algebras
    return {
        "so(3)": g.so(3),
        "so(4)": g.so(4),
        **{f"so({n})": g.so(n) for n in (5, 6, 7)},
        "so(3,1)": g.get("so(p,q)", p=3, q=1),
        "so(2,1)": g.get("so(p,q)", p=2, q=1),
        **{f"su({n})": g.su(n) for n in (2, 3, 4)},
        "sl(2)": g.sl(2),
        "sl(3)": g.sl(3),
        "gl(2)": g.get("gl(n)", n=2),
        "u(2)": g.get("u(n)", n=2),
        "u(3)": g.get("u(n)", n=3),
        "sp(4)": g.get("sp(2n)", n=2),
        "e(2)": g.e(2),
        "e(3)": g.e(3),
        "A3,6": g.get("A3,6"),
        "A4,10": g.get("A4,10"),
        "A5,3": g.get("A5,3"),
        "three so(3)": g.copies(g.so(3), 3),
        "two su(3)": g.copies(g.su(3), 2),
    }


def shifts(algebra):
    """One Casimir, and all of them."""
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.arange(1.0, algebra.dim + 1)))
    every = [(found.polynomial, c) for found, c in zip(quadratic_casimirs(system).values(), FACTORS, strict=False)]
    return [tuple(every[:1]), tuple(every)][: len(every)]


def cases():
    for name, algebra in algebras().items():
        system = co.LiePoissonSystem(algebra, co.Quadratic(np.ones(algebra.dim)))
        for carried in (None, system.representation)[: 1 + (system.representation is not None)]:
            for number, shift in enumerate(shifts(algebra)):
                yield f"{name}, {'coadjoint' if carried is None else 'rho'}, {number + 1}", algebra, carried, shift


def generator(algebra, carried, shift, x, number=float):
    """X = -sign rho(grad) with sign = -1, without any table."""
    convert = np.vectorize(number, otypes=[object if number is not float else float])
    gradient = sum(convert(np.array(casimir.gradient(x), dtype=float)) * number(c) for casimir, c in shift)
    if carried is None:
        unit = np.eye(algebra.dim)
        matrices = np.array([algebra.coadjoint(row) for row in unit])
    else:
        matrices = carried
    return sum(gradient[i] * convert(matrices[i]) for i in range(algebra.dim))


def moved(algebra, carried, shift, x, time):
    """exp(t X)."""
    tables = unshift_tables(algebra, carried, -1, shift)
    d = tables.size
    held, out = np.tile(np.eye(d).reshape(1, 1, -1), (2, 1, 1)), np.empty((2, 1, d, d))
    unshifting(tables)(
        1.0, out, held.ctypes.data, np.array([x]), np.eye(d)[None], 0, 1, schedule_of(0.0, time, 1, 1, False)
    )
    assert np.array_equal(out[0, 0], np.eye(d))
    return out[1, 0]


def exact(X, time):
    with mpmath.workdps(60):
        found = mpmath.expm(mpmath.matrix(X.tolist()) * mpmath.mpf(time), method="taylor")
        return np.array(found.tolist(), dtype=float).reshape(X.shape)


@pytest.mark.thinned(50)
@pytest.mark.parametrize(("name", "algebra", "carried", "shift"), list(cases()), ids=[case[0] for case in cases()])
def test_against_a_general_exponential(name, algebra, carried, shift):
    x = np.random.default_rng(len(name)).standard_normal(algebra.dim)
    X = generator(algebra, carried, shift, x)
    for time in (1e-9, 0.4, -2.5):
        expected = exact(X, time)
        # X has a few roundings in each entry; they act for the whole time, and products of the size of exp follow.
        size = np.linalg.norm(time * X, 1)
        bound = 16 * len(X) * U * (1 + size) * np.exp(np.linalg.norm(time * (X + X.T) / 2, 2)) * (1 + size) ** 2
        assert np.abs(moved(algebra, carried, shift, x, time) - expected).max() <= bound, (name, time)


@pytest.mark.parametrize("time", [1e-12, 1.0, 1e5, 1e12])
@pytest.mark.parametrize("name", COMPACT)
def test_rotations_stay_rotations_at_any_time(name, time):
    algebra = algebras()[name]
    carried = co.LiePoissonSystem(algebra, co.Quadratic(np.ones(algebra.dim))).representation
    for shift in shifts(algebra):
        x = np.random.default_rng(7).standard_normal(algebra.dim)
        g = moved(algebra, carried, shift, x, time)
        # An orthonormal basis of sums of d products, twice.
        assert np.abs(g.T @ g - np.eye(len(g))).max() <= 16 * len(g) * U
        # What commutes with X still does: the momentum in space.
        X = generator(algebra, carried, shift, x)
        assert np.abs(g @ X - X @ g).max() <= 32 * len(g) * U * np.linalg.norm(X)


@pytest.mark.thinned(6)
@pytest.mark.parametrize("gap", [0.0, 2.0**-52, 1e-13, 1e-9, 1e-4])
@pytest.mark.parametrize("size", [4, 5, 6])
def test_frequencies_near_each_other(size, gap):
    """Planes that turn almost alike: orthonormal all the same, and each by its own frequency."""
    algebra = co.algebras.so(size)
    rho = co.LiePoissonSystem(algebra, co.Quadratic(np.ones(algebra.dim))).representation
    ((casimir, _),) = shifts(algebra)[0]
    Q = np.linalg.qr(np.random.default_rng(size).standard_normal((size, size)))[0]
    plane = np.array([[0.0, -1.0], [1.0, 0.0]])
    X = np.zeros((size, size))
    X[:2, :2], X[2:4, 2:4] = plane, (1.0 + gap) * plane
    X = np.tril(Q @ X @ Q.T, -1)
    X = X - X.T
    basis = [np.argwhere(np.tril(matrix))[0] for matrix in rho]
    signs = [np.tril(matrix)[tuple(place)] for matrix, place in zip(rho, basis, strict=True)]
    wanted = np.array([X[tuple(place)] / sign for place, sign in zip(basis, signs, strict=True)])
    x = wanted / np.asarray(casimir.gradient(np.ones(algebra.dim)), dtype=float)
    X = generator(algebra, rho, ((casimir, 1.0),), x)
    assert np.sort(np.abs(np.linalg.eigvals(X)))[-1] == pytest.approx(1.0 + gap, rel=16 * U)
    for time in (1.0, 1e4):
        g = moved(algebra, rho, ((casimir, 1.0),), x, time)
        assert np.abs(g.T @ g - np.eye(size)).max() <= 16 * size * U
        # Rounding of the frequencies turns by u time.
        assert np.abs(g - exact(X, time)).max() <= 16 * size * U * (1 + time)
