"""Rows that repeat, as those of a lattice, are stored once: the same bits, few bytes a spin."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.program.parts.decompose import decompose
from coadjoint.systems.hamiltonians import repeated_rows as rows
from coadjoint.systems.hamiltonians.terms import RepeatedTerm
from coadjoint.systems.lattices import couplings

SIDE = 12  # of a cubic lattice, with more rows than MIN_ROWS
SITES = SIDE**3
RANDOM = np.random.default_rng(11)
BOTH_WAYS = np.stack([np.arange(1499), np.arange(1, 1500)], axis=1)  # bonds of a chain, every second one backward
BOTH_WAYS[::2] = BOTH_WAYS[::2, ::-1]
FULL = np.array([[1.0, 0.1, 0.0], [0.2, -1.0, 0.3], [0.0, 0.0, 0.5]])
LATTICES = {
    "periodic": ("cubic", (SIDE, SIDE, SIDE), {"periodic": True}),
    "open": ("cubic", (SIDE, SIDE, SIDE), {"tensor": (1.0, 0.5, 0.0), "exchange": -2.0}),
    "on site": ("square", (48, 50), {"periodic": (True, False), "on_site": (0.0, 0.0, 0.3), "field": (0.1, 0.0, 0.2)}),
    "kagome": ("kagome", (30, 31), {"periodic": True, "field": RANDOM.standard_normal((2790, 3))}),
    "directed": ("chain", 1500, {"tensor": FULL, "dm": (0.0, 0.4, 0.0)}),
    "both ways": (BOTH_WAYS, 1500, {"dm": (0.0, 0.0, 0.3)}),
    "one DM axis": ("square", (40, 41), {"periodic": True, "dm": (0.0, 0.0, 0.3)}),
    "DM by bond": ("chain", 1500, {"dm": np.tile([[0.0, 0.0, 0.2], [0.0, 0.0, -0.2]], (750, 1))[:1499]}),
    "disordered": ("cubic", (SIDE, SIDE, SIDE), {"exchange": RANDOM.standard_normal(3 * SIDE**2 * (SIDE - 1))}),
    "diluted": ("ring", 1500, {"exchange": np.where(np.arange(1500) % 5, 1.0, 0.0), "on_site": (0.0, 0.1, 0.0)}),
    "only on site": ("chain", 1500, {"exchange": 0.0, "on_site": FULL + FULL.T}),
}
EXPLICIT = ("disordered",)
# With shares of few angles, which the loops over flows read row by row, or of products of different components.
SHORT_SHARES = ("one DM axis", "both ways", "DM by bond", "diluted")


def lattice(name):
    kind, shape, options = LATTICES[name]
    return co.systems.spin_lattice(kind, shape, **options)


def explicit(name, monkeypatch):
    """Return the same lattice without shapes of rows."""
    with monkeypatch.context() as patched:
        patched.setattr(rows, "MIN_ROWS", 2**40)
        patched.setattr(couplings, "MIN_ROWS", 2**40)
        return lattice(name)


@pytest.mark.parametrize("name", [name for name in LATTICES if name not in (*EXPLICIT, "directed", "only on site")])
@pytest.mark.parametrize("options", [{}, {"compensated": True}], ids=["plain", "compensated"])
def test_runs_have_the_bits_of_explicit_rows(name, options, monkeypatch):
    systems = lattice(name), explicit(name, monkeypatch)
    x0 = np.random.default_rng(3).standard_normal(systems[0].dim)
    loops = [co.prepare(system, co.Splitting(order=2), 0.05).loops(0.05) for system in systems]
    assert [loop.compiled[0].tables.terms.repeated > 0 for loop in loops] == [name not in SHORT_SHARES, False]
    assert [loop.watches[0].tables.terms.repeated > 0 for loop in loops] == [True, False]
    for threads in (1, 2):
        runs = [
            co.integrate(system, x0, (0.0, 0.3), 0.05, co.Splitting(order=4, **options), threads=threads)
            for system in systems
        ]
        assert np.array_equal(runs[0].x, runs[1].x)
        assert np.array_equal(runs[0].energy, runs[1].energy)
        assert runs[0].step_error() == runs[1].step_error()


def arrays_in(item, found):
    """Collect the arrays in tables, by the memory that they occupy."""
    if isinstance(item, np.ndarray):
        owner = item
        while isinstance(owner.base, np.ndarray):
            owner = owner.base
        found[owner.__array_interface__["data"][0]] = owner.nbytes
    elif isinstance(item, tuple):
        for each in item:
            arrays_in(each, found)
    elif isinstance(item, rows.RepeatedRows):
        arrays_in(tuple(vars(item).values()), found)


@pytest.mark.parametrize(("name", "most"), [("periodic", 160), ("open", 160), ("disordered", 920)])
def test_bytes_of_the_tables_of_a_spin(name, most):
    """All arrays of the Hamiltonian, the invariants, the parts and the loops, each counted once."""
    system = lattice(name)
    loops = co.prepare(system, co.Splitting(order=2), 0.05, watch=False).loops(0.05)
    parts, found = decompose(system, "auto").parts, {}
    terms = [term for F in (system.hamiltonian, *system.casimirs.values()) for term in F.terms()]
    for term in terms:
        of_matrix = (term.matrix,) if isinstance(term, RepeatedTerm) else (term.indptr, term.indices, term.values)
        arrays_in((*of_matrix, term.linear), found)
    arrays_in((parts.forms, parts.offset, parts.weights, parts.row, parts.share), found)
    arrays_in((loops.compiled[0].tables, loops.watches[0].tables), found)
    assert sum(found.values()) <= most * SITES
