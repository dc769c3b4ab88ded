"""Memory that the first gradient of a lattice takes, in proportion to its sites."""

import tracemalloc

import numpy as np
import pytest

import coadjoint as co
from coadjoint.runs.derivatives import differentiable_run

# Dense matrices of the smallest lattice here take 8 n = 9600 bytes for each number.
BYTES_PER_NUMBER = 4000


def peak_of_gradient(arguments, shape):
    """Return the peak memory of the first gradient for each coordinate."""
    system = co.systems.spin_lattice("square", shape, periodic=True, **arguments)
    x0 = np.random.default_rng(0).standard_normal(system.dim)
    ready = co.prepare(system, co.Splitting(order=2), 0.01, threads=1)
    ready.run(x0, (0.0, 0.02))
    tracemalloc.start()
    _, pullback = ready.vjp(x0, (0.0, 0.02))
    gradient = pullback(np.ones((3, system.dim)))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert np.all(gradient["exchange"] != 0.0)
    return peak / system.dim


@pytest.mark.parametrize(
    "arguments",
    [{}, {"dm": (0.0, 0.0, 0.3)}, {"exchange": None}],
    ids=["exchange", "Dzyaloshinskii-Moriya", "disorder"],
)
def test_the_memory_of_the_first_gradient_is_linear_in_the_sites(arguments):
    for side in (20, 30):
        bonds = np.random.default_rng(1).uniform(0.5, 1.5, 2 * side * side)
        given = {name: bonds if value is None else value for name, value in arguments.items()}
        assert peak_of_gradient(given, (side, side)) < BYTES_PER_NUMBER


def test_stretches_of_large_systems_have_several_steps(monkeypatch):
    system = co.systems.spin_lattice("chain", 100)
    ready, steps = co.prepare(system, co.Splitting(order=2), 0.01), 40
    x0, gradients = np.random.default_rng(0).standard_normal(system.dim), {}
    for numbers in (2**15, 1):
        monkeypatch.setattr(differentiable_run, "NUMBERS_OF_STRETCH", numbers)
        sol, pullback = ready.vjp(x0, (0.0, 0.01 * steps), save_every=steps)
        lengths = [one.k1 - one.k0 for one in pullback._trajectory.stretches]
        assert lengths == ([40] if numbers > 1 else [16, 16, 8])
        gradients[numbers] = pullback(np.ones(sol.x.shape))
    assert np.array_equal(gradients[1]["x0"], gradients[2**15]["x0"])
    # Five steps of states fit.
    monkeypatch.setattr(differentiable_run, "BYTES_OF_CHECKPOINTS", 5 * 8 * system.dim)
    _, pullback = ready.vjp(x0, (0.0, 0.01), save_every=1)
    assert pullback._trajectory._stretch_length() == 5
