"""Steps of fluids are Poisson maps, by their exact tangents; those of a baseline are not."""

from __future__ import annotations

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.poisson_defect import poisson_defect

FLUIDS = {
    "sphere": co.systems.sphere_euler,
    "rotating sphere": lambda N: co.systems.sphere_euler(N, rotation=0.7),
    "torus": co.systems.torus_euler,
}
MAPS = [
    *((name, co.IsospectralGauss(stages)) for name in FLUIDS for stages in (1, 2, 3)),
    *(("torus", co.LineSplitting(order)) for order in (2, 4, 6)),
]


def defect(name: str, N: int, method: co.methods.Method) -> float:
    """Return the defect of a step in which the fastest mode of the stream turns by 0.4."""
    system = FLUIDS[name](N)
    W = system.random(seed=3, degrees=(1, N // 2))
    h = 0.4 / np.abs(system.spectrum(system.stream(W))).max()
    return poisson_defect(co.stepper(system, method, h), W).defect


@pytest.mark.thinned(10)
@pytest.mark.parametrize("N", [5, 7])
@pytest.mark.parametrize(("name", "method"), MAPS, ids=lambda value: str(value))
def test_a_step_is_a_poisson_map(name: str, N: int, method: co.methods.Method) -> None:
    # Products of the tangent, 2 N^2 numbers in each, round by so much at most.
    assert defect(name, N, method) < 64 * N**2 * np.finfo(float).eps


@pytest.mark.parametrize("name", FLUIDS)
def test_a_commutator_free_step_is_none(name: str) -> None:
    assert defect(name, 5, co.CommutatorFree(2)) > 1e-7
