"""Averages in thermal equilibrium against closed forms, and error bars that are neither too small nor too large."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused


def langevin(x):
    return 1 / np.tanh(x) - 1 / x


def z_scores(found, exact):
    value, error = found
    return (value - exact) / error


CASES = {
    "free spins in a field": (
        co.systems.spin_lattice([], 6, field=(0, 0, 1.3)),
        0.5,
        {"sweeps": 200, "start": 5, "every": 2},
        lambda T: {"energy": -1.3 * langevin(1.3 / T), "heat_capacity": 1 - (1.3 / T / np.sinh(1.3 / T)) ** 2},
    ),
    "an open chain": (
        co.systems.spin_lattice("chain", 6),
        0.4,
        {"sweeps": 400, "start": 100, "every": 4},
        lambda T: {
            "energy": -5 / 6 * langevin(1 / T),
            "heat_capacity": 5 / 6 * (1 - (1 / T / np.sinh(1 / T)) ** 2),
            # Correlations fall by u for each bond.
            "susceptibility": sum(langevin(1 / T) ** abs(i - j) for i in range(6) for j in range(6)) / (18 * T),
        },
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_error_bars_hold_the_truth(case):
    """In 80 simulations of each: 95 per cent within two errors, and errors of the size of the scatter."""
    system, T, how, exact = CASES[case]
    found = co.spins.thermal_averages(system, np.full(80, T), members=3, seed=11, **how)
    for name, value in exact(T).items():
        z = z_scores(getattr(found, name), value)
        inside = (np.abs(z) < 2).mean()
        # 0.95 +- 0.025; heat capacities are skewed.
        assert 0.87 < inside <= 1.0, name
        assert abs(z.mean()) < 0.35, name
        scatter = np.std(getattr(found, name).value)
        assert 0.7 < scatter / np.median(getattr(found, name).error) < 1.3, name
    for name in ("magnetization", "binder"):
        estimate = getattr(found, name)
        assert 0.7 < np.std(estimate.value) / np.median(estimate.error) < 1.3, name


def test_units_of_a_model_and_of_its_order():
    """Free ions: Curie's law in mu_B per tesla, 5.6 per cent saturated; and opposite weights."""
    cube = co.spins.crystal(lattice=(3, 3, 3, 90, 90, 90), sites={"Mn": (0, 0, 0)}, space_group="P 1")
    for g in (2.0, -2.0):
        free = co.systems.spins(cube, (3, 3, 2), spin=2.5, g=g, units="meV")
        found = co.spins.thermal_averages(free, [5.0, 50.0], seed=2, sweeps=400, start=4)
        curie = 25 * 0.057883817982 / (3 * 0.08617333262145179 * np.array([5.0, 50.0]))
        assert np.all(np.abs(z_scores(found.susceptibility, curie)) < 4)
        assert np.all(found.susceptibility.error < 0.1 * curie)
        assert np.all(found.energy.value == 0.0) and np.all(found.energy.error == 0.0)
        assert np.all(np.abs(z_scores(found.binder, 4 / 9)) < 4) or np.all(np.abs(found.binder.value - 4 / 9) < 0.02)
    pair = co.systems.spin_lattice([(0, 1)], 2, exchange=-1.0)
    aligned, opposite = (co.spins.thermal_averages(pair, 0.2, seed=3, sweeps=400, weights=w) for w in ((1, 1), (1, -1)))
    assert aligned.magnetization.value < 0.35 and opposite.magnetization.value > 0.9
    assert abs(aligned.energy.value - opposite.energy.value) == 0.0
    # <|S1 - S2|^2> = 2 + 2 u, and the susceptibility of either is a third of it over kT and two spins.
    u = langevin(1 / 0.2)
    for one, sign in ((aligned, -1), (opposite, 1)):
        assert abs(z_scores(one.susceptibility, (2 + sign * 2 * u) / (6 * 0.2))) < 4


@pytest.mark.parametrize("length", [1.0, 2.0])
def test_the_magnetization_is_relative_to_parallel_spins(length):
    """Of one free ion, <|S|> is its length at every temperature, whatever its moment and the length of its state."""
    cell = co.spins.crystal(lattice=(3, 3, 3, 90, 90, 90), sites={"Mn": (0, 0, 0)}, space_group="P 1")
    ion = co.systems.spins(cell, (1, 1, 1), spin=2.5, g=-2.0, units="meV").field((0, 0, 3.0))
    for system, weights in ((ion, None), (ion, (-7.0,)), (co.systems.spin_lattice([], 1, field=(0, 0, 1.0)), None)):
        x0 = (0.0, 0.0, length)
        found = co.spins.thermal_averages(system, 2.0, seed=4, sweeps=80, start=2, members=2, weights=weights, x0=x0)
        assert abs(found.magnetization.value - 1.0) < 1e-14
    # Of two in a strong field, whose spins are nearly parallel.
    pair = co.systems.spin_lattice([], 2, field=(0, 0, 100.0))
    x0 = (0, 0, length, 0, 0, 0.5)
    found = co.spins.thermal_averages(pair, 0.1, seed=4, sweeps=80, start=5, x0=x0)
    assert 0.995 < found.magnetization.value < 1.0


def test_same_seed_same_numbers_and_chains_at_all_temperatures():
    ring = co.systems.spin_lattice("ring", 8)
    one, two = (co.spins.thermal_averages(ring, [0.3, 1.0], seed=5, sweeps=80, members=2) for _ in range(2))
    other = co.spins.thermal_averages(ring, [0.3, 1.0], seed=6, sweeps=80, members=2)
    assert np.array_equal(one.energy.value, two.energy.value) and one.energy.value[0] < one.energy.value[1] - 0.3
    assert not np.array_equal(one.energy.value, other.energy.value)
    single = co.spins.thermal_averages(ring, 0.3, seed=5, sweeps=80, members=2)
    assert isinstance(single.energy.value, float) and single.energy.value == one.energy.value[0]


@pytest.mark.long
def test_the_curie_temperature_of_the_cubic_lattice():
    """Binder's crossing of 4^3 and 8^3 spins is within two per cent of 1.443 J/k_B (Chen, Ferrenberg, Landau 1993)."""
    T = np.array([1.36, 1.44, 1.52])
    curves = []
    for n in (4, 8):
        lattice = co.systems.spin_lattice("cubic", (n, n, n), periodic=True)
        found = co.spins.thermal_averages(lattice, T, members=8, sweeps=3000, over_relaxation=1, every=10, seed=n)
        curves.append(np.polynomial.Polynomial.fit(T, found.binder.value, 2, w=1 / found.binder.error))
    roots = (curves[1] - curves[0].convert(domain=curves[1].domain)).roots()
    crossing = min(roots.real, key=lambda root: abs(root - 1.443))
    assert abs(crossing - 1.443) < 0.03


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"sweeps": 60}, "16"),
        ({"weights": (1.0,)}, "2 numbers"),
        ({"weights": (0.0, 0.0)}, "zeros"),
        ({"temperature": [[1.0]]}, "(1, 1)"),
        ({"temperature": -1.0}, "positive"),
        ({"system": co.systems.rigid_body((1, 2, 3)), "members": 0}, "members"),
        ({"system": co.systems.heavy_top()}, "not made of spins"),
        ({"x0": np.ones(5)}, "x0"),
        ({"system": co.systems.spin_lattice([], 2), "weights": (1, 0), "x0": (0, 0, 0, 0, 0, 1)}, "length zero"),
    ],
)
def test_averages_that_are_refused(given, words):
    good = {"system": co.systems.spin_lattice(), "temperature": 1.0, "seed": 1}
    with refused((TypeError, ValueError), words):
        co.spins.thermal_averages(**good | given)


def test_states_of_levels_are_starts():
    Sz = co.spins.operators(1)[2]
    ions = co.spins.crystal(lattice=(3, 3, 4, 90, 90, 90), sites={"Ni": (0, 0, 0)})
    model = co.systems.spins(ions, (2, 1, 1), spin=1, mode="SU(N)").single_ion("Ni", 0.5 * Sz @ Sz)
    found = co.spins.thermal_averages(model, 0.4, seed=2, sweeps=400, start=20, x0=model.coherent((0, 0, 1)))
    alone = co.spins.thermal_averages(model, 0.4, seed=5, sweeps=400, start=20)
    for one, other in ((found.energy, alone.energy), (found.magnetization, alone.magnetization)):
        assert abs(one.value - other.value) < 4 * np.hypot(one.error, other.error) < 0.1
