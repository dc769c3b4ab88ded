"""Members of batches have the bits of single runs, for every scheme and any number of threads."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.runs import run as loop

from .schemes_under_test import schemes, serves
from .systems_under_test import full_matrix, rotation_unlike_jacobi, rotation_unlike_jacobi_derivative

pytestmark = pytest.mark.thinned(6)

SPAN, STEP = (0.0, 1.0), 0.0625


def bodies():
    """Bodies with different middle axes; the last two have fewer candidates for a shift."""
    return [
        co.systems.rigid_body(I) for I in ((1, 2, 3), (3, 1, 2.5), (2, 2.5, 1), (1.25, 2.25, 3), (2, 2, 1), (3, 3, 3))
    ]


def spirals():
    """Different structure constants and periodic Casimirs, and one diagonal M."""
    algebras = [co.algebras.get("A3,7", a=a) for a in (1.0, 1.75, 2.5)]
    matrices = [full_matrix(1, 3), full_matrix(2, 3), np.diag([1.0, 2.0, 0.25])]
    return [co.LiePoissonSystem(g, co.Quadratic(M)) for g, M in zip(algebras, matrices, strict=True)]


def tops():
    e3 = co.algebras.e(3)
    return [
        co.LiePoissonSystem(e3, co.Quadratic(full_matrix(m, 6), linear=np.arange(6) / (5 + m)), -1) for m in (1, 2, 3)
    ]


def wells():
    """Different user functions, and a member with another kind of Hamiltonian."""
    well = (lambda y: 0.5 * y**2 + 0.1 * y**4, lambda y: y + 0.4 * y**3, lambda y: 1 + 1.2 * y**2)
    wave = (lambda y: np.cos(y), lambda y: -np.sin(y), lambda y: -np.cos(y))
    g = co.algebras.sl(2)
    kinds = [co.Separable({0: well, 2: wave}), co.Separable({0: wave, 2: well}), co.Quadratic([1.0, 0.5, 0.75])]
    return [co.LiePoissonSystem(g, H) for H in kinds]


def without_jacobi():
    return [
        co.PoissonSystem(
            rotation_unlike_jacobi, co.Quadratic(full_matrix(m, 3)), derivative=rotation_unlike_jacobi_derivative, dim=3
        )
        for m in (4, 5, 6)
    ]


BATCHES = {f.__name__: f for f in (bodies, spirals, tops, wells, without_jacobi)}
PAIRS = [
    (s, b)
    for b, systems in {b: make() for b, make in BATCHES.items()}.items()
    for s, method in schemes().items()
    if all(serves(method, system) for system in systems)
]


def same(one, other):
    return np.array_equal(one, other, equal_nan=True)


@pytest.mark.thinned(176)
@pytest.mark.parametrize(("scheme", "name"), PAIRS)
def test_member_of_a_batch_equals_its_single_run(scheme, name, monkeypatch):
    method, systems = schemes()[scheme], BATCHES[name]()
    batch = co.batch(systems)
    attitude = False if method.properties(systems[0]).attitude == "none" else "coadjoint"
    x0 = np.linspace(0.3, 0.6, batch.dim) * (1.0 + 0.1 * np.arange(len(batch))[:, None])

    def run(system, x, **options):
        return co.integrate(system, x, SPAN, STEP, method, save_every=3, attitude=attitude, **options)

    together = [run(batch, x0, threads=count) for count in (1, 2, 3)]
    monkeypatch.setattr(loop, "SECONDS_BETWEEN_UPDATES", 0.0)  # cut after every step
    together.append(run(batch, x0, threads=2, progress=True))
    alone = [run(system, x) for system, x in zip(systems, x0, strict=True)]
    for sol in together:
        for m, one in enumerate(alone):
            assert same(sol.x[:, m], one.x) and same(sol.energy[:, m], one.energy)
            assert attitude is False or same(sol.attitude[:, m], one.attitude)
            for casimir, values in one.casimirs.items():
                assert same(sol.casimirs[casimir][:, m], values)
            for invariant, drift in one.drift().items():
                assert same(sol.drift()[invariant].tenths[m], drift.tenths)
        assert sol.stats.evaluations == sum(one.stats.evaluations for one in alone)
    shared = run(batch, x0[0])
    assert same(shared.x[:, 0], alone[0].x) and same(shared.x[0, -1], x0[0])


@pytest.mark.parametrize("name", ["bodies", "tops"])
@pytest.mark.parametrize("scheme", ["Splitting 4", "Splitting 2 coordinates"])
def test_attitude_uses_the_representation_of_each_member(scheme, name):
    method, systems = schemes()[scheme], BATCHES[name]()
    x0 = np.linspace(0.3, 0.6, systems[0].dim)
    sol = co.integrate(co.batch(systems), x0, SPAN, STEP, method, attitude=True)
    for m, system in enumerate(systems):
        assert same(sol.attitude[:, m], co.integrate(system, x0, SPAN, STEP, method, attitude=True).attitude)


@pytest.mark.parametrize("scheme", ["Splitting 2", "Splitting 4", "GaussLegendre 2", "RadauEnergy 2", "Taylor 5"])
def test_prepared_runs_equal_integrate(scheme):
    method = schemes()[scheme]
    for system in (bodies()[0], co.batch(tops())):
        x0 = np.linspace(0.3, 0.6, system.dim)
        ready = co.prepare(system, method, STEP)
        for span in (SPAN, (0.5, -0.5), (0.0, STEP), SPAN):
            sol, once = ready.run(x0, span, 4), co.integrate(system, x0, span, STEP, method, save_every=4)
            assert same(sol.t, once.t) and same(sol.x, once.x) and same(sol.energy, once.energy)
