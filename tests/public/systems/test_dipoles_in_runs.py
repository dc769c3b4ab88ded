"""Dipoles by FFT in the loops: transforms of every length, fewer evaluations in many iterations, and the same bits."""

import importlib.util

import numpy as np
import pytest

import coadjoint as co
from matrix.forces import force_on
from same_runs import check_same

pytestmark = pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")  # single steps, as long as they may be

CRYSTALS = importlib.util.find_spec("gemmi") is not None
FILM, MIXED = (True, True, False), (False, True, True)
SITES = {"A": (0, 0, 0), "B": (0.3, 0.2, 0.4)}
ROUNDING = 2.0**-53


def on_cells(size, periodic, sites=1):
    cell = co.spins.crystal(lattice=(1, 1.1, 1.2, 90, 80, 85), sites=dict([*SITES.items()][:sites]), space_group="P 1")
    return co.systems.spins(cell, size, g=1, periodic=periodic).dipolar()


def chain(sites, **options):
    return co.systems.spin_lattice("chain", sites, **{"exchange": 0.0, "dipolar": 0.7, **options})


def start(system, seed=1):
    x = np.random.default_rng(seed).standard_normal((system.dim // 3, 3))
    return (x / np.linalg.norm(x, axis=1, keepdims=True)).ravel()


def check_against_sums(system):
    """Compare a step of Runge's method, and the energy, with those by the matrix of the second derivatives."""
    x, matrix, h = start(system), system.hamiltonian.hessian(np.zeros(system.dim)), 0.25

    def slope(y):
        return np.cross((matrix @ y).reshape(-1, 3), y.reshape(-1, 3)).ravel()

    run = co.integrate(system, x, (0, h), h, co.ExplicitRungeKutta("runge2"))
    expected = x + h * slope(x + h / 2 * slope(x))
    size = np.abs(matrix).sum(axis=1).max()
    assert np.abs(run.x[-1] - expected).max() < 1e-14 * (1.0 + h * size)
    for state, energy in zip(run.x, run.energy, strict=True):
        assert abs(energy - 0.5 * state @ matrix @ state) < 1e-14 * size * system.dim / 3


@pytest.mark.parametrize("lengths", [range(2, 17), range(17, 33), range(33, 49), range(49, 65), (97, 101, 127, 211)])
def test_open_chains_of_every_length(lengths):
    for length in lengths:
        check_against_sums(chain(length))


@pytest.mark.skipif(not CRYSTALS, reason="gemmi is not installed")
@pytest.mark.parametrize("lengths", [range(1, 17), range(17, 33), range(33, 49), range(49, 65), (97, 101, 127, 211)])
def test_periodic_cells_of_every_length(lengths):
    """Factors of every kind, and large primes, along each axis: all periods are transformed as they are."""
    for length in lengths:
        check_against_sums(on_cells(np.roll((length, 1, 1), length % 3).tolist(), True))


@pytest.mark.skipif(not CRYSTALS, reason="gemmi is not installed")
@pytest.mark.parametrize("periodic", [True, False, FILM, MIXED])
@pytest.mark.parametrize(
    ("size", "sites"),
    [((3, 4, 5), 1), ((7, 1, 11), 1), ((1, 2, 31), 1), ((6, 9, 6), 1), ((3, 4, 5), 2), ((5, 1, 9), 2)],
)
def test_cells_in_space(periodic, size, sites):
    check_against_sums(on_cells(size, periodic, sites))


@pytest.mark.skipif(not CRYSTALS, reason="gemmi is not installed")
@pytest.mark.parametrize("periodic", [True, False])
@pytest.mark.parametrize(("size", "sites"), [((1, 1, 64), 1), ((72, 1, 1), 2), ((3, 1, 80), 1), ((1, 104, 1), 1)])
def test_few_long_rows(periodic, size, sites):
    """Lengths that are multiples of eight, whose transforms have eight parts."""
    model = on_cells(size, periodic, sites)
    check_against_sums(model)
    check_against_sums(model.vacancies(0.3, seed=2))


@pytest.mark.skipif(not CRYSTALS, reason="gemmi is not installed")
@pytest.mark.parametrize("periodic", [True, FILM, False])
def test_vacancies_and_substituted_ions(periodic):
    model = on_cells((4, 3, 5), periodic, 2)
    check_against_sums(model.vacancies(0.3, seed=2))
    alloy = model.substitute("A", 0.5, seed=3, spin=1.5)
    for changed in (alloy, alloy.vacancies(0.2, seed=4)):
        matrix = changed.hamiltonian.hessian(np.zeros(changed.dim))
        x = start(changed)
        run = co.integrate(changed, x, (0, 0.05), 0.05, co.GaussLegendre(1))
        middle = (run.x[0] + run.x[-1]) / 2
        slope = np.cross((matrix @ middle).reshape(-1, 3), middle.reshape(-1, 3)) / changed.spin[:, None]
        assert np.abs(run.x[-1] - x - 0.05 * slope.ravel()).max() < 1e-14
        assert abs(run.energy[0] - 0.5 * x @ matrix @ x) < 1e-12


MIDPOINTS = (co.GaussLegendre(1), co.SphericalMidpoint())


def check_midpoints(system, t0, h, method):
    run = co.integrate(system, start(system), (t0, t0 + 4 * h), abs(h), method)
    for before, after in zip(run.x[:-1], run.x[1:], strict=True):
        middle = ((before + after) / 2).reshape(-1, 3)
        if method != co.GaussLegendre(1):  # on the spheres
            middle = middle / np.linalg.norm(middle, axis=1, keepdims=True)
        slope = system.vector_field(middle.ravel())
        scale = 1.0 + abs(h) * np.abs(slope).max()
        # The sum of a step, the mean of its ends, and the transforms, of some ten levels.
        assert np.abs(after - before - h * slope).max() < 16 * ROUNDING * scale


@pytest.mark.parametrize("sites", [340, 343])
@pytest.mark.parametrize(("exchange", "dipolar"), [(0.0, 0.7), (1.0, 1e-9), (1.0, 0.01), (1.0, 0.3), (0.1, 4.0)])
@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("method", MIDPOINTS, ids=str)
def test_the_midpoint_is_solved_to_round_off(sites, exchange, dipolar, sense, method):
    """Weak and strong dipoles; more than 341 spins reuse their field in the iteration while nothing is seen of it."""
    lattice = chain(sites, exchange=exchange, dipolar=dipolar, field=(0.0, 0.2, 0.1))
    h = 0.05 * sense
    check_midpoints(lattice, 3.0, h, method)


@pytest.mark.skipif(not CRYSTALS, reason="gemmi is not installed")
@pytest.mark.parametrize("h", [1e-4, 1e-5])
@pytest.mark.parametrize("method", MIDPOINTS, ids=str)
def test_the_midpoint_of_very_different_moments_is_solved_to_round_off(h, method):
    """Half of them are a thousand times the others: their fields change by more than the norm of the lattice."""
    check_midpoints(on_cells((1, 1, 343), periodic=False).substitute("A", 0.5, seed=3, spin=1000.0), 0.0, h, method)


def test_stages_of_many_dipoles():
    """Other Gauss methods return to where they began, and agree with small steps."""
    lattice = chain(400, exchange=1.0, dipolar=0.2)
    x0, method = start(lattice), co.GaussLegendre(3)
    run = co.integrate(lattice, x0, (0, 0.5), 0.05, method)
    back = co.integrate(lattice, run.x[-1], (0.5, 0), 0.05, method)
    assert np.abs(back.x[-1] - x0).max() < 1e-13
    fine = co.integrate(lattice, x0, (0, 0.5), 0.025, co.GaussLegendre(4))
    assert np.abs(run.x[-1] - fine.x[-1]).max() < 1e-9


def test_energies_with_reused_fields_do_not_drift():
    """Steps round energies of spins, about five times the rounding, independently; that of fields has a sign."""
    steps, lattice = 1000, co.systems.spin_lattice("cubic", (10, 9, 8), exchange=-1.0, dipolar=1.0)
    x0 = [start(lattice, seed) for seed in range(3)]
    run = co.integrate(lattice, x0, (0, 0.01 * steps), 0.01, co.GaussLegendre(1), save_every=steps)
    assert abs(np.mean(run.energy[-1] - run.energy[0])) / 720 < 5.0 * ROUNDING * np.sqrt(steps / 720 / 3)


@pytest.mark.parametrize("method", [co.GaussLegendre(1), co.GaussLegendre(2), co.SphericalMidpoint()], ids=str)
@pytest.mark.parametrize("sites", [12, 400])
def test_the_same_bits(sites, method, tmp_path):
    """On one and two threads, alone and beside members of the same and of other systems, and resumed."""
    one, other = (chain(sites, exchange=1.0, dipolar=strength) for strength in (0.2, 0.4))
    states = np.array([start(one, seed) for seed in range(3)])
    given = {"t_span": (1.0, 1.4), "step": 0.05, "method": method}
    alone = co.integrate(one, states[0], **given)
    check_same(co.integrate(one, states[0], **given, threads=2), alone)
    together = co.integrate(one, states, **given, threads=2)
    systems = co.integrate(co.batch([other, one]), states[:2], **given)
    assert together.x[:, 0].tobytes() == alone.x.tobytes()
    assert systems.x[:, 1].tobytes() == together.x[:, 1].tobytes()
    assert systems.x[:, 0].tobytes() == co.integrate(other, states[0], **given).x.tobytes()
    assert together.energy[:, 1].tobytes() == systems.energy[:, 1].tobytes()
    co.integrate(one, states[0], **{**given, "t_span": (1.0, 1.2)}, archive=tmp_path / "run.zarr")
    resumed = co.resume(tmp_path / "run.zarr", 1.4)
    assert resumed.x.tobytes() == alone.x.tobytes()


@pytest.mark.parametrize("name", co.forces.names())
def test_forces_beside_dipoles(name):
    """Every force, before and behind a damping, acts as beside the same energy by its matrix."""
    lattice = chain(5, exchange=0.5)
    by_matrix = co.LiePoissonSystem(
        lattice.algebra, co.Quadratic(lattice.hamiltonian.hessian(np.zeros(15))), sign=lattice.sign
    )
    x0, damping, ends = start(lattice), co.forces.LinearDamping(0.1), []
    for system in (lattice, by_matrix):
        try:
            force = force_on(name, system)
            both = [system.with_forces(force, damping), system.with_forces(damping, force)]
        except (TypeError, ValueError) as refusal:
            ends.append(str(refusal))
            continue
        ends.append(np.array([co.integrate(one, x0, (1, 1.5), 0.05, co.GaussLegendre(1)).x for one in both]))
    refused = [isinstance(end, str) for end in ends]
    assert all(refused) or (not any(refused) and np.abs(ends[0] - ends[1]).max() < 1e-12)
