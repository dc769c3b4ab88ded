"""Threads that share one large member: the same bits on any number of them."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.errors import IntegrationError

SPINS = 2500  # more angles of a part than one thread takes alone


def spins(seed, members=()):
    x = np.random.default_rng(seed).standard_normal((*members, SPINS, 3))
    return (x / np.linalg.norm(x, axis=-1, keepdims=True)).reshape(*members, 3 * SPINS)


def disordered():
    rng = np.random.default_rng(1)
    return co.systems.spin_lattice("chain", SPINS, exchange=rng.standard_normal(SPINS - 1), field=(0.1, 0.2, 0.3))


def coupled_copies():
    """Linear terms, whose rates are polynomials of other copies, on copies of sl(2), which shear and scale."""
    n = 3 * SPINS
    diagonal = np.tile([0.3, 0.0, 0.1], SPINS)
    return co.LiePoissonSystem(co.algebras.copies(co.algebras.sl(2), SPINS), co.Quadratic(diagonal), sign=-1), n


SYSTEMS = {
    "uniform chain": lambda: co.systems.spin_lattice("chain", SPINS, periodic=True),
    "square": lambda: co.systems.spin_lattice("square", (50, 50), periodic=True, field=(0, 0, 0.5)),
    "vectors between components": lambda: co.systems.spin_lattice("square", (50, 50), dm=(0.1, 0.2, 0.3)),
    "disorder": disordered,
    "sl(2)": lambda: coupled_copies()[0],
}
METHODS = {
    "plain": co.Splitting(order=2, compensated=False),
    "compensated": co.Splitting(order=4, compensated=True),
    "rational": co.Splitting(order=2, rotation="rational"),
}


def run(system, x0, threads, method=METHODS["plain"], **options):
    given = {"watch": False, "save_every": 3} | options
    return co.integrate(system, x0, (1.0, 0.5), 0.05, method, threads=threads, **given)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SYSTEMS)
def test_bits_do_not_depend_on_the_number_of_threads(name, method):
    system, x0 = SYSTEMS[name](), spins(2)
    try:
        alone = run(system, x0, 1, METHODS[method])
    except ValueError as reason:
        assert method == "rational" and "rational" in str(reason)
        return
    for threads in (2, 3, 7, 16):
        np.testing.assert_array_equal(run(system, x0, threads, METHODS[method]).x, alone.x)


def test_members_come_first_then_the_inside_of_each():
    system, x0 = SYSTEMS["square"](), spins(3, (2,))
    together = run(system, x0, 5)
    for m in range(2):
        np.testing.assert_array_equal(together.x[:, m], run(system, x0[m], 1).x)


def test_times_between_steps_and_events_have_the_same_bits():
    system, x0 = SYSTEMS["disorder"](), spins(4)
    options = {"t_eval": [1.0, 0.93, 0.61], "watch": True, "save_every": 1}
    alone, shared = (run(system, x0, threads, **options) for threads in (1, 4))
    np.testing.assert_array_equal(shared.x, alone.x)
    np.testing.assert_array_equal(shared.energy, alone.energy)
    event = co.Event(g=lambda x: x[0] - x0[0] - 1e-3, name="moved")
    options = {"events": event, "save_every": 1}
    alone, shared = (run(system, x0, threads, **options) for threads in (1, 4))
    np.testing.assert_array_equal(shared.events.t, alone.events.t)


def test_overflow_is_found_by_any_thread():
    system = SYSTEMS["sl(2)"]()
    for entry in (2, 3 * SPINS - 2):
        x0 = spins(5)
        x0[entry] = 1e300
        messages = set()
        for threads in (1, 2, 5):
            with pytest.raises(IntegrationError) as raised:
                run(system, x0, threads)
            messages.add(str(raised.value))
        assert len(messages) == 1


def test_progress_and_resumed_stretches_have_the_same_bits(capsys):
    system, x0 = SYSTEMS["uniform chain"](), spins(6)
    np.testing.assert_array_equal(run(system, x0, 3, progress=True).x, run(system, x0, 1).x)
    first = run(system, x0, 3, save_every=10**6).x[-1]
    np.testing.assert_array_equal(first, run(system, x0, 1, save_every=10**6).x[-1])
