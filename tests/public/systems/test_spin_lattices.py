"""Spins on graphs: every coupling by hand, 40 digits, integrals, shapes."""

import functools
import itertools
import json
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from bonds_and_spins import PLACES, bonds, by_hand, energy_by_hand, has_closed_form, positions_of
from scipy.integrate import solve_ivp

import coadjoint as co
import refusals
from long import long_beyond
from rounding import UNIT_ROUNDOFF

spin_lattice = co.systems.spin_lattice
(FILE,) = Path(refusals.__file__).parent.rglob("lie_poisson_systems.json")
BY_NAME = {s["name"]: s for s in json.loads(FILE.read_text())["systems"]}

TOTALS = ["total S1", "total S2", "total S3"]


def spins_of(seed, count):
    return np.random.default_rng(seed).standard_normal(3 * count)


def test_one_for_all_is_each_the_same():
    edges = bonds("triangular", (3, 3), True)
    rng = np.random.default_rng(3)
    T, D, K, B = rng.standard_normal((3, 3)), rng.standard_normal(3), np.array([0.0, 0.3, -1.0]), rng.standard_normal(3)
    short = spin_lattice("triangular", (3, 3), True, 0.7, T, D, B, K)
    long = spin_lattice(
        edges, 9, False, np.full(27, 0.7), np.array([T] * 27), np.array([D] * 27), np.array([B] * 9), np.diag(K)
    )
    x = spins_of(1, 9)
    np.testing.assert_array_equal(short.vector_field(x), long.vector_field(x))


@pytest.mark.parametrize(("name", "lattice", "count"), [("heisenberg_2", "chain", 2), ("heisenberg_ring_3", "ring", 3)])
def test_reference_in_40_digits(name, lattice, count):
    reference, system = BY_NAME[name], spin_lattice(lattice, count)
    x0 = np.array([float(eval(v, {"__builtins__": {}})) for v in reference["x0"]])
    for late in reference["states"]:
        wanted = np.array([float(v) for v in late["x"]])
        np.testing.assert_allclose(system.exact(x0, late["t"]), wanted, rtol=0, atol=1e-15 * (2 + 3 * late["t"]))
        if late["t"] <= 5:
            run = co.integrate(system, x0, (0, float(late["t"])), 0.05, co.GaussLegendre(6))
            np.testing.assert_allclose(run.x[-1], wanted, rtol=0, atol=1e-13)


def rotation(axis, t):
    """exp of the matrix of S -> t S x axis, in 40 digits."""
    with mp.workdps(40):
        a, b, c = (mp.mpf(float(v)) * mp.mpf(float(t)) for v in axis)
        return mp.expm(mp.matrix([[0, c, -b], [-c, 0, a], [b, -a, 0]]))


@pytest.mark.parametrize("seed", range(4))
def test_complete_graph_in_a_field(seed):
    """S_i' = S_i x (J S + B): in the frame that turns about B they turn about the constant J S."""
    rng = np.random.default_rng(seed)
    count, J, B, t = 2 + seed, rng.standard_normal(), rng.standard_normal(3), rng.uniform(-9, 9)
    system, x0 = spin_lattice("complete", count, exchange=J, field=B), spins_of(seed, count)
    both = rotation(B, t) * rotation(J * x0.reshape(-1, 3).sum(axis=0), t)
    turn = np.array(both.tolist(), dtype=float)
    wanted = (x0.reshape(-1, 3) @ turn.T).ravel()
    np.testing.assert_allclose(system.exact(x0, t), wanted, rtol=0, atol=1e-13)
    times = np.array([0.0, t])
    np.testing.assert_array_equal(system.exact(x0, times), [x0, system.exact(x0, t)])
    start = co.integrate(system, x0, (0, -1.0), 0.05, co.GaussLegendre(stages=4)).x[-1]
    np.testing.assert_allclose(start, system.exact(x0, -1.0), rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ({}, TOTALS),
        ({"exchange": np.arange(1.0, 5.0)}, TOTALS),
        ({"on_site": (2, 2, 2)}, TOTALS),
        ({"exchange": 0.0, "tensor": (1, 2, 3)}, TOTALS),
        ({"tensor": (1, 1, 0.5)}, ["total S3"]),
        ({"tensor": (1, 0.5, 1), "dm": (0, 1, 0), "field": (0, 2, 0), "on_site": (0, 3, 0)}, ["total S2"]),
        ({"tensor": (1, 2, 3)}, []),
        ({"tensor": (1, 1, 0.5), "dm": (0, 1, 0)}, []),
        ({"field": (0, 3, 4)}, ["total S along (0, 0.75, 1)", "|total S|^2"]),
        ({"field": (-1, 0, 4)}, ["total S along (-0.25, 0, 1)", "|total S|^2"]),
        ({"dm": (2, 0, -0.5)}, ["total S along (1, 0, -0.25)"]),
        ({"field": np.array([(0, 1, 1), (0, -2, -2), (0, 1, 1 + 2**-40), (0, 0, 0)])}, []),
        ({"field": np.array([(0, 0, 1), (0, 0, 2), (0, 0, 0), (0, 0, -1)])}, ["total S3"]),
        ({"field": np.eye(4)[:, :3]}, []),
        (
            {"dm": np.array([(0.5, 1, 1.5), (1, 2, 3), (0, 0, 0), (-3, -6, -9)])},
            ["total S along (0.333333, 0.666667, 1)"],
        ),
        ({"field": lambda t: (0.0, np.sin(t), 1.0)}, ["|total S|^2"]),
        ({"field": lambda t: np.outer(np.arange(4.0), np.array([0.0, 0.0, np.cos(t)]))}, []),
    ],
)
def test_integrals_are_found(given, names):
    system = spin_lattice("ring", 4, **given)
    assert list(system.integrals) == names
    x = spins_of(5, 4)
    for t in (0.0, 0.7):
        field = system.vector_field(x, t)
        for F in system.integrals.values():
            assert abs(F.gradient(x) @ field) < 1e-13


def field_of_all(t):  # a tuple of numbers of different kinds
    return 0.5 * np.cos(2 * t), np.sin(2 * t), 0


def field_of_each(t):
    return np.array([[0.5 * np.cos(2 * t), np.sin(2 * t), 0.0], [0.2 * np.cos(2 * t), -0.4 * np.sin(2 * t), 1.0]])


@pytest.mark.parametrize("field", long_beyond(1, [field_of_each, field_of_all]))
def test_field_in_time(field):
    """The field of each spin by hand, the gradient by differences, and a run against a code of SciPy."""

    def rates(t, x):
        B = np.array(field(t), dtype=float) * np.ones((2, 1))
        zero = np.zeros((2, 3, 3))
        return by_hand(x, [(0, 1)], [1.0], np.diag([1, 0.5, 0.25])[None], zero[:1, 0], zero, B)

    system, x0 = spin_lattice(tensor=(1, 0.5, 0.25), field=field), spins_of(4, 2)
    np.testing.assert_allclose(system.vector_field(x0, 0.3), rates(0.3, x0), rtol=0, atol=1e-14)
    # The energy is quadratic: differences have no error but rounding.
    slope = [system.energy(x0 + d, 0.3) - system.energy(x0 - d, 0.3) for d in np.eye(6) / 2]
    np.testing.assert_allclose(system.hamiltonian.gradient(x0, 0.3), slope, rtol=0, atol=1e-13)
    exact = solve_ivp(rates, (0, 2), x0, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    found = co.integrate(system, x0, (0, 2), 0.05, co.Splitting(order=6)).x[-1]
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-6)
    assert system.parameters is None


@pytest.mark.parametrize("lattice", PLACES)
def test_edges_that_go_around(lattice):
    """Along each axis by itself: the nearest neighbours among the images of the sites along the periodic axes."""
    axes, _ = PLACES[lattice]
    shape = (4, 3, 3)[: len(axes)]
    places = positions_of(lattice, shape)
    for around in itertools.product((False, True), repeat=len(axes)):
        near = set()
        for turns in itertools.product(*((-1, 0, 1) if flag else (0,) for flag in around)):
            apart = np.linalg.norm(places[:, None] - places + (np.array(turns) * shape) @ axes, axis=2)
            near |= {(i, j) for i, j in np.argwhere(np.abs(apart - 1) < 1e-9).tolist() if i < j}
        assert {tuple(sorted(edge)) for edge in bonds(lattice, shape, around).tolist()} == near, around


def test_equal_anisotropies_in_fields_of_each_site():
    """Spins of which all have the same squares have offsets of their own; by a scheme that completes none."""
    K = np.array([[0.3, 0.2, 0.1], [0.2, -0.4, 0.15], [0.1, 0.15, 0.25]])
    fields = np.array([[0.3, 0.1, -0.2], [-0.4, 0.2, 0.6], [0.0, 0.5, 0.1]])
    x0 = spins_of(5, 3)
    lattice = spin_lattice("chain", 3, exchange=0.0, on_site=K, field=fields)
    found = co.integrate(lattice, x0, (0, 2), 0.05, co.Splitting(order=4)).x.reshape(-1, 3, 3)
    for site, field in enumerate(fields):
        alone = spin_lattice("chain", 1, on_site=K, field=field)
        wanted = co.integrate(alone, x0[3 * site : 3 * site + 3], (0, 2), 0.05, co.GaussLegendre(4)).x
        # The error of the splitting is 7e-8.
        np.testing.assert_allclose(found[:, site], wanted, rtol=0, atol=1e-6)


def test_layouts_and_graphs_of_one_site():
    assert spin_lattice("square", (3, 2)).layout == {"lattice": "square", "shape": (3, 2)}
    assert spin_lattice([(0, 1)], 2).layout == {"lattice": "graph"}
    for lattice in ("complete", np.zeros((0, 2), dtype=int)):
        single = spin_lattice(lattice, 1, field=(0.0, 0.0, 2.0))
        np.testing.assert_array_equal(single.vector_field([1.0, 0.5, 0.25]), [1.0, -2.0, 0.0])


def test_bonds_of_rings_and_complete_graphs():
    pairs = [(i, j) for i in range(5) for j in range(i + 1, 5)]
    around = [(i, j) for i, j in pairs if j - i in (1, 4)]
    for lattice, wanted in (("ring", around), ("complete", pairs)):
        assert sorted(tuple(sorted(bond)) for bond in bonds(lattice, 5).tolist()) == wanted


def test_parameters_count_together():
    """2^16 numbers are kept, and no more."""
    for sites, kept in ((15000, True), (30000, False)):
        ring = spin_lattice("ring", sites, exchange=np.ones(sites), field=np.ones((sites, 3)))
        S = spins_of(8, sites)
        assert (ring.parameters is not None) == kept
        assert ring.casimirs["sum of |x|^2"](S) == pytest.approx(S @ S, rel=1e-12)


LATTICES = {
    "chain": ("chain", 4, False),
    "ring": ("ring", 5, False),
    "triangular": ("triangular", (3, 3), True),
    "honeycomb": ("honeycomb", (3, 3), True),
    "complete": ("complete", 4, False),
}

bonds_of = functools.cache(bonds)

PATTERNS = {
    "none": np.zeros((3, 3)),
    "isotropic": np.eye(3),
    "axis": np.diag([0.0, 0.0, 1.0]),
    "plane": np.diag([1.0, 1.0, 0.0]),
    "exchange of two axes": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
    "one component": np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
}
SYMMETRIC = [name for name, pattern in PATTERNS.items() if np.array_equal(pattern, pattern.T)]


def drawn(rng, count, patterns, first):
    """Matrices of the given patterns in a random order, the first of which is given, times numbers from 1/2 to 2."""
    names = [first, *rng.choice(patterns, count - 1)]
    return np.array([PATTERNS[name] * rng.uniform(0.5, 2.0) for name in names])


def couplings(seed, lattice):
    """Couplings of which the first bond, or the first site, has only some entries, and others have others."""
    rng = np.random.default_rng(seed)
    edges = bonds_of(*lattice)
    count, sites = len(edges), edges.max() + 1
    J = rng.integers(-2, 3, count) * 0.5
    T = drawn(rng, count, list(PATTERNS), rng.choice(list(PATTERNS)))
    D = rng.standard_normal((count, 3)) * rng.integers(0, 2, (count, 3))
    K = drawn(rng, sites, SYMMETRIC, rng.choice(SYMMETRIC))
    B = rng.standard_normal((sites, 3)) * rng.integers(0, 2, (sites, 3))
    for values in (J, D, B):
        values[0] *= rng.integers(0, 2)
    return edges, J, T, D, K, B


def system_of(lattice, J, T, D, K, B):
    return spin_lattice(*lattice, exchange=J, tensor=T, dm=D, on_site=K, field=B)


def assert_by_hand(system, seed, edges, J, T, D, K, B):
    x = np.random.default_rng(seed).standard_normal(system.dim)
    largest = np.abs(x).max()
    # A sum of at most 6 neighbours, 4 products each, and of the site itself: 64 roundings of all that is summed.
    seen = np.abs(B).max() + 6 * largest * (np.abs(J).max() * np.abs(T).max() + np.abs(D).max() + np.abs(K).max())
    tolerance = 64 * UNIT_ROUNDOFF * 2 * largest * seen
    np.testing.assert_allclose(system.vector_field(x), by_hand(x, edges, J, T, D, K, B), rtol=0, atol=tolerance)
    energy = energy_by_hand(x, edges, J, T, D, K, B)
    assert abs(system.energy(x) - energy) <= system.dim * tolerance


@pytest.mark.thinned(3)
@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("seed", range(4))
def test_entries_that_the_first_bond_lacks(lattice, seed):
    """Also if couplings of one kind alone differ from bond to bond, or from site to site."""
    edges, *values = couplings(seed, LATTICES[lattice])
    assert_by_hand(system_of(LATTICES[lattice], *values), seed, edges, *values)
    nothing = [np.ones_like(values[0]), *(np.zeros_like(each) for each in values[1:])]
    for kind in range(1, len(values)):
        alone = [*nothing[:kind], values[kind], *nothing[kind + 1 :]]
        assert_by_hand(system_of(LATTICES[lattice], *alone), seed, edges, *alone)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("kind", ["none", "J", "T", "D", "K", "B"])
@pytest.mark.parametrize("place", ["first", "last"])
def test_integrals_and_closed_forms_take_every_bond_and_site_into_account(lattice, kind, place):
    """Exchange is isotropic but for one bond or one site: constant components are the kernel of the total torque.

    Only spins that are all coupled equally have a closed form; its slope is the motion by hand.
    """
    chosen = 0 if place == "first" else -1
    edges = bonds_of(*LATTICES[lattice])
    sites = edges.max() + 1
    J, T = np.ones(len(edges)), np.tile(np.eye(3), (len(edges), 1, 1))
    D, K, B = np.zeros((len(edges), 3)), np.zeros((sites, 3, 3)), np.zeros((sites, 3))
    values = {"J": J, "T": T, "D": D, "K": K, "B": B}
    axis = np.array([0.5, 0.0, 1.0])
    if kind != "none":
        values[kind][chosen] += 0.5 if kind == "J" else axis if kind in "DB" else np.outer(axis, axis)
    system = system_of(LATTICES[lattice], *values.values())
    assert has_closed_form(system) == (kind == "none" and lattice == "complete")
    states = np.random.default_rng(3).standard_normal((6, system.dim))
    rates = np.array([by_hand(x, edges, *values.values()) for x in states])
    torques = rates.reshape(6, sites, 3).sum(axis=1)
    # Torques are of size one, or round-off.
    assert len(system.integrals) == 3 - np.linalg.matrix_rank(torques, tol=1e-10)
    for x, rate in zip(states, rates, strict=True):
        for F in system.integrals.values():
            assert abs(F.gradient(x) @ rate) < 1e-12
        if has_closed_form(system):
            h = 2.0**-12
            slope = (system.exact(x, h) - system.exact(x, -h)) / (2 * h)
            # Rotations at a rate below 10 about fixed axes: the third derivative of a spin is below 10^3 |S|.
            np.testing.assert_allclose(slope, rate, rtol=0, atol=h * h / 6 * 1e3 * np.abs(x).max())
