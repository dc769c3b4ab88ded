"""The picture of drifts of matrix states: deviations and rests relative to sizes of the start, by name and member."""

from __future__ import annotations

import re
from typing import Any

import drawn_runs
import numpy as np
import pytest
from drawn_runs import axes_of, sizes_of
from matplotlib.collections import PolyCollection

import coadjoint as co
from coadjoint.pictures.style import symbol

T0 = 7.3
MEMBERS, POINTS = 3, 30
SYSTEMS = {
    "one field": co.systems.torus_euler(5),
    "active field": co.systems.get("reduced_mhd", N=5, surface="torus"),
    "passive field": co.systems.get("passive_scalar", N=5, surface="torus"),
}


def absolute_trace(name: str, state: np.ndarray) -> float:
    """Return the sum of the products of singular values, in descending order, of the factors of a trace."""
    fields = state if state.ndim == 3 else [state, state]
    values = {
        field: np.sqrt(np.maximum(np.linalg.eigvalsh(M.conj().T @ M)[::-1], 0.0))
        for field, M in zip(("Theta", "W"), fields, strict=True)
    }
    total = np.ones(len(state[-1]))
    for field, power in re.findall(r"(W|Theta)(?:\^(\d))?", name):
        total = total * values[field] ** int(power or 1)
    return float(total.sum())


def drawn_run(system: Any, sense: float, forced: bool) -> Any:
    rng = np.random.default_rng(4)
    fluid = co.systems.torus_euler(5)
    fields = len(system.shape) - 1
    states = [[fluid.random(seed, degrees=(1, 2)) for seed in range(fields)] for _ in range(MEMBERS)]
    scales = np.array([1.0, 3.0, 0.2]).reshape(-1, *[1] * len(system.shape))
    start = scales * np.array(states).reshape(MEMBERS, *system.shape)
    x = start * (1.0 + 0.01 * np.arange(POINTS)).reshape(-1, *[1] * start.ndim)
    series = {
        name: scale * rng.normal(size=(POINTS, MEMBERS)) for scale, name in enumerate(("energy", *system.casimirs), 1)
    }
    series["energy"][7, 2] = -9.0  # the largest size of an energy, which is negative
    work = {}
    if forced:
        quadratic = next(iter(system.casimirs))
        work = {
            "first": {name: rng.normal(size=(POINTS, MEMBERS)) for name in ("energy", quadratic)},
            "second": {"energy": rng.normal(size=(POINTS, MEMBERS))},
        }
        system = system.with_forces(co.forces.LinearDamping(0.1), co.forces.LinearDamping(0.2))
    t = T0 + sense * 0.01 * np.arange(POINTS)
    energy = series.pop("energy")
    return drawn_runs.made(t, x, system, energy=energy, casimirs=series, work=work)


@pytest.mark.thinned(10)
@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("forced", [False, True])
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("members", [None, [2, 0]])
def test_deviations_and_rests_are_relative_to_the_sizes_at_the_start(name, forced, sense, members):
    run = drawn_run(SYSTEMS[name], sense, forced)
    axes = axes_of(run, "drift", members)
    shown = list(range(MEMBERS)) if members is None else members
    sizes = {each: size[shown] for each, size in sizes_of(run).items()}
    for each in run.casimirs:
        values = np.abs(run.casimirs[each][0, shown])
        terms = np.array([absolute_trace(each, run.x[0, m]) for m in shown])
        # Singular values by eigenvalues of W* W are known to half the digits where they are small.
        np.testing.assert_allclose(sizes[each], np.where(values < terms / 1024, terms, values), rtol=1e-6)
    changes = {
        each: (values - values[0])[:, shown] / sizes[each]
        for each, values in {"energy": run.energy, **run.casimirs}.items()
    }
    casimirs = [each for each in changes if each != "energy"]
    if len(casimirs) > 5:
        deviations = np.abs(np.stack([changes[each] for each in casimirs]))
        (band,) = (drawn for drawn in axes.collections if isinstance(drawn, PolyCollection))
        heights = band.get_paths()[0].vertices[:, 1]
        wanted = deviations[deviations > 0.0].min(), deviations.max()
        np.testing.assert_allclose((heights.min(), heights.max()), wanted, rtol=1e-9)
        casimirs = sorted(casimirs, key=lambda each: -np.abs(changes[each]).max())[:4]
    lines = list(axes.lines)
    for each in ("energy", *casimirs):
        drawn, lines = lines[: len(shown)], lines[len(shown) :]
        assert drawn[0].get_label() == ("$H$" if each == "energy" else symbol(each))
        for column, line in enumerate(drawn):
            wanted = np.abs(changes[each][:, column])
            np.testing.assert_array_equal(line.get_xdata(), run.t)
            # Singular values by eigenvalues of W* W are known to half the digits where they are small.
            np.testing.assert_allclose(line.get_ydata(), np.where(wanted > 0.0, wanted, np.nan), rtol=1e-7)
        if not forced:
            continue
        drawn, lines = lines[: len(shown)], lines[len(shown) :]
        done = sum(by[each] for by in run.work.values() if each in by)
        rest = np.abs(changes[each] - (np.zeros_like(run.energy) + done)[:, shown] / sizes[each])
        for column, line in enumerate(drawn):
            assert line.get_linestyle() == ":"
            wanted = rest[:, column]
            np.testing.assert_allclose(line.get_ydata(), np.where(wanted > 0.0, wanted, np.nan), rtol=1e-7)
    assert not lines and axes.get_ylabel() == "relative deviation from start"
