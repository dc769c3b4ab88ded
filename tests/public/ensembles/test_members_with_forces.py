"""Members with forces, which take their steps together, have the bits of runs alone."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import coadjoint as co
from matrix.forces import force_on

F = co.forces
T0, STEP, STEPS = 0.3125, 0.0625, 6  # exact, also in runs that are resumed
MEMBERS = 35  # more than are lanes, and not a multiple of them
SYSTEMS = {
    "so(3)": lambda: co.systems.rigid_body((1.0, 2.0, 2.5)),
    "so(4)": co.systems.manakov_top,
    "spins": lambda: co.systems.spin_lattice("ring", 3, exchange=0.7, field=(0.0, 0.2, -0.0)),
    "vortices": lambda: co.systems.spin_lattice("complete", 9, exchange=0.3),
    "e(3)": co.systems.kirchhoff_body,
    "body": lambda: co.systems.body((1.0, 2.0, 2.5)),
    "function": lambda: co.LiePoissonSystem(co.algebras.so(3), lambda x: np.cos(x[0]) + 0.5 * x[1] ** 2 * x[2]),
}


def states(system: Any, members: int = MEMBERS) -> Any:
    x = np.random.default_rng(7).normal(size=(members, system.dim))
    return x / np.linalg.norm(x, axis=1, keepdims=True)


def of_member(system: Any, m: int) -> Any:
    """Return the system with the noise of member m."""
    shifted = [replace(one, stream=one.stream + m) if one.random else one for one in system.forces]
    return system.unforced.with_forces(*shifted)


def run(system: Any, x0: Any, steps: int = STEPS, t0: float = T0, method: Any = None, **options: Any) -> Any:
    return co.integrate(system, x0, (t0, t0 + steps * STEP), STEP, method or co.Splitting(), **options)


def numbers_of(sol: Any, member: int | None = None) -> dict[str, Any]:
    """Return everything that depends on the bits of a run, of one of its members."""
    work = {f"{label}, {name}": one[name] for label, one in sol.work.items() for name in one}
    found = {"x": sol.x, **work, "energy": sol.energy}
    return {name: np.array(one if member is None else one[:, member]) for name, one in found.items()}


def assert_as_alone(system: Any, method: Any = None, members: Any = (0, 1, 31, 32, MEMBERS - 1), **options: Any) -> Any:
    x0 = states(system)
    whole = run(system, x0, method=method, **options)
    for m in members:
        alone, found = numbers_of(run(of_member(system, m), x0[m], method=method)), numbers_of(whole, m)
        for name, expected in alone.items():
            assert expected.tobytes() == found[name].tobytes(), (m, name)
    return whole


def fitting(name: str) -> list[tuple[str, Any]]:
    """Return the systems that take a registered force."""
    found = []
    for label, make in SYSTEMS.items():
        with suppress(TypeError, ValueError):
            found.append((label, make().with_forces(force_on(name, make()))))
    return found


VECTOR_FORCES = [name for name in F.names() if fitting(name)]


@pytest.mark.parametrize("all_systems", [False, pytest.param(True, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", VECTOR_FORCES)
def test_members_with_each_force(name, all_systems):
    for label, system in fitting(name)[: None if all_systems else 1]:
        method = co.GaussLegendre(1) if label == "function" else None
        assert_as_alone(system, method, members=(1, 32))


def test_most_forces_are_of_vectors():
    assert {"HamiltonianNoise", "HeatBath", "Gilbert", "LinearDamping", "Langevin", "RandomTorque"} <= {*VECTOR_FORCES}


NOISES = {
    "axes": np.eye(3),
    "axes askew": [(1.0, 2.0, 3.0), (0.0, -1.0, 1.0)],
    "many": np.tile(np.eye(3), (3, 1))[:8],  # the coin is the first word of another block
    "gradients constant along flows": ["x2^2/2", "x1"],
    "squares": ["x1*x2 + x3^2"],
    "neither": ["x1^2*x3/2", "exp(x2/4)"],
}


@pytest.mark.parametrize("levels", [0, 2])
@pytest.mark.parametrize("kind", NOISES)
@pytest.mark.parametrize("base", ["so(3)", "so(4)"])
def test_hamiltonian_noise_of_every_kind(base, kind, levels):
    hamiltonians = NOISES[kind]
    if base == "so(4)" and not isinstance(hamiltonians[0], str):
        hamiltonians = np.hstack([hamiltonians, np.roll(hamiltonians, 1, axis=1)])
    noise = F.HamiltonianNoise(hamiltonians, 0.6, seed=3, levels=levels)
    assert_as_alone(SYSTEMS[base]().with_forces(noise), members=(0, 32))


def all_together(system: Any) -> Any:
    n = system.dim
    return system.with_forces(
        F.Torque(np.cos(np.arange(n))),
        F.LinearDamping(np.diag(np.linspace(0.1, 0.3, n)) + 0.02),
        F.HeatBath(0.3, temperature=0.2, seed=5),
        F.HamiltonianNoise(np.eye(n), 0.4, seed=1),
        F.DoubleBracketDamping(0.1),
    )


@pytest.mark.parametrize("base", ["so(3)", "so(4)", "spins"])
def test_forces_that_meet(base):
    system = all_together(SYSTEMS[base]())
    for method in (co.Splitting(), co.Splitting(compensated=True), co.GaussLegendre(1), co.Taylor()):
        whole = assert_as_alone(system, method, members=(1, 33))
    assert len(whole.work) == 5


@pytest.mark.parametrize("order", [4, 6])
def test_substeps_backward_in_time(order):
    system = SYSTEMS["so(4)"]().with_forces(
        F.Torque(np.full(6, 0.1)), F.DoubleBracketDamping(0.1), F.LinearDamping(0.2)
    )
    assert_as_alone(system, co.Splitting(order=order))


def test_runs_backward():
    system = SYSTEMS["so(3)"]().with_forces(F.Torque((0.1, 0.2, 0.3)), F.LinearDamping(0.2))
    x0 = states(system)
    end = run(system, x0).x[-1]
    back = co.integrate(system, end, (T0 + STEPS * STEP, T0), STEP, co.Splitting())
    alone = co.integrate(system, end[4], (T0 + STEPS * STEP, T0), STEP, co.Splitting())
    assert np.array_equal(back.x[:, 4], alone.x)
    assert np.max(np.abs(back.x[-1] - x0)) < 1e-13


@pytest.mark.parametrize("base", ["so(3)", "so(4)", "spins"])
def test_partitions_of_a_run(base, tmp_path):
    system = all_together(SYSTEMS[base]())
    x0 = states(system, 70)
    whole = numbers_of(run(system, x0))
    for options in ({"threads": 2}, {"watch": False}, {"archive": tmp_path / f"{base}.zarr"}):
        found = run(system, x0, **options)
        assert np.array_equal(found.x, whole["x"])
    path = tmp_path / f"{base} in two.zarr"
    run(system, x0, 2, archive=path)
    assert np.array_equal(co.resume(path, T0 + STEPS * STEP).x, whole["x"])
    few = run(system, x0[:1])
    assert np.array_equal(few.x, whole["x"][:, :1])


@pytest.mark.parametrize("unit", [1e-7, 1e30])
def test_other_units(unit):
    """Momenta, energies and strengths in other units: the same motion, and the same bits of members."""
    body = co.systems.rigid_body(unit * np.array((1.0, 2.0, 2.5)))
    noisy = body.with_forces(
        F.HamiltonianNoise(np.eye(3), 0.4, seed=1), F.HeatBath(0.3 / unit, temperature=0.2 * unit, seed=5)
    )
    x0 = unit * states(body)
    whole = co.integrate(noisy, x0, (T0, T0 + STEPS * STEP), STEP, co.Splitting())
    alone = co.integrate(of_member(noisy, 34), x0[34], (T0, T0 + STEPS * STEP), STEP, co.Splitting())
    assert np.array_equal(whole.x[:, 34], alone.x)
    plain = SYSTEMS["so(3)"]().with_forces(
        F.HamiltonianNoise(np.eye(3), 0.4, seed=1), F.HeatBath(0.3, temperature=0.2, seed=5)
    )
    np.testing.assert_allclose(whole.x / unit, run(plain, x0 / unit).x, rtol=0, atol=1e-13)


FAILING = {
    "torque": F.Torque(lambda x: np.where(x[0] > 1e3, np.inf, 0.1) * np.ones(3)),
    "damping": F.LinearDamping(-400.0),
    "noise": F.HamiltonianNoise(["exp(x1^2)"], 1.0, seed=3),
    "bath": F.DoubleBracketDamping(0.1),
}


@pytest.mark.parametrize("kind", FAILING)
def test_members_that_fail_leave_the_others(kind):
    """Those of large states fail, each in the step and for the reason for which it fails alone."""
    system = SYSTEMS["so(3)"]().with_forces(FAILING[kind])
    x0 = states(system)
    large = {"noise": 6.0, "bath": 1e160}.get(kind, 1e305)
    x0[[3, 17, 33]] *= large
    with pytest.raises(co.IntegrationError) as raised:
        run(system, x0)
    whole = raised.value.partial
    assert np.flatnonzero(whole.failed).tolist() == [3, 17, 33]
    for m in (3, 4, 17, 33, 34):
        if whole.failed[m]:
            with pytest.raises(co.IntegrationError) as alone:
                run(of_member(system, m), x0[m])
            found, taken = alone.value.partial.x, len(alone.value.partial.x)
            assert np.all(np.isnan(whole.x[taken:, m]))
        else:
            found = run(of_member(system, m), x0[m]).x
        assert np.array_equal(whole.x[: len(found), m], found)


def test_large_increments_take_squarings():
    """Noise of hundreds of turns a step: exponentials of more substeps than lanes take."""
    x0 = states(SYSTEMS["so(4)"]())
    noisy = SYSTEMS["so(4)"]().with_forces(F.HamiltonianNoise(np.eye(6), 900.0, seed=3))
    whole = assert_as_alone(noisy, members=(0, 5, 32))
    lengths = np.linalg.norm(whole.x, axis=-1)
    assert np.max(np.abs(lengths / np.linalg.norm(x0, axis=1) - 1.0)) < 1e-10


def test_counts_of_iterations():
    """Evaluations and iterations are the sums of those that members count alone."""
    timed = F.Torque(lambda t: np.cos(t + np.arange(6)))
    system = all_together(SYSTEMS["so(4)"]()).with_forces(timed)
    x0 = states(system)
    whole = run(system, x0)
    alone = [run(of_member(system, m), x0[m]).stats for m in range(MEMBERS)]
    assert whole.stats.evaluations == sum(one.evaluations for one in alone)
    assert whole.stats.iterations == sum(one.iterations for one in alone)
