"""Inputs of other kinds, orders, signs and sizes: the same numbers give the same system, in every way to write them."""

import itertools
from fractions import Fraction
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.sparse import coo_array
from spins_by_hand import by_hand

import coadjoint as co
from coadjoint.systems.lattices.neighbours import graph
from long import long_where

NAMES = co.systems.names()


def is_number(value):
    return isinstance(value, int | float) and not isinstance(value, bool)


def mapped(value, change):
    """A parameter with every number in it changed."""
    if isinstance(value, dict):
        return {key: mapped(entry, change) for key, entry in value.items()}
    if isinstance(value, tuple | list):
        return type(value)(mapped(entry, change) for entry in value)
    return change(value) if is_number(value) else value


def numbers(value):
    """All numbers of a parameter."""
    found = []
    mapped(value, lambda number: found.append(number) or number)
    return found


@cache
def base(name):
    return co.systems.get(name).parameters


@cache
def real_parameters(name):
    """Parameters of a ready-made system that are real numbers, not counts, with their example values."""
    parameters = base(name)
    return {
        key: value
        for key, value in parameters.items()
        if numbers(value) and not any(type(n) is int for n in numbers(value))
    }


def made(name, changed):
    """The system, or None where its parameters are refused."""
    try:
        return co.systems.get(name, **{**base(name), **changed})
    except (ValueError, TypeError):
        return None


def fields(system):
    """Field, energy, Casimirs and integrals at a state, to the last bit."""
    x = np.cos(1.0 + np.arange(system.dim))
    if hasattr(system, "from_vector"):  # a state of matrices
        x = system.algebra.projected(system.from_vector(x))
    known = {**system.casimirs, **getattr(system, "integrals", {})}
    return {
        "parameters": system.parameters,
        "field": np.asarray(system.vector_field(x)).tobytes(),
        **{key: float(getattr(F, "value", F)(x)) for key, F in known.items()},
    }


KINDS = {
    "int": int,
    "int64": np.int64,
    "Fraction": Fraction,
    "float32": np.float32,
    "array of int8": np.int8,
    "array of uint8": np.uint8,
    "view": float,
}


def written(value, kind):
    """A parameter in another type; arrays of small integers would overflow in products."""
    if isinstance(value, dict):
        return {key: written(entry, kind) for key, entry in value.items()}
    if not isinstance(value, tuple | list):
        return KINDS[kind](value)
    if kind.startswith("array"):
        return np.array(value).astype(KINDS[kind])
    if kind == "view":
        return np.repeat(value, 2, axis=-1)[..., ::2]
    return mapped(list(value), KINDS[kind])


@pytest.mark.thinned(9)
@pytest.mark.filterwarnings("ignore:.*no body has")
@pytest.mark.parametrize("name", long_where(["double_spherical_pendulum", "sphere_euler"], NAMES))
def test_whole_numbers_are_the_same_in_every_type(name):
    """Up to 100, whose products leave eight bits; whether they are accepted is the same as well."""
    for largest in (3, 100):
        for key, value in real_parameters(name).items():
            rng = np.random.default_rng(len(name) + largest)
            whole = mapped(
                value, lambda n, rng=rng, most=largest: float(rng.integers(1, most, endpoint=True)) if n else 0.0
            )
            expected = made(name, {key: whole})
            for kind in KINDS:
                found = made(name, {key: written(whole, kind)})
                assert (found is None) == (expected is None), (key, whole, kind)
                if found is not None:
                    assert fields(found) == fields(expected), (key, kind)


@pytest.mark.thinned(3)
@pytest.mark.filterwarnings("ignore:.*no body has")
@pytest.mark.parametrize("name", NAMES)
def test_every_number_is_kept_and_matters(name):
    """Each in turn, where that is accepted: in the parameters, and in the field or the energy."""
    x = np.cos(1.0 + np.arange(co.systems.get(name).dim)) / 2

    def looks(system):
        state = system.algebra.projected(system.from_vector(x)) if hasattr(system, "from_vector") else x
        return np.append(np.asarray(system.vector_field(state)).ravel(), system.energy(state))

    first = looks(co.systems.get(name))
    for key, value in real_parameters(name).items():
        for place in range(len(numbers(value))):
            at = itertools.count()
            changed = mapped(value, lambda n: 1.25 * n or 0.375 if next(at) == place else n)  # noqa: B023
            system = made(name, {key: changed})
            if system is not None:
                assert system.parameters == {**base(name), key: changed}
                assert np.abs(looks(system) - first).max() > 1e-6, (key, place)


# The signs of couplings.


def followed(system, x, T):
    found = solve_ivp(lambda t, y: system.vector_field(y, t), (0.0, T), x, "DOP853", rtol=1e-12, atol=1e-13)
    return found.y[:, -1]


def by_differences(system, x):
    """J(x) grad H by the structure constants, entry by entry, and central differences of H."""
    h = 2.0**-14
    slope = [
        (system.hamiltonian.value(x + h * e) - system.hamiltonian.value(x - h * e)) / (2 * h) for e in np.eye(len(x))
    ]
    field = np.zeros(len(x))
    for i, j, k, c in zip(*(part.tolist() for part in system.algebra.triples), strict=True):
        field[i] += system.sign * c * x[k] * slope[j]
        field[j] -= system.sign * c * x[k] * slope[i]
    return field


@pytest.mark.thinned(6)
@pytest.mark.filterwarnings("ignore:.*no body has")
@pytest.mark.parametrize("name", [n for n in NAMES if isinstance(co.systems.get(n), co.LiePoissonSystem)])
def test_couplings_of_either_sign_move_as_their_energy_says(name):
    """Each number in turn with the other sign, where that is accepted: the field, and a run by different flows."""
    ways = [None, co.GaussLegendre(3), co.Splitting(order=6, parts="bonds")]
    count = 0
    for key, value in real_parameters(name).items():
        for place, number in enumerate(numbers(value)):
            at = itertools.count()
            changed = mapped(value, lambda n: -(n or 0.375) if next(at) == place else n)  # noqa: B023
            system = made(name, {key: changed})
            if system is None:
                continue
            count += 1
            rng = np.random.default_rng(place)
            x = rng.uniform(0.5, 1.0, system.dim) * np.where(rng.random(system.dim) < 0.5, -1.0, 1.0)
            field = system.vector_field(x)
            # Of the differences: the third derivatives times h^2, and u / h.
            assert np.abs(field - by_differences(system, x)).max() <= 2.0**-24 * max(1.0, np.abs(field).max()), key
            T = 0.125 / max(1.0, np.abs(field).max())
            expected = followed(system, x, T)
            for way in ways:
                try:
                    end = co.integrate(system, x, (0.0, T), T / 16, way or co.Splitting(order=6)).x[-1]
                except (ValueError, TypeError):
                    assert way is None or isinstance(way, co.Splitting)
                    continue
                assert np.abs(end - expected).max() <= 1e-9 * np.abs(expected).max(), (key, place, number, way)
    assert count or all(n > 0 for n in numbers(list(real_parameters(name).values())))


@pytest.mark.thinned(6)
@pytest.mark.parametrize(
    ("lattice", "sites"),
    [("chain", 2), ("chain", 8), ("chain", 9), ("chain", 65), ("ring", 3), ("ring", 64), ("ring", 129), ("square", 33)],
)
def test_lattices_of_every_size_with_couplings_of_either_sign(lattice, sites):
    """Across 8 and 64 sites, up to which constants are listed one by one and parts are compared in pairs."""
    shape = (sites, 2) if lattice == "square" else sites
    count = 2 * sites if lattice == "square" else sites
    edges = graph(lattice, shape, False)[1].tolist()
    rng = np.random.default_rng(count)
    J = rng.uniform(0.5, 1.5, len(edges)) * np.where(rng.random(len(edges)) < 0.5, -1.0, 1.0)
    S = rng.standard_normal((count, 3))
    S /= np.linalg.norm(S, axis=1, keepdims=True)
    given = {
        "tensor": (1.0, -0.5, 2.0),
        "dm": (0.25, -0.5, 0.125),
        "field": (-0.5, 0.25, 1.0),
        "on_site": (-0.5, 0.25, 0),
    }
    order = rng.permutation(len(edges))
    pairs = [edges[k] for k in order]
    system = co.systems.spin_lattice(pairs, count, exchange=J[order], **given)
    tensors, axes = np.array([np.diag(given["tensor"])] * len(edges)), np.array([given["dm"]] * len(edges))
    on_site = np.array([np.diag(given["on_site"])] * count)
    expected = by_hand(S.ravel(), edges, J, tensors, axes, on_site, np.array([given["field"]] * count))
    found = system.vector_field(S.ravel())
    scale = 64 * 2.0**-53 * max(1.0, np.abs(expected).max())
    assert np.abs(found - expected).max() <= scale
    # An isotropic one by bonds, against another scheme.
    plain = co.systems.spin_lattice(pairs, count, exchange=J[order], field=given["field"])
    named = co.systems.spin_lattice(lattice, shape, exchange=-1.0)
    alike = co.systems.spin_lattice(edges, count, exchange=-np.ones(len(edges)))
    assert np.abs(named.vector_field(S.ravel()) - alike.vector_field(S.ravel())).max() <= scale
    h = 1.0 / 64
    ends = [
        co.integrate(plain, S.ravel(), (0.0, 4 * h), h, method).x[-1]
        for method in (co.Splitting(order=8, parts="bonds"), co.Splitting(order=8), co.GaussLegendre(4))
    ]
    assert max(np.abs(end - ends[-1]).max() for end in ends) <= 1e-11


@pytest.mark.thinned(4)
@pytest.mark.parametrize("sites", [3, 8, 9, 63, 64, 65, 129])
def test_rings_of_every_size(sites):
    """b_k' and a_k' of a Toda ring by Flaschka's formulas, and its invariants along a run."""
    rng = np.random.default_rng(sites)
    b, a = rng.uniform(-1.0, 1.0, sites), rng.uniform(0.5, 1.0, sites)
    system = co.systems.toda_ring(sites)
    x = np.concatenate([b, a])
    found = system.vector_field(x)
    expected = np.concatenate([2 * (a**2 - np.roll(a, 1) ** 2), a * (np.roll(b, -1) - b)])
    assert np.abs(found - expected).max() <= 64 * 2.0**-53 * np.abs(expected).max()
    T = 0.25
    ends = [
        co.integrate(system, x, (0.0, T), T / 16, method).x[-1] for method in (co.Splitting(order=8), co.Taylor(16))
    ]
    assert np.abs(ends[0] - ends[1]).max() <= 1e-10
    L = np.diag(ends[1][:sites]) + np.diag(ends[1][sites:-1], 1) + np.diag(ends[1][sites:-1], -1)
    L[0, -1] = L[-1, 0] = L[0, -1] + ends[1][-1]
    start = np.diag(b) + np.diag(a[:-1], 1) + np.diag(a[:-1], -1)
    start[0, -1] = start[-1, 0] = start[0, -1] + a[-1]
    assert np.abs(np.linalg.eigvalsh(L) - np.linalg.eigvalsh(start)).max() <= sites * 2.0**-48


@pytest.mark.thinned(6)
@pytest.mark.parametrize("N", [2, 3, 15, 16, 17, 31, 32, 33, 63, 64, 65, 129])
def test_matrices_of_every_size(N):
    """Across the blocks in which products of matrices are computed: a compiled step, and the same one in NumPy."""
    rng = np.random.default_rng(N)
    bodies = [co.systems.matrix_body(rng.uniform(1.0, 2.0, N))] if N > 2 else []
    for system in (*bodies, co.systems.sphere_euler(N)):
        drawn = rng.standard_normal((2, N, N))
        W = system.algebra.projected(drawn[0] + 1j * drawn[1] if system.complex else drawn[0])
        W /= np.linalg.norm(W)
        P = system.stream_of(W)
        assert np.abs(system.vector_field(W) - (P @ W - W @ P)).max() <= N * 2.0**-50 * np.abs(P).max()
        h = 0.0625
        end = co.integrate(system, W, (0.0, h), h, co.IsospectralGauss(1)).x[-1]
        # The midpoint M of W = (1 - h/2 P) M (1 + h/2 P), P that of M, and then the end (1 + h/2 P) M (1 - h/2 P).
        M = W
        for _ in range(60):
            P = h / 2 * system.stream_of(M)
            M = np.linalg.solve(np.eye(N) - P, np.linalg.solve((np.eye(N) + P).T, W.T).T)
        P = h / 2 * system.stream_of(M)
        assert np.abs(end - (np.eye(N) + P) @ M @ (np.eye(N) - P)).max() <= N * 2.0**-50


@pytest.mark.parametrize("n", [2, 3, 7, 8, 9, 11, 12])
@pytest.mark.parametrize("family", ["so", "su"])
def test_algebras_of_every_size(family, n):
    """Dimensions on both sides of 64: brackets are those of matrices."""
    if family == "su" and n > 9:
        return
    algebra = getattr(co.algebras, family)(n)
    rho, rng = algebra.representation, np.random.default_rng(n)
    x, y = rng.standard_normal((2, algebra.dim))
    X, Y = (np.tensordot(v, rho, axes=1) for v in (x, y))
    found = np.tensordot(algebra.bracket(x, y), rho, axes=1)
    assert np.abs(found - (X @ Y - Y @ X)).max() <= algebra.dim * 2.0**-48


# The order of mappings and lists.


def orders(items, draws=4):
    """Some permutations, the reverse among them."""
    items = list(items)
    rng = np.random.default_rng(len(items))
    return [items, items[::-1], *([items[k] for k in rng.permutation(len(items))] for _ in range(draws))]


def random_basis(algebra, seed):
    """The same algebra in a basis that mixes all elements, in whole numbers."""
    n = algebra.dim
    rng = np.random.default_rng(seed)
    P = np.tril(rng.integers(-1, 2, (n, n)), -1) + np.eye(n, dtype=int)
    inverse = np.rint(np.linalg.inv(P)).astype(int)
    basis = [algebra.bracket(P[i], P[j]) @ inverse for i in range(n) for j in range(n)]
    return {
        (i, j): {k: float(c) for k, c in enumerate(basis[i * n + j]) if c}
        for i in range(n)
        for j in range(i)
        if np.any(basis[i * n + j])
    }


@pytest.mark.parametrize("name", ["so(3)", "so(4)", "e(3)", "sl(2)"])
def test_brackets_in_any_order(name):
    brackets = random_basis(co.algebras.get(name), 1)
    dim = co.algebras.get(name).dim
    expected = co.LieAlgebra.from_brackets(dim, brackets)
    x = np.cos(np.arange(dim))
    for order in orders(brackets.items()):
        for inner in (list, lambda own: list(own)[::-1]):
            given = {pair: dict(inner(own.items())) for pair, own in order}
            turned = {(j, i): {k: -c for k, c in own.items()} for (i, j), own in given.items()}
            for one in (given, turned):
                found = co.LieAlgebra.from_brackets(dim, one)
                assert found == expected and hash(found) == hash(expected)
                assert np.array_equal(found.structure_matrix(x), expected.structure_matrix(x))
    rows = np.column_stack(expected.triples)
    for order in orders(range(len(rows))):
        assert co.LieAlgebra(rows[order], dim=dim) == expected


@pytest.mark.parametrize("dim", [3, 5, 9, 17])
def test_monomials_couplings_and_functions_in_any_order(dim):
    """A mapping from places to numbers, such as {2: 2, 0: 3}, names its places."""
    rng = np.random.default_rng(dim)
    x = rng.standard_normal(dim)
    monomials = {
        tuple(e): float(c) for e, c in zip(rng.integers(0, 3, (12, dim)).tolist(), rng.normal(size=12), strict=True)
    }
    expected = co.Polynomial(monomials)
    for order in orders(monomials.items()):
        found = co.Polynomial(dict(order))
        assert found == expected and found(x) == expected(x) and str(found) == str(expected)
        assert np.array_equal(found.gradient(x), expected.gradient(x))
    M = np.triu(rng.standard_normal((dim, dim)))
    M = M + M.T
    i, j = np.nonzero(M)
    dense = co.Quadratic(M).bind(dim)
    for order in orders(range(len(i))):
        sparse = co.Quadratic(coo_array((M[i, j][order], (i[order], j[order])), shape=(dim, dim))).bind(dim)
        assert np.array_equal(sparse.gradient(x), dense.gradient(x)) and sparse.value(x) == dense.value(x)
    some = rng.permutation(dim)[: dim - 1].tolist()
    functions = {k: (lambda q, k=k: np.cos(q + k), lambda q, k=k: -np.sin(q + k)) for k in some}
    whole = co.Separable(functions).bind(dim)
    for order in orders(functions.items()):
        found = co.Separable(dict(order)).bind(dim)
        slope = np.zeros(dim)
        slope[some] = [-np.sin(x[k] + k) for k in some]
        assert np.array_equal(found.gradient(x), slope)
        assert np.isclose(found.value(x), whole.value(x), rtol=8 * 2.0**-53 * dim)


def pieces(coordinates):
    """A piece H = sum_k (k + 1) cos(x_k) that gets its coordinates in the order in which they are named."""
    weights = np.array(coordinates) + 1.0
    return (
        tuple(coordinates),
        co.Hamiltonian(lambda y: np.sum(weights * np.cos(y)), lambda y: -weights * np.sin(y)),
    )


def test_pieces_and_their_coordinates_in_any_order():
    x = np.cos(1.0 + np.arange(6))
    slope = -(np.arange(6) + 1.0) * np.sin(x)
    for first in itertools.permutations((0, 2, 5)):
        for order in ((0, 1), (1, 0)):
            given = [pieces(first), pieces((4, 3, 1))]
            found = co.SplitHamiltonian([given[k] for k in order]).bind(6)
            np.testing.assert_array_equal(found.gradient(x), slope)


@pytest.mark.parametrize("make", [co.systems.sphere_euler, co.systems.torus_euler])
def test_modes_in_any_order(make):
    system = make(N=9)
    modes = {(2, 1): 0.5 + 0.25j, (3, 2): -1.0j, (4, 1): 2.0, (1, 1): 0.125}
    expected = system.from_modes(modes)
    for order in orders(modes.items()):
        np.testing.assert_array_equal(system.from_modes(dict(order)), expected)


def test_observables_events_and_casimirs_in_any_order():
    body = co.systems.rigid_body((1, 2, 3))
    functions = {"a": lambda x: x[0] * x[1], "b": lambda x: x[2] ** 2, "c": lambda x: x[0]}
    events = [co.Event("x1", name="first"), co.Event("x2", name="second"), co.Event(2, name="third")]
    run = {"x0": (1.0, 0.5, -0.75), "t_span": (0.0, 8.0), "step": 0.0625}
    expected = co.integrate(body, observe=functions, events=events, **run)
    for watched, looked in zip(orders(functions.items()), orders(range(3)), strict=True):
        found = co.integrate(body, observe=dict(watched), events=[events[k] for k in looked], **run)
        assert np.array_equal(found.x, expected.x)
        for key in functions:
            assert np.array_equal(found.observed[key], expected.observed[key])
        times = {
            e.name: found.events.t[found.events.which == k].tolist() for k, e in enumerate(events[k] for k in looked)
        }
        assert times == {e.name: expected.events.t[expected.events.which == k].tolist() for k, e in enumerate(events)}
    casimirs = {"C1": co.Quadratic((1.0, 1.0, 1.0)), "C2": co.Polynomial({(2, 0, 0): 2, (0, 2, 0): 2, (0, 0, 2): 2})}
    drifts = [
        co.integrate(
            co.LiePoissonSystem(co.algebras.so(3), co.Quadratic((1, 2, 3)), casimirs=dict(order)),
            method=co.Taylor(8, projected=False),
            **run,
        ).drift()
        for order in orders(casimirs.items())
    ]
    assert all(drift == drifts[0] for drift in drifts)
