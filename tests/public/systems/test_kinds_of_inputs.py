"""Inputs of other kinds, orders, signs and sizes: the same numbers give the same system, in every way to write them."""

import itertools
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co

NAMES = co.systems.names()
# A diameter without depth has no effect.
FULL = {"rigid_molecules": {"lj": ((0.6, 0.3), (0.25, 0.125), (0.5, 0.25))}}


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
    return co.systems.get(name, **FULL.get(name, {})).parameters


@cache
def real_parameters(name):
    """Parameters of a ready-made system that are real numbers, not counts, with their example values."""
    return {key: value for key, value in base(name).items() if {type(n) for n in numbers(value)} == {float}}


def with_one_changed(name, change):
    """Yield each parameter, and the system with one of its numbers changed, or None where that is refused."""
    for key, value in real_parameters(name).items():
        for place in range(len(numbers(value))):
            at = itertools.count()
            changed = mapped(value, lambda n: change(n) if next(at) == place else n)  # noqa: B023
            yield key, changed, made(name, {key: changed})


def made(name, changed):
    """The system, or None where its parameters are refused."""
    try:
        return co.systems.get(name, **{**base(name), **changed})
    except (ValueError, TypeError):
        return None


def followed(system, x, T):
    found = solve_ivp(lambda t, y: system.vector_field(y, t), (0.0, T), x, "DOP853", rtol=1e-12, atol=1e-13)
    return found.y[:, -1]


def by_differences(system, x):
    """J(x) grad H by central differences of H."""
    h, H = 2.0**-14, system.hamiltonian.value
    slope = [(H(x + h * e) - H(x - h * e)) / (2 * h) for e in np.eye(len(x))]
    return system.sign * system.structure_matrix(x) @ slope


@pytest.mark.thinned(6)
@pytest.mark.filterwarnings("ignore:.*no body has")
@pytest.mark.parametrize("name", [n for n in NAMES if isinstance(co.systems.get(n), co.LiePoissonSystem)])
def test_couplings_of_either_sign_move_as_their_energy_says(name):
    """Each number in turn with the other sign, where that is accepted: the field, and a run by different flows."""
    ways = [co.Splitting(order=6), co.GaussLegendre(3), co.Splitting(order=6, parts="bonds")]
    count = 0
    for key, changed, system in with_one_changed(name, lambda n: -(n or 0.375)):
        if system is None:
            continue
        rng = np.random.default_rng(count)
        count += 1
        x = rng.uniform(0.5, 1.0, system.dim) * np.where(rng.random(system.dim) < 0.5, -1.0, 1.0)
        if "z" in system.casimirs:
            x[np.argmax(np.abs(system.casimirs["z"].gradient(x)))] = 1.0
        if name == "rigid_molecules":  # apart, and with the coordinate that makes momenta and positions canonical
            x[30:33], x[-1] = x[30:33] - 2.0, 1.0
        field = system.vector_field(x)
        # Of the differences: the third derivatives times h^2, and u / h.
        assert np.abs(field - by_differences(system, x)).max() <= 2.0**-24 * max(1.0, np.abs(field).max()), key
        T = 0.125 / max(1.0, np.abs(field).max())
        expected = followed(system, x, T)
        for way in ways:
            try:
                end = co.integrate(system, x, (0.0, T), T / 16, way).x[-1]
            except (ValueError, TypeError):
                assert isinstance(way, co.Splitting)
                continue
            assert np.abs(end - expected).max() <= 1e-9 * np.abs(expected).max(), (key, changed, way)
    assert count or all(n >= 0 for n in numbers(list(real_parameters(name).values())))


def orders(items, draws=4):
    """Some permutations, the reverse among them."""
    items = list(items)
    rng = np.random.default_rng(len(items))
    return [items, items[::-1], *([items[k] for k in rng.permutation(len(items))] for _ in range(draws))]


@pytest.mark.parametrize("dim", [3, 5, 9, 17])
def test_monomials_and_functions_in_any_order(dim):
    """A mapping from places to numbers, such as {2: 2, 0: 3}, names its places."""
    rng = np.random.default_rng(dim)
    x, exponents = rng.standard_normal(dim), rng.integers(0, 3, (12, dim)).tolist()
    monomials = {tuple(e): float(c) for e, c in zip(exponents, rng.normal(size=12), strict=True)}
    expected = co.Polynomial(monomials)
    for order in orders(monomials.items()):
        found = co.Polynomial(dict(order))
        assert found == expected and found(x) == expected(x) and str(found) == str(expected)
        assert np.array_equal(found.gradient(x), expected.gradient(x))
    some = rng.permutation(dim)[: dim - 1].tolist()
    functions = {k: (lambda q, k=k: np.cos(q + k), lambda q, k=k: -np.sin(q + k)) for k in some}
    whole = co.Separable(functions).bind(dim)
    for order in orders(functions.items()):
        found = co.Separable(dict(order)).bind(dim)
        slope = np.zeros(dim)
        slope[some] = [-np.sin(x[k] + k) for k in some]
        assert np.array_equal(found.gradient(x), slope)
        assert np.isclose(found.value(x), whole.value(x), rtol=8 * 2.0**-53 * dim)
