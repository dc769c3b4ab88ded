"""The spherical midpoint: its equation, a Poisson map on spins of every arrangement."""

import math

import numpy as np
import pytest

import coadjoint as co
from drawn_matrices import full
from refusals import refused
from rounding import UNIT_ROUNDOFF

RNG = np.random.default_rng(3)
SO3 = co.algebras.so(3)


def arranged(order, sizes=(1.0, 1.0), extra=0):
    """Copies of so(3) with brackets of these sizes, their coordinates at the places `order`, beside commuting ones."""
    rows = [
        (order[3 * s + a], order[3 * s + b], order[3 * s + c], sign * size)
        for s, size in enumerate(sizes)
        for a, b, c, sign in ((0, 1, 2, 1.0), (1, 2, 0, 1.0), (0, 2, 1, -1.0))
    ]
    rows = [row if row[0] < row[1] else (row[1], row[0], row[2], -row[3]) for row in rows]
    return co.LieAlgebra(rows, dim=len(order) + extra, name="spins")


def coupled(algebra, sign=1):
    n = algebra.dim
    return co.LiePoissonSystem(algebra, co.Quadratic(full(n, n, 0.3), linear=np.linspace(-0.5, 0.8, n)), sign=sign)


WELL = (
    lambda y, t: 0.25 * y**4 + math.sin(2 * t) * y,
    lambda y, t: y**3 + math.sin(2 * t),
    lambda y, t: 3 * y**2 + 0 * t,
)
SYSTEMS = {
    "two": coupled(co.algebras.copies(SO3, 2)),
    "mixed coordinates, sign -1": coupled(arranged((4, 0, 3, 5, 1, 2)), -1),
    "brackets of other sizes, one turned": coupled(arranged((0, 1, 2, 3, 4, 5), (2.5, -0.5))),
    "beside two that commute": coupled(arranged((0, 1, 2, 3, 4, 5), extra=2)),
    "of the third and fourth degree": co.LiePoissonSystem(
        co.algebras.copies(SO3, 2),
        co.Polynomial(
            {(1, 1, 0, 0, 1, 0): 0.5, (0, 0, 1, 0, 0, 2): -0.3, (0, 2, 0, 1, 1, 0): 0.4, (2,) + (0,) * 5: 1.0}
        ),
    ),
    "driven": co.LiePoissonSystem(co.algebras.copies(SO3, 2), co.Separable({i: WELL for i in (0, 2, 4)})),
}


def start_of(system):
    return np.random.default_rng(system.dim).uniform(-1, 1, system.dim)


def spins_of(system):
    """Return the coordinates of each spin: those of one bracket."""
    order = (4, 0, 3, 5, 1, 2) if system is SYSTEMS["mixed coordinates, sign -1"] else range(6)
    return np.reshape(order, (2, 3))


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("h", [0.1, -0.1])
def test_the_equation_of_the_paper(name, h):
    """x' = x + h f(r (x + x') / |x + x'|), r the length of a spin, at the middle of the step."""
    system, t = SYSTEMS[name], 0.3
    x = start_of(system)
    new = co.stepper(system, co.SphericalMidpoint(), h)(x, t)
    y = (x + new) / 2
    for spin in spins_of(system):
        y[spin] = np.linalg.norm(x[spin]) * (x + new)[spin] / np.linalg.norm((x + new)[spin])
    assert np.max(np.abs(new - x - h * system.vector_field(y, t + h / 2))) < 64 * UNIT_ROUNDOFF
    assert np.max(np.abs(new - x)) > 1e-3


def drawn_pieces(rng):
    """Return drawn terms of one coordinate each on two spins and one commuting coordinate: (coordinate, m, linear)."""
    terms = []
    for spin in (0, 1):
        kind = rng.choice(["linear", "quadratic", "both"])
        if kind != "quadratic":
            terms += [(3 * spin + int(i), 0.0, rng.uniform(0.3, 1.0)) for i in rng.choice(3, 2, replace=False)]
        if kind != "linear":
            terms += [(3 * spin + i, rng.uniform(0.5, 2.0), 0.0) for i in range(3)]
    if rng.integers(2):
        terms.append((6, 1.0, 0.5))
    return [terms[k] for k in rng.permutation(len(terms))]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("seed", range(9))
def test_the_energy_is_declared_alike_however_it_is_divided(seed):
    """As one quadratic form, and as pieces in any order, the declaration is what a run keeps."""
    terms = drawn_pieces(np.random.default_rng(seed))
    algebra = arranged((0, 1, 2, 3, 4, 5), extra=1)
    linear, M = np.zeros(7), np.zeros(7)
    for i, m, b in terms:
        M[i] += m
        linear[i] += b
    pieces = [((i,), co.Quadratic([m], linear=[b])) for i, m, b in terms]
    spins = [range(3), range(3, 6)]
    kept = not any(np.any(M[list(spin)]) and np.any(linear[list(spin)]) for spin in spins)
    for H in (
        co.Quadratic(M, linear=linear),
        *(co.SplitHamiltonian(pieces[k:] + pieces[:k]) for k in range(len(pieces))),
    ):
        system = co.LiePoissonSystem(algebra, H)
        assert co.SphericalMidpoint().properties(system).energy == kept
    sol = co.integrate(system, start_of(system), (0, 20), 0.1, co.SphericalMidpoint())
    assert kept == (sol.drift()["energy"] < 1e-13)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("first", [True, False])
def test_functions_and_couplings_in_any_piece_are_no_sums_of_such_functions(first):
    """Nor are polynomials of higher degree."""
    plain = [((0,), co.Quadratic([1.0])), ((3,), co.Quadratic([2.0]))]
    wave = co.Separable({0: (np.cos, lambda y: -np.sin(y), lambda y: -np.cos(y))})
    for other in (((4,), wave), ((0, 3), co.Quadratic([[0.0, 1.0], [1.0, 0.0]])), ((5,), co.Polynomial({(3,): 1.0}))):
        pieces = [other, *plain] if first else [*plain, other]
        system = co.LiePoissonSystem(co.algebras.copies(SO3, 2), co.SplitHamiltonian(pieces))
        assert not co.SphericalMidpoint().properties(system).energy


def test_a_spin_without_length_stays():
    system = SYSTEMS["two"]
    x0 = np.array([0.3, 0.4, 0.5, 0, 0, 0])
    sol = co.integrate(system, x0, (0, 1), 0.1, co.SphericalMidpoint())
    assert np.all(sol.x[:, 3:] == 0) and np.max(np.abs(sol.x[-1, :3] - x0[:3])) > 0.1
    with refused(TypeError, "no direction"):
        co.stepper(system, co.SphericalMidpoint(), 0.1).tangent(x0)


def test_many_spins():
    """3000 spins on a ring, beside the equation."""
    count = 3000
    rows = np.arange(3 * count)
    from scipy.sparse import coo_array

    M = coo_array((np.tile([1.0, 0.8, 0.5], count), (rows, (rows + 3) % (3 * count))), shape=(3 * count,) * 2)
    system = co.LiePoissonSystem(co.algebras.copies(SO3, count), co.Quadratic((M + M.T).tocsr()), casimirs={})
    x = RNG.uniform(-1, 1, 3 * count)
    new = co.stepper(system, co.SphericalMidpoint(), 0.1)(x)
    middle, old = (x + new).reshape(-1, 3), x.reshape(-1, 3)
    y = middle * (np.linalg.norm(old, axis=1) / np.linalg.norm(middle, axis=1))[:, None]
    assert np.max(np.abs(new - x - 0.1 * system.vector_field(y.ravel()))) < 64 * UNIT_ROUNDOFF


def declared(values, sign=1):
    """Return two spins and a central coordinate in fields and couplings, and terms of the third degree."""
    M, linear, coefficients = values
    terms = {(1, 1, 0, 0, 1, 0, 0): coefficients[0], (0, 0, 2, 0, 0, 1, 0): coefficients[1]}
    H = co.Polynomial(terms) if M is None else co.Quadratic(M, linear)
    return co.LiePoissonSystem(arranged((0, 1, 2, 3, 4, 5), (2.5, -0.5), extra=1), H, sign=sign)


@pytest.mark.parametrize("method", [co.SphericalMidpoint(), co.Composition(co.SphericalMidpoint(), (0.7, -0.4, 0.7))])
@pytest.mark.parametrize("form", ["quadratic", "cubic"])
def test_derivatives_by_parameters_are_exact(method, form):
    """Backward in time, of several steps: `vjp` and `jvp` against Richardson differences of runs of other systems."""
    rng = np.random.default_rng(5)
    M, linear, pair = full(7, 7, 0.3), rng.uniform(-1, 1, 7), np.array([0.5, -0.3])
    values = (M, linear, pair) if form == "quadratic" else (None, None, pair)
    moved = rng.uniform(-1, 1, (7, 7)), rng.uniform(-1, 1, 7), rng.uniform(-1, 1, 2)
    directions = {"M": moved[0] + moved[0].T, "linear": moved[1]} if form == "quadratic" else {"coefficients": moved[2]}
    if form == "quadratic":
        moved = directions["M"], moved[1], 0 * pair
    x, span, h = rng.uniform(-1, 1, 7), (0.3, -0.3), 2.0**-9
    ready = co.prepare(declared(values, -1), method, step=0.1)
    sol, pullback = ready.vjp(x, span)
    weights = rng.uniform(-1, 1, sol.x.shape)
    gradient, tangents = pullback(x=weights), ready.jvp(x, span, directions)[1]
    assert set(gradient.rule.values()) == {"exact"}

    def along(distance):
        ends = [
            co.integrate(
                declared([v if v is None else v + s * distance * d for v, d in zip(values, moved, strict=True)], -1),
                x, span, 0.1, method,
            ).x
            for s in (1, -1)
        ]  # fmt: skip
        return (ends[0] - ends[1]) / (2 * distance)

    expected = (4 * along(h / 2) - along(h)) / 3  # with an error of some h^4 and of the round-off over h
    np.testing.assert_allclose(tangents.x, expected, rtol=0, atol=1e-9)
    found = sum(float(np.sum(gradient[name] * direction)) for name, direction in directions.items())
    assert abs(found - np.sum(weights * expected)) < 1e-8
    assert np.abs(expected).max() > 0.01


def test_derivatives_by_parameters_beside_inputs():
    """Of a run with its linear term as inputs: those by M and by the inputs, against differences of runs."""
    M, x, u, span = full(7, 7, 0.3), np.linspace(-1, 1, 7), {"linear": np.linspace(0.4, -0.3, 7)}, (1.0, 1.3)
    D, weights = full(7, 8), np.linspace(1, -1, 7)

    def ready(by=0.0):
        system = declared((M + by * D, np.zeros(7), (0, 0)))
        return co.prepare(system, co.SphericalMidpoint(), step=0.1, inputs=True)

    sol, pullback = ready().vjp(x, span, **u)
    gradient, h = pullback(x=np.concatenate([np.zeros((len(sol.x) - 1, 7)), weights[None]])), 2.0**-13

    def end(by_matrix, by_input):
        return ready(by_matrix).run(x, span, linear=u["linear"] + by_input).x[-1] @ weights

    assert abs(np.sum(gradient["M"] * D) - (end(h, 0) - end(-h, 0)) / (2 * h)) < 1e-7
    e = h * np.eye(7)[1]
    assert abs(gradient["inputs"]["linear"][1] - (end(0, e) - end(0, -e)) / (2 * h)) < 1e-7
