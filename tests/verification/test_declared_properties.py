"""Declared invariants are preserved to round-off over a thousand steps; others are lost on a named system."""

import numpy as np
import pytest

import coadjoint as co

from .measures import drift_bounds, group_bound
from .schemes_under_test import large_step, pairs, schemes, serves, witnesses
from .systems_under_test import all_cases, cases, three_spins, with_cubic_casimir

pytestmark = pytest.mark.thinned(6)

STEP, COUNT = 0.1, 1000


def is_quadratic(casimir):
    return isinstance(casimir, co.Polynomial) and casimir.degree <= 2


def witness_of(method):
    return witnesses(method, "so(4), diagonal")[0]


# The stage of implicit Euler does not converge at larger steps; on sl(2) the energy of the other grows too fast.
SHORTER = {"RadauEnergy 1": 0.02, "CommutatorFree(order=2)": 0.02}


def declared_names(method, system):
    """Return the names of the invariants that a scheme declares to preserve on a system."""
    declared = method.properties(system)
    names = ["energy"] if declared.energy else []
    if declared.casimirs == "all":
        names += list(system.casimirs)
    elif declared.casimirs == "polynomial":
        names += [name for name, casimir in system.casimirs.items() if isinstance(casimir, co.Polynomial)]
    elif declared.casimirs == "quadratic":
        names += [name for name, casimir in system.casimirs.items() if is_quadratic(casimir)]
    return names


KEEPING = [p for p in pairs(all_cases()) if declared_names(schemes()[p[0]], all_cases()[p[1]].system)]


@pytest.mark.thinned(18)
@pytest.mark.parametrize(("scheme", "case"), KEEPING)
def test_declared_invariants_are_preserved(scheme, case):
    method, (system, x0, _) = schemes()[scheme], all_cases()[case]
    step = SHORTER.get(scheme, STEP)
    run = co.integrate(system, x0, (0.0, COUNT * step), step, method, save_every=50)
    bounds, drift = drift_bounds(run), run.drift()
    for name in declared_names(method, system):
        assert drift[name] <= bounds[name], (name, float(drift[name]), bounds[name])


# For each kind of invariant, a system on which every scheme loses it that does not declare it.
LOST = {
    "energy": (cases()["so(4), diagonal"], "energy", lambda p: not p.energy),
    "quadratic Casimir": (cases()["so(4), diagonal"], "Pfaffian", lambda p: p.casimirs == "none"),
    "Casimir that is not quadratic": (
        with_cubic_casimir(),
        "Pfaffian",
        lambda p: p.casimirs not in ("all", "polynomial"),
    ),
    "energy that is not quadratic": (cases()["e(3), polynomial potential"], "energy", lambda p: not p.energy),
}


def losing_energy(method):
    found = witness_of(method)
    return three_spins() if method.properties(found.system).energy and serves(method, three_spins().system) else found


def losing():
    for what, (case, _, loses) in LOST.items():
        for scheme, method in schemes().items():
            # For the energy, every scheme has such a system.
            there = losing_energy(method) if what == "energy" else case
            if serves(method, there.system) and loses(method.properties(there.system)):
                yield what, scheme


@pytest.mark.parametrize(("what", "scheme"), list(losing()))
def test_undeclared_invariants_are_lost(what, scheme):
    case, name, _ = LOST[what]
    system, x0, _ = losing_energy(schemes()[scheme]) if what == "energy" else case
    step = large_step(schemes()[scheme])
    run = co.integrate(system, x0, (0.0, 40 * step), step, schemes()[scheme])
    bound = drift_bounds(run)[name]
    assert run.drift()[name] > 1000 * bound, (float(run.drift()[name]), bound)


CARRYING = [
    p
    for p in pairs(cases())
    if schemes()[p[0]].properties(cases()[p[1]].system).attitude in ("every representation", "coadjoint")
]


@pytest.mark.parametrize(("scheme", "case"), CARRYING)
def test_coadjoint_matrix_maps_back_to_the_start(scheme, case):
    system, x0, _ = cases()[case]
    run = co.integrate(
        system, x0, (0.0, COUNT * STEP / 5), STEP, schemes()[scheme], attitude="coadjoint", save_every=20
    )
    back = np.einsum("tij,tj->ti", run.attitude, run.x)
    size = max(np.linalg.norm(K) * np.linalg.norm(x) for K, x in zip(run.attitude, run.x, strict=True))
    assert np.max(np.abs(back - x0)) <= group_bound(run, size)


@pytest.mark.parametrize(
    "scheme",
    [s for s, m in schemes().items() if m.properties(witness_of(m).system).attitude == "integrated"],
)
def test_integrated_attitude_leaves_the_group(scheme):
    system, x0, _ = cases()["so(4), diagonal"]
    run = co.integrate(system, x0, (0.0, 20.0), 0.1, schemes()[scheme], attitude=True)
    g = run.attitude[-1]
    assert np.max(np.abs(g @ g.T - np.eye(4))) > 1000 * group_bound(run, 1.0)


@pytest.mark.parametrize(
    "scheme", [s for s, m in schemes().items() if m.properties(witness_of(m).system).attitude == "none"]
)
def test_undeclared_attitude_is_refused(scheme):
    system, x0, _ = witness_of(schemes()[scheme])
    with pytest.raises(ValueError, match="no group element"):
        co.integrate(system, x0, (0.0, 1.0), 0.1, schemes()[scheme], attitude="coadjoint")
