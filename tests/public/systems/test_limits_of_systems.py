"""Limits of what systems, forces and states accept, and what is taken as rounding: just inside and just outside."""

import warnings

import numpy as np
import pytest
from brackets import U
from scipy.sparse import csr_array

import coadjoint as co
from refusals import refused

S, F = co.systems, co.forces
SO3 = co.algebras.so(3)


def accepted(call, *words):
    """Return whether a call is not refused; a refusal must have the words in its message."""
    try:
        call()
    except (ValueError, TypeError) as refusal:
        assert all(word in str(refusal) for word in words), str(refusal)
        return False
    return True


def silent(call):
    """Return whether a call warns of nothing."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", co.LongWait)  # of a busy machine
        call()
    return not caught


def moved(matrix, place, size):
    changed = np.array(matrix, dtype=np.result_type(np.asarray(matrix), float))
    changed[place] += size
    return changed


SPHERE, TORUS = S.sphere_euler(8), S.torus_euler(9)
SO4 = co.MatrixAlgebra("so", 4)
SYMMETRIC = [[1.0, 0.5], [0.5, 0.25]]


def nearly_even(off):
    """1 for positive r, and for negative r a little more; no derivative sees that."""
    zero = lambda r: 0.0 * r  # noqa: E731
    return (lambda r: 1.0 + (2.0 * off if r < 0 else 0.0), zero, zero, zero)


class Stated:
    """A Hamiltonian |x|^2 / 2 whose terms are those of another number."""

    dim, timed = 3, False

    def __init__(self, off):
        known, other = (co.Quadratic(np.full(3, number)).bind(3) for number in (1.0, 1.0 + off))
        self.value, self.gradient, self.hessian, self.terms = known.value, known.gradient, known.hessian, other.terms

    def bind(self, n):
        return self


def field_of(s, place, size):
    """A field of an array of coefficients with a mode of size two and another entry."""
    c = np.zeros(s.degrees.shape, dtype=complex)
    c[3, 2] = 2.0
    if s is TORUS:
        c[-3, -2] = 2.0
    c[place] += size
    return s.from_modes(c)


def modes_left(s, small):
    """Return whether a mode of relative size `small` is dropped beside one of size 1."""
    first, second = ((3, 2), (4, 1)) if s is SPHERE else ((1, 2), (1, 1))
    return second not in s.modes(s.from_modes({first: 1.0, second: small}))


def stream_off(part):
    """A linear stream of so(4), and part of another map."""
    return co.MatrixSystem(SO4, lambda W: 2.0 * W + part(W))


def skew_part(W):
    return np.array([[0.0, W[0, 2], 0, 0], [-W[0, 2], 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])


def two_principal_values_vanish(light):
    """So that inertia is refused: the sum of the two smallest is `light` of the largest."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return not accepted(lambda: S.so_n_body(np.diag([0.0, light, 1.0])), "their sum")


def last_pivot_vanishes(pivot):
    """A tridiagonal operator on two entries of the diagonal, whose second pivot is a part of its entry."""
    main = np.array([[1.0, 2.0], [1.0 / (1.0 - pivot), 0.0]])
    return S.DiagonalSolve(main, np.array([[0.0, 0.0], [1.0, 0.0]]), 1.0).table.reshape(2, 2, 2)[1, 1, 0] == 0.0


# Calls that are accepted up to a threshold, and a word of their refusal; tried at half and at twice of it.
CALLS = {
    "M is symmetric": (lambda off: co.Quadratic(moved(SYMMETRIC, (0, 1), off)), "symmetric", 64 * U),
    "a sparse M is symmetric": (
        lambda off: co.Quadratic(csr_array(moved(SYMMETRIC, (0, 1), off))), "symmetric", 64 * U,
    ),
    "an inertia tensor is symmetric": (
        lambda off: S.rigid_body(moved(np.diag([2.0] * 3), (0, 1), 2.0 * off)), "symmetric", 64 * U,
    ),
    # Of I = c = (1, 2, 3) the absolute products add up to 1 * 5 + 2 * 4 + 3 * 3 = 22; c3 counts I1 - I2 = -1 times.
    "coefficients are of a Clebsch case": (
        lambda off: S.clebsch_body((1.0, 2.0, 3.0), (1.0, 2.0, 3.0 + 22.0 * off)), "Clebsch", 8 * U,
    ),
    "a pair potential is even": (lambda off: S.decorated_particles(pair=nearly_even(off)), "even", 64 * U),
    "terms and gradient agree": (lambda off: co.LiePoissonSystem(SO3, Stated(2.0 * off)), "contradict", 2.0**10 * U),
    "a structure matrix is skew": (
        lambda off: co.PoissonSystem(lambda x: np.array([[0.0, 1.0], [-1.0 + off, 0.0]]), co.Quadratic((1.0, 2.0))),
        "skew", 64 * U,
    ),
    "modes of a sphere are of a real field": (
        lambda off: SPHERE.from_modes({(3, 2): 2.0, (3, -2): 2.0 * (1.0 + off)}), "real", 1e-12,
    ),
    "modes of a torus are of a real field": (
        lambda off: TORUS.from_modes({(1, 2): 2.0, (-1, -2): 2.0 * (1.0 + off)}), "conj", 1e-12,
    ),
    **{
        f"coefficients are of a real field: {s.name} {place}": (
            lambda off, s=s, place=place, factor=factor: field_of(s, place, factor * off), "", 1e-12,
        )
        for s, place, factor in (
            (SPHERE, (3, 0), 2j), (SPHERE, (2, 3), 2.0), (SPHERE, (0, 0), 2.0), (TORUS, (-3, -2), 2.0),
            (TORUS, (0, 0), 2.0),
        )
    },
    "a flow moves nothing in no time": (
        lambda off: S.rigid_body((1, 2, 3)).with_forces(F.OwnForce(lambda x, t, tau: x * (1.0 + off))), "tau = 0", 1e-9,
    ),
    "a metric is positive up to rounding": (
        lambda below: F.DoubleBracketDamping(0.1, np.diag((1.0, -below, 1.0))), "semidefinite", 3 * 64 * U,
    ),
    "a stream is in the algebra": (
        lambda off: stream_off(lambda W: 8.0 * off * np.abs(W).max() * np.eye(4)), "", 1e-12,
    ),
    "a mass is not large": (lambda size: S.satellite(mass=size), "mass", 2.0**1022),
    "a mass is not small": (lambda size: S.satellite(mass=1 / size), "mass", 2.0**1022),
    "products are not large": (lambda size: S.satellite(mass=size, gravity=2.0**500), "products", 2.0**522),
    "a sphere turns slowly": (lambda turn: S.sphere_euler(4, turn), "", 1e100),
    "a sphere turns slowly westward": (lambda turn: S.sphere_euler(4, -turn), "", 1e100),
    "a weight is not large": (lambda size: S.decorated_particles(weights=(1.0, size)), "", 1e50),
    "a weight is not small": (lambda size: S.decorated_particles(weights=(1.0, 1.0 / size)), "", 1e50),
    "a potential is in range": (lambda size: S.decorated_particles(external=(0.0, 0.0, size)), "external", 1e50),
    "a coupling is in range": (lambda size: S.spin_lattice("chain", 3, exchange=size), "exch", 1e100),
}  # fmt: skip
# Other decisions that are positive up to a threshold.
SCALES = {
    "a moment is the sum of the others": (lambda e: silent(lambda: S.rigid_body((1.0, 1.0, 2.0 + 4.0 * e))), 64 * U),
    "a mass is negative by rounding": (lambda share: silent(lambda: S.so_n_body((-share, 1.0, 1.0))), 64 * U),
    "two principal values of a tensor vanish": (two_principal_values_vanish, 12 * U),
    "a mode of a sphere is rounding": (lambda size: modes_left(SPHERE, size), 1e-14),
    "a mode of a torus is rounding": (lambda size: modes_left(TORUS, size), 1e-14),
    "a last pivot vanishes": (last_pivot_vanishes, 1e-10),
    **{
        name: (lambda value, make=make, word=word: accepted(lambda: make(value), word), threshold)
        for name, (make, word, threshold) in CALLS.items()
    },
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", SCALES)
def test_half_and_twice_a_threshold(name):
    decision, threshold = SCALES[name]
    assert decision(0.5 * threshold) and not decision(2.0 * threshold)


H123, H124 = co.Quadratic((1, 2, 3)), co.Quadratic((1.0, 2.0, 4.0))


@pytest.mark.parametrize(
    ("make", "word", "inside", "outside"),
    [
        # The rounding of 64 to 73 products and of their sums, against the largest products at the sample points.
        (lambda off: co.LiePoissonSystem(SO3, H123, casimirs={"C": co.Quadratic((1.0, 1.0, 1.0 + off))}), "Casimir",
         16 * U, 2.0**10 * U),
        (lambda off: co.LiePoissonSystem(SO3, H124, integrals={"F": co.Quadratic((1.0, 2.0, 4.0 * (1.0 + off)))}),
         "integral", 16 * U, 2.0**10 * U),
        # Differences over u^(1/3) have the relative error u^(2/3), times 2^10 for the functions of users: a function
        # that is 1, and a gradient that is the same everywhere.
        (lambda off: co.Hamiltonian(lambda x: 1.0, lambda x: np.full(4, off)).bind(4), "contradicts",
         2.0**5 * U ** (2 / 3), 2.0**14 * U ** (2 / 3)),
        # Of the sizes of products of two drawn states, which differ by some factor from W itself.
        (lambda off: stream_off(lambda W: off * (W @ W @ W)), "", 1e-14, 1e-9),
        (lambda off: stream_off(lambda W: off * skew_part(W)), "", 1e-14, 1e-9),
        (lambda c: co.MatrixSystem(SO4, lambda W: 2.0 * W, energy=lambda W: (1.0 + c) * SO4.pairing(W, W)), "gradient",
         2.0**-26, 2.0**-16),
    ],
)  # fmt: skip
def test_thresholds_relative_to_drawn_points(make, word, inside, outside):
    assert accepted(lambda: make(inside), word) and not accepted(lambda: make(outside), word)


# Decisions that are positive up to a whole number, and not for the next one.
COUNTS = {
    "lengths of spins are recorded": (lambda n: "sum of |x|^2" not in S.spin_lattice("chain", n).casimirs, 682),
    "the square of the total spin is given": (
        lambda n: "|total S|^2" in S.spin_lattice("chain", n, field=(0.0, 0.0, 0.5)).integrals,
        64,
    ),
    "all traces of a Toda lattice are given": (lambda n: f"tr L^{n}" in S.toda(n).integrals, 8),
    "traces of a Toda lattice are given": (lambda n: bool(S.toda(n).integrals), 64),
    "integrals of higher degree are given": (
        lambda n: "X^4 a" in S.manakov_top(np.arange(1.0, n + 1), np.arange(1.0, n + 1) ** 2).integrals,
        6,
    ),
    # Powers from 1 to n - 2, and 10 at most.
    "there is an integral for each power": (
        lambda n: len(S.manakov_top(np.arange(1.0, n + 1), np.arange(1.0, n + 1) ** 2).integrals) == n - 2,
        12,
    ),
    "powers of traces are in range": (
        lambda p: accepted(lambda: co.MatrixSystem(SO4, lambda W: 2.0 * W, powers=p), "powers"),
        64,
    ),
    "a written potential is short": (
        lambda letters: accepted(lambda: S.vlasov_moments(potential="1/2*x20".ljust(letters)), "characters"),
        10_000,
    ),
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", COUNTS)
def test_a_count_and_the_next_one(name):
    decision, last = COUNTS[name]
    assert decision(last) and not decision(last + 1)


def test_sizes_of_lattices_and_tori():
    assert accepted(lambda: S.torus_euler(1001)) and not accepted(lambda: S.torus_euler(1003), "1001")
    for count, word in ((2**30, "edge"), (2**30 + 1, "shape")):
        # Below the limit an edge that leaves the lattice is refused.
        with refused(ValueError, word):
            S.spin_lattice([[0, 2**31]], count)
    for count, kept in ((2**15 - 100, True), (2**15 + 1, False)):  # numbers of a list of edges, two for each
        ring = np.stack([np.arange(count), np.roll(np.arange(count), -1)], axis=1)
        assert (S.spin_lattice(ring, count).parameters is not None) == kept


@pytest.mark.parametrize(("off", "read"), [(0.5e-5, True), (2e-5, False)])
def test_coordinates_of_fields_are_equally_spaced(off, read, tmp_path):
    xarray = pytest.importorskip("xarray")
    x, y = TORUS.grid((16, 16))
    field = xarray.DataArray(TORUS.to_grid(TORUS.random(1), (16, 16)), {"x": moved(x, 3, off), "y": y}, ("x", "y"))
    field.to_dataset(name="w").to_netcdf(tmp_path / "field.nc", engine="h5netcdf")
    assert accepted(lambda: TORUS.from_file(tmp_path / "field.nc"), "spaced") == read
