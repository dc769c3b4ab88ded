"""Derivatives of runs: jvp and vjp are adjoint, and depend neither on threads nor on checkpoints."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from derivative_cases import (
    SPANS,
    H,
    U,
    assert_adjoint,
    attitudes_of,
    derivatives,
    element_for,
    fits,
    flow_schemes,
    with_each_once,
)

import coadjoint as co
from catalogue_cases import EXAMPLES, NAMES
from coadjoint.program.blocks import Kind
from coadjoint.runs.derivatives import differentiable_run
from long import long_beyond
from random_runs.algebras import some_algebra
from verification.systems_under_test import cases, full_matrix

PAIRS = [(s, c) for s, method in flow_schemes().items() for c, case in cases().items() if fits(method, case.system)]


def seeded(*names):
    return np.random.default_rng(zlib.crc32(" ".join(map(str, names)).encode()))


def check(system, method, x0, rng, spans=SPANS, members=(None, 2), kinds=None):
    """Compare the products for each kind of attitude, of a state and of an ensemble."""
    kinds = kinds or attitudes_of(system)
    prepared = [co.prepare(system, method, H, attitude=attitude) for attitude in kinds]
    for k, span in enumerate(spans):
        count, kind = members[k % len(members)], k % len(kinds)
        start = x0 if count is None else x0 * rng.uniform(0.7, 1.1, (count, 1))
        element = element_for(system, kinds[kind], k, count)
        assert_adjoint(derivatives(prepared[kind], start, span, rng, element))


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("scheme", "case"), with_each_once(PAIRS, 14))
def test_jvp_and_vjp_are_adjoint(scheme, case):
    method, (system, x0, _) = flow_schemes()[scheme], cases()[case]
    check(system, method, x0, seeded(scheme, case))


@pytest.mark.parametrize("attitude", [True, False, "coadjoint"])
def test_rational_rotations_beside_shears_are_differentiated(attitude):
    """Of the transposed actions only the rotations are rational; in each part of a top there are shears as well."""
    system, x0, _ = cases()["e(3), heavy top"]
    method = co.Splitting(order=4, rotation="rational")
    state = method.program(system).state
    assert {Kind.SHEAR, Kind.ROTATE} <= set(state.kind[state.run[0] : state.run[1]].tolist())
    check(system, method, x0, seeded("rational", attitude), kinds=(attitude,))


def wave(y, t):
    return np.cos(y) * (1.0 + 0.25 * t)


def wave_slope(y, t):
    return -np.sin(y) * (1.0 + 0.25 * t)


def wave_curvature(y, t):
    return -np.cos(y) * (1.0 + 0.25 * t)


def tame_hamiltonians(rng, algebra):
    """Return Hamiltonians of size one: diagonal and full, with linear terms, polynomials, and a function of time."""
    n = algebra.dim
    B = rng.uniform(-0.5, 0.5, (n, n)) / n
    powers = {tuple(k * (i == j) for j in range(n)): float(rng.uniform(0.1, 0.3)) for i in range(n) for k in (1, 3, 4)}
    return (
        co.Quadratic(rng.uniform(0.25, 1.0, n)),
        co.Quadratic(rng.uniform(0.25, 1.0, n), linear=rng.uniform(-0.25, 0.25, n)),
        co.Quadratic(np.diag(rng.uniform(0.25, 1.0, n)) + B + B.T, linear=rng.uniform(-0.25, 0.25, n)),
        co.Polynomial(powers),
        co.Separable(dict.fromkeys(range(n), (wave, wave_slope, wave_curvature))),
    )


@pytest.mark.thinned(10)
@pytest.mark.parametrize("name", NAMES)
def test_jvp_and_vjp_are_adjoint_on_the_catalogue(name):
    """All kinds of blocks up to dimension 5; most of these algebras are not unimodular."""
    algebra, rng = co.algebras.get(name, **EXAMPLES.get(name, {})), seeded(name)
    for k, energy in enumerate(tame_hamiltonians(rng, algebra)):
        system = co.LiePoissonSystem(algebra, energy, sign=(-1) ** k, casimirs={})
        method = (co.Splitting(order=2), co.Splitting(order=4, parts="coordinates"))[k % 2]
        check(system, method, rng.uniform(-0.6, 0.6, algebra.dim), rng, SPANS[k % 2 :][:2])


def test_catalogue_has_all_kinds_of_blocks():
    kinds = set()
    for name in NAMES:
        algebra = co.algebras.get(name, **EXAMPLES.get(name, {}))
        system = co.LiePoissonSystem(algebra, co.Quadratic(full_matrix(1, algebra.dim)), casimirs={})
        kinds.update(co.Splitting().program(system).state.kind.tolist())
    assert kinds == set(Kind)


@pytest.mark.parametrize("seed", long_beyond(5, range(60)))
def test_jvp_and_vjp_are_adjoint_on_random_algebras(seed):
    """Of up to 60 dimensions: families, direct sums, nilpotent and solvable ones, and other bases."""
    rng = np.random.default_rng(seed)
    algebra = some_algebra(rng)
    energies = tame_hamiltonians(rng, algebra)
    system = co.LiePoissonSystem(algebra, energies[rng.integers(5)], sign=int(rng.choice([-1, 1])))
    names = [name for name, method in flow_schemes().items() if fits(method, system)]
    method = flow_schemes()[names[rng.integers(len(names))]]
    x0 = rng.uniform(-0.5, 0.5, algebra.dim) / np.sqrt(algebra.dim)
    check(system, method, x0, rng, SPANS[:2], members=(None, 3))


SPINS = {
    "isotropic": co.systems.spin_lattice("chain", 3, exchange=0.75),
    "anisotropic": co.systems.spin_lattice("chain", 3, tensor=(1.0, 0.5, 0.25), on_site=(0.1, 0.2, 0.4)),
    "canted": co.systems.spin_lattice("chain", 3, dm=(0.1, 0.2, 0.3), field=(0.3, -0.1, 0.2)),
}
PARTS = [(n, p) for n, one in SPINS.items() for p in ("bonds", "auto", "free_body") if fits(co.Splitting(parts=p), one)]


@pytest.mark.parametrize(("name", "parts"), PARTS)
def test_jvp_and_vjp_are_adjoint_on_spin_lattices(name, parts):
    """Also where both spins of a bond turn about their sum."""
    system, rng = SPINS[name], seeded(name, parts)
    check(system, co.Splitting(order=4, parts=parts), rng.uniform(-0.8, 0.8, system.dim), rng, kinds=(True,))


SEVERAL = {
    "so(4), full, another basis": "coadjoint",
    "e(3), heavy top": True,
    "e(3), polynomial potential": False,
    "A3,7, full": True,
}
DIFFERENT = ("Splitting 4", "Splitting 2 compensated", "Splitting processed")


def ensemble(case, members):
    x0 = cases()[case].x0
    return x0 * np.linspace(1.0, 0.7, members)[:, None]


@pytest.mark.thinned(2)
@pytest.mark.parametrize("scheme", DIFFERENT)
@pytest.mark.parametrize("case", SEVERAL)
def test_members_have_the_derivatives_that_they_have_alone(case, scheme):
    """In whole lanes, in their remainders, and in one more member; those by parameters are adjoint sums."""
    system, attitude = cases()[case].system, SEVERAL[case]
    ready, span = co.prepare(system, flow_schemes()[scheme], H, attitude=attitude), SPANS[1]
    for members in (1, 3, 9, 40):
        x0, element = ensemble(case, members), element_for(system, attitude, 1, members)
        found = derivatives(ready, x0, span, seeded(case, members), element)
        assert_adjoint(found)
        for m in {0, members // 2, members - 1}:
            directions = {k: v[m] if k in ("x0", "attitude0") else v for k, v in found.directions.items()}
            given = {**span.points, "attitude": None if element is None else element[m]}
            _, tangents = ready.jvp(x0[m], span.ends, directions, **given)
            _, pullback = ready.vjp(x0[m], span.ends, **given)
            gradient = pullback(**{name: value[:, m] for name, value in found.cotangents.items()})
            pairs = [(getattr(tangents, name), getattr(found.tangents, name)[:, m]) for name in found.cotangents]
            pairs += [(gradient[name], found.gradient[name][m]) for name in gradient if name not in ready.parameters]
            for alone, together in pairs:
                assert np.abs(alone - together).max() <= found.rounding * max(1.0, np.abs(alone).max())


def numbers_of(found):
    """Return all derivatives as bytes."""
    arrays = [found.tangents.x, found.tangents.attitude, found.tangents.energy, *found.gradient.values()]
    return [np.ascontiguousarray(array).tobytes() for array in arrays if array is not None]


@pytest.mark.thinned(3)
@pytest.mark.parametrize("scheme", DIFFERENT)
@pytest.mark.parametrize("case", SEVERAL)
def test_derivatives_do_not_depend_on_the_number_of_threads(case, scheme):
    system, attitude, found = cases()[case].system, SEVERAL[case], []
    for threads in (1, 2):
        ready = co.prepare(system, flow_schemes()[scheme], H, attitude=attitude, threads=threads)
        x0, element = ensemble(case, 70), element_for(system, attitude, 2, 70)
        found.append(numbers_of(derivatives(ready, x0, SPANS[0], seeded(case), element)))
    assert found[0] == found[1]


@pytest.mark.thinned(3)
@pytest.mark.parametrize("scheme", DIFFERENT)
@pytest.mark.parametrize("case", SEVERAL)
def test_gradients_do_not_depend_on_checkpoints(case, scheme, monkeypatch):
    """Up to round-off: joined flows are separate where the added part is between them."""
    system, attitude = cases()[case].system, SEVERAL[case]
    ready = co.prepare(system, flow_schemes()[scheme], H, attitude=attitude)
    for members, span in ((None, SPANS[0]), (3, SPANS[1])):
        x0 = cases()[case].x0 if members is None else ensemble(case, members)
        element = element_for(system, attitude, 3, members)
        monkeypatch.undo()
        expected = derivatives(ready, x0, span, seeded(case), element)
        numbers = system.dim + (0 if element is None else element.shape[-1] ** 2)
        for steps in (1, 3):
            monkeypatch.setattr(differentiable_run, "STEPS_OF_STRETCH", 1)
            monkeypatch.setattr(differentiable_run, "NUMBERS_OF_STRETCH", steps * numbers)
            found = derivatives(ready, x0, span, seeded(case), element)
            for name, value in expected.gradient.items():
                bound = expected.rounding * max(1.0, np.abs(value).max())
                assert np.abs(found.gradient[name] - value).max() <= bound


def test_number_of_checkpoints_is_bounded(monkeypatch):
    """Of 48 bytes each, for the momentum and what its sums have lost."""
    ready = co.prepare(co.systems.rigid_body((1, 2, 3)), co.Splitting(), H)
    span, counts = (0.0, 1000 * H), []
    monkeypatch.setattr(differentiable_run, "STEPS_OF_STRETCH", 1)
    monkeypatch.setattr(differentiable_run, "NUMBERS_OF_STRETCH", 3)
    for size in (2**25, 4800):
        monkeypatch.setattr(differentiable_run, "BYTES_OF_CHECKPOINTS", size)
        _, pullback = ready.vjp([0.3, 1.0, 0.2], span, 1000)
        counts.append(len(pullback._trajectory.stretches))
    assert counts == [1000, 100]


def assert_same_run(one, other):
    for name in ("t", "x", "energy", "attitude", "failed"):
        first, second = getattr(one, name), getattr(other, name)
        assert (first is None and second is None) or np.array_equal(first, second)
    for name, values in one.casimirs.items():
        assert np.array_equal(values, other.casimirs[name])
    assert one.drift() == other.drift() and one.stats.evaluations == other.stats.evaluations


@pytest.mark.parametrize("scheme", [*DIFFERENT, "Splitting 2 rational", "Composition of Splitting"])
def test_runs_have_the_same_bits_with_derivatives(scheme, monkeypatch):
    monkeypatch.setattr(differentiable_run, "STEPS_OF_STRETCH", 1)
    monkeypatch.setattr(differentiable_run, "NUMBERS_OF_STRETCH", 2 * (6 + 16))
    system = cases()["e(3), heavy top"].system
    ready = co.prepare(system, flow_schemes()[scheme], H, attitude=True, observe={"spin": lambda x: x[2]})
    for members in (None, 1, 5):
        x0 = ensemble("e(3), heavy top", members or 1)[slice(None) if members else 0]
        element = element_for(system, True, 4, members)
        for span in SPANS:
            given = {**span.points, "attitude": element}
            plain = ready.run(x0, span.ends, **given)
            with_tangents, _ = ready.jvp(x0, span.ends, {"x0": np.ones(x0.shape)}, **given)
            with_cotangents, pullback = ready.vjp(x0, span.ends, **given)
            pullback(energy=np.ones(plain.energy.shape))
            for other in (with_tangents, with_cotangents, ready.run(x0, span.ends, **given)):
                assert_same_run(plain, other)
                assert np.array_equal(plain.observed["spin"], other.observed["spin"])


def test_pickled_run_has_the_same_derivatives():
    system = cases()["e(3), heavy top"].system
    ready = co.prepare(system, co.Splitting(order=4), H, attitude=True)
    x0, element = cases()["e(3), heavy top"].x0, element_for(system, True, 5)
    expected = numbers_of(derivatives(ready, x0, SPANS[1], seeded(5), element))
    for other in (pickle.loads(pickle.dumps(ready)), co.prepare(system, co.Splitting(order=4), H, attitude=True)):
        assert numbers_of(derivatives(other, x0, SPANS[1], seeded(5), element)) == expected


def test_one_direction_has_no_further_axis():
    ready = co.prepare(co.systems.heavy_top(), co.Splitting(), H, attitude=True)
    x0, rng = np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8]), seeded(6)
    directions = {"x0": rng.standard_normal((6, 3)), "lever": rng.standard_normal((3, 3))}
    sol, several = ready.jvp(x0, (0, 1), directions)
    assert several.x.shape == (*sol.x.shape, 3) and several.attitude.shape == (*sol.attitude.shape, 3)
    for k in range(3):
        _, one = ready.jvp(x0, (0, 1), {name: value[:, k] for name, value in directions.items()})
        for name in ("x", "attitude", "energy"):
            assert getattr(one, name).shape == getattr(sol, name).shape
            # Directions are lanes, with the same operations in each.
            assert np.array_equal(getattr(one, name), getattr(several, name)[..., k])


def test_directions_that_are_not_given_are_zero():
    ready = co.prepare(co.systems.heavy_top(), co.Splitting(order=4), H, attitude=True)
    x0, rng = np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8]), seeded(7)
    shapes = {"x0": (6,), "attitude0": (4, 4), "inertia": (3,), "lever": (3,)}
    directions = {name: rng.standard_normal(shape) for name, shape in shapes.items()}
    sol, together = ready.jvp(x0, (0, 2), directions)
    parts = [ready.jvp(x0, (0, 2), {name: value})[1] for name, value in directions.items()]
    bound = 4 * U * sol.stats.evaluations
    for name in ("x", "attitude", "energy"):
        values = [getattr(part, name) for part in parts]
        assert np.abs(sum(values) - getattr(together, name)).max() <= bound * np.abs(values).sum(axis=0).max()
    assert not parts[1].x.any() and parts[2].rule == {"inertia": "exact"}


def sum_of_functions(x):
    return x[0] * x[1] + x[2] ** 2 + np.sin(x[0])


def test_cotangents_of_energies_and_observed_quantities_are_those_of_their_gradients():
    """To round-off: a complex step differentiates observed quantities, and sums have tens of terms of size one."""
    system, bound = cases()["e(3), heavy top"].system, 2.0**-44
    ready = co.prepare(system, co.Splitting(order=4), H, observe={"sum": sum_of_functions, "first": lambda x: x[0]})
    rng = seeded(8)
    for x0 in (cases()["e(3), heavy top"].x0, ensemble("e(3), heavy top", 3)):
        for span in SPANS[:3]:
            sol, pullback = ready.vjp(x0, span.ends, **span.points)
            given = {name: rng.standard_normal(values.shape) for name, values in sol.observed.items()}
            x, of_x = np.moveaxis(sol.x, -1, 0), np.zeros((6, *sol.energy.shape))
            of_x[:3] = given["sum"] * np.array([x[1] + np.cos(x[0]), x[0], 2 * x[2]])
            of_x[0] += given["first"]
            one, other = pullback(observed=given), pullback(np.moveaxis(of_x, 0, -1))
            for name, value in other.items():
                assert np.abs(one[name] - value).max() <= bound * max(1.0, np.abs(value).max())
            of_energy = rng.standard_normal(sol.energy.shape)
            slope = np.apply_along_axis(system.hamiltonian.gradient, -1, sol.x)
            one, other = pullback(energy=of_energy), pullback(of_energy[..., None] * slope)
            # The energy x.M x/2 + b.x depends on M and b also at a given state.
            by_entries = [np.tensordot(of_energy, of_one, of_energy.ndim) for of_one in (sol.x**2 / 2, sol.x)]
            direct = {"x0": 0.0} | dict(zip(("M", "linear"), by_entries, strict=True))
            for name, value in other.items():
                assert np.abs(one[name] - value - direct[name]).max() <= bound * max(1.0, np.abs(value).max())


def test_derivatives_of_no_steps():
    """Outputs are the initial state: also of times before the end of the first step."""
    ready = co.prepare(co.systems.rigid_body((1, 2, 3)), co.Splitting(), H, attitude=True)
    x0, unit = np.array([0.3, 1.0, 0.2]), np.eye(3)
    for span, points in (((2, 2), {}), ((0, 1), {"t_eval": [0.0, 0.0]})):
        sol, tangents = ready.jvp(x0, span, {"x0": unit, "inertia": unit}, **points)
        assert np.array_equal(tangents.x, np.broadcast_to(unit, sol.x.shape[:1] + (3, 3)))
        _, pullback = ready.vjp(x0, span, **points)
        gradient = pullback(np.ones(sol.x.shape), attitude=np.ones(sol.attitude.shape))
        assert gradient["x0"].tolist() == [len(sol.t)] * 3 and not gradient["inertia"].any()
        assert np.array_equal(gradient["attitude0"], len(sol.t) * np.ones((3, 3)))


@pytest.mark.parametrize("energy", [co.Quadratic(0.0), co.Quadratic([2.0, 2.0, 2.0]), co.Quadratic(np.zeros((3, 3)))])
def test_systems_at_rest_have_derivatives(energy):
    """Of a Casimir as energy no part remains: x' = J(x) grad G alone."""
    system = co.LiePoissonSystem(co.algebras.so(3), energy, sign=-1)
    ready = co.prepare(system, co.Splitting(order=4), H)
    x0, w = np.array([0.3, 1.0, 0.2]), np.array([0.5, -0.25, 1.0])
    _, tangents = ready.jvp(x0, (0, 8 * H), {"linear": w}, save_every=8)
    assert np.abs(tangents.x[-1] - 8 * H * np.cross(x0, w)).max() <= 200 * U


TOP_AT_REST = (0.0, 0.0, 0.0, 0.3, 0.1, 0.9)


@pytest.mark.parametrize(
    ("system", "parts", "x0"),
    [
        (co.systems.heavy_top(inertia=(1.0, 2.0, 2.5)), "free_body", TOP_AT_REST),
        (co.systems.heavy_top(inertia=(1.0, 1.0, 1.0)), "free_body", TOP_AT_REST),
        (co.systems.spin_lattice(shape=2, exchange=1.3), "bonds", (0.6, 0.0, 0.8, -0.6, 0.0, -0.8)),
    ],
    ids=["top", "round top", "opposite spins"],
)
@pytest.mark.parametrize("members", [(), (40,)])
def test_bodies_at_rest_and_opposite_spins_have_derivatives(system, parts, x0, members):
    """Their rotation has no axis, but an angular velocity that is linear in the momentum."""
    x0 = np.array(x0)
    ready = co.prepare(system, co.Splitting(order=2, parts=parts), 0.1)
    start = np.broadcast_to(x0, (*members, 6))
    span = (0.5, 1.5)

    def end(x):
        return ready.run(x, span, 10).x[-1]

    units = 1e-3 * np.eye(6)
    wanted = [(8 * (end(x0 + e) - end(x0 - e)) - (end(x0 + 2 * e) - end(x0 - 2 * e))) / 12e-3 for e in units]
    directions = np.broadcast_to(np.eye(6), (*members, 6, 6))
    _, tangents = ready.jvp(start, span, {"x0": directions}, save_every=10)
    # The error of the differences is 1e-12 times a fifth derivative, and the rounding divided by 1e-3.
    np.testing.assert_allclose(tangents.x[-1], np.broadcast_to(np.transpose(wanted), (*members, 6, 6)), atol=1e-10)
    sol, pullback = ready.vjp(start, span, save_every=10)
    cotangent = np.zeros(sol.x.shape)
    cotangent[-1] = np.arange(1.0, 7.0)
    expected = np.broadcast_to(np.array(wanted) @ np.arange(1.0, 7.0), (*members, 6))
    np.testing.assert_allclose(pullback(cotangent)["x0"], expected, atol=1e-9)


MEASURED_DERIVATIVES = """
import resource, sys
import numpy as np
import coadjoint as co
lattice = co.systems.spin_lattice("square", shape=(36, 36))
system = co.LiePoissonSystem(lattice.algebra, lattice.hamiltonian, sign=lattice.sign)
x0 = np.random.default_rng(1).standard_normal(system.dim)
ready = co.prepare(system, {"splitting": co.Splitting(order=2), "gauss": co.GaussLegendre(1)}[sys.argv[1]], 0.01)
ready.run(x0, (0, 0.02))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
if sys.argv[2] == "vjp":
    sol, pullback = ready.vjp(x0, (0, 0.02))
    pullback(x=np.ones(sol.x.shape))
else:
    ready.jvp(x0, (0, 0.02), {"x0": x0})
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="the largest memory of a process is read by getrusage")
@pytest.mark.parametrize("scheme", ["splitting", "gauss"])
@pytest.mark.parametrize("product", ["jvp", "vjp"])
def test_memory_of_derivatives_is_not_quadratic(scheme, product):
    """Matrices are needed for functions of the user alone: a part of 1296 angles has none of this size."""
    environment = {**os.environ, "PYTHONPATH": str(Path(co.__file__).parents[1])}
    command = [sys.executable, "-c", MEASURED_DERIVATIVES, scheme, product]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert int(done.stdout) * (1 if sys.platform == "darwin" else 1024) < 1.5 * 8 * 1296**2
