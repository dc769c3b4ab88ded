"""Lemma 4.2: the splitting preserves every Casimir, for any sequence of steps."""

import math

import numpy as np
import pytest

import coadjoint as co

from .measures import U, drift_bounds
from .schemes_under_test import schemes
from .systems_under_test import cases, with_cubic_casimir

pytestmark = pytest.mark.thinned(3)

SPLITTINGS = [name for name in schemes() if name.startswith("Splitting") and "free body" not in name]


@pytest.mark.thinned(8)
@pytest.mark.parametrize("scheme", SPLITTINGS)
@pytest.mark.parametrize("case", list(cases()))
def test_every_casimir_is_preserved(case, scheme):
    system, x0, _ = cases()[case]
    # Orbits of A3,7 fall to the axis, where log C has no value, and the driven one on sl(2) goes to infinity.
    step = {"A3,7, diagonal": 0.004, "A3,7, full": 0.004, "sl(2), driven": 0.004}.get(case, 0.1)
    run = co.integrate(system, x0, (0.0, 10_000 * step), step, schemes()[scheme], save_every=500)
    bounds = drift_bounds(run)
    assert system.casimirs
    for name in system.casimirs:
        assert run.drift()[name] <= bounds[name], name


def test_cubic_casimir_in_dimension_fifteen():
    system, x0, _ = with_cubic_casimir()
    run = co.integrate(system, x0, (0.0, 200.0), 0.1, co.Splitting(order=4), save_every=100)
    bounds = drift_bounds(run)
    assert all(run.drift()[name] <= bounds[name] for name in system.casimirs)
    # Gauss methods preserve the quadratic one only.
    run = co.integrate(system, x0, (0.0, 200.0), 0.5, co.GaussLegendre(2), save_every=100)
    bounds = drift_bounds(run)
    assert run.drift()["|x|^2"] <= bounds["|x|^2"]
    assert run.drift()["Pfaffian"] > 1000 * bounds["Pfaffian"]


def test_casimirs_with_state_dependent_steps():
    for case in ("so(4), full, another basis", "e(3), split", "A3,7, full"):
        system, x, _ = cases()[case]
        start = {name: casimir(x) for name, casimir in system.casimirs.items()}
        size = {name: np.linalg.norm(c.gradient(x)) * np.linalg.norm(x) for name, c in system.casimirs.items()}
        count = 60
        for _ in range(count):
            h = 0.02 + 0.05 / (1.0 + float(x @ x))
            x = co.stepper(system, co.Splitting(order=2), h)(x)
        for name, casimir in system.casimirs.items():
            period = getattr(casimir, "period", 0.0)
            change = casimir(x) - start[name]
            change -= period * round(change / period) if period else 0.0
            # At most 2 n^2 flows a step, each of n roundings; sizes change by less than 8 in this time.
            assert abs(change) <= 8 * 4 * U * count * 2 * len(x) ** 3 * size[name], (case, name)


def test_multivalued_casimir_over_whole_turns():
    """theta turns several times; the principal branch of log C jumps by 4 pi a."""
    a = 0.05
    algebra = co.algebras.A3_7(a)
    system = co.LiePoissonSystem(algebra, co.Quadratic([1.0, 2.0, 1.0]))
    run = co.integrate(system, (0.3, 0.2, 3.0), (0.0, 20.0), 0.01, co.Splitting(order=2))
    principal = [algebra.casimirs_known["log C"](x) for x in run.x]
    assert max(abs(np.diff(principal))) > 4 * math.pi * a * 0.9
    assert run.drift()["log C"] <= drift_bounds(run)["log C"]
