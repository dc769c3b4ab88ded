"""Products of matrices in the statistics of runs, counted by routines of BLAS that count what they multiply."""

import ctypes

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.tables import steps
from served import state_of

INT, ADDRESS = ctypes.POINTER(ctypes.c_int), ctypes.c_void_p
GEMM = ctypes.CFUNCTYPE(None, ADDRESS, ADDRESS, INT, INT, INT, *[ADDRESS] * 7, INT)
REAL_PRODUCTS = {"zgemm": 1, "dgemm": 3, "sgemm": 3}  # of planes, for a product of complex matrices


@pytest.fixture
def counted(monkeypatch):
    """Return the multiplications of each routine of the steps, while a test lasts."""
    counts, routines, address_of = dict.fromkeys(REAL_PRODUCTS, 0), {}, steps.blas_address

    def counting(name):
        if name not in routines:
            called = GEMM(address_of(name))

            def multiply(*arguments):
                counts[name] += arguments[2][0] * arguments[3][0] * arguments[4][0]
                called(*arguments)

            routines[name] = GEMM(multiply)
        return ctypes.cast(routines[name], ctypes.c_void_p).value

    monkeypatch.setattr(steps, "blas_address", counting)
    return counts


def leaves(n):
    """Return the part of an inverse that is swept without BLAS, in products: blocks of up to 32 rows."""
    cubes = lambda size: size**3 if size <= 32 else cubes(size // 2) + cubes(size - size // 2)  # noqa: E731
    return cubes(n) / n**3


SPHERE = co.systems.sphere_euler
WEIGHTS = co.systems.Weights(1.0 / (1.0 + np.add.outer(np.arange(5.0), np.arange(5.0))))
CASES = [
    (SPHERE(N=21), co.IsospectralGauss()),
    (SPHERE(N=67), co.IsospectralGauss()),
    (SPHERE(N=40), co.IsospectralGauss(2)),
    (SPHERE(N=12), co.Composition(co.IsospectralGauss(), (1.5, -2.0, 1.5))),
    (co.systems.reduced_mhd(N=35), co.IsospectralGauss()),
    (co.systems.passive_scalar(N=35), co.IsospectralGauss()),
    (co.systems.layered_qg(N=35, gamma=((2.0, -1.0), (-1.0, 1.0))), co.IsospectralGauss()),
    (co.systems.layered_qg(N=35, gamma=((2.0, -1.0), (-1.0, 1.0))), co.IsospectralGauss(2)),
    (co.MatrixSystem(co.MatrixAlgebra("gl", 5), WEIGHTS), co.IsospectralGauss()),
    (co.MatrixSystem(co.MatrixAlgebra("gl", 5), WEIGHTS), co.IsospectralGauss(2)),
]


@pytest.mark.parametrize("system, method", CASES, ids=lambda one: getattr(one, "name", str(one)))
def test_products_are_those_that_are_computed(system, method, counted):
    """Of those in single precision the last ones of a few steps are not computed, after which nothing is left to do."""
    n = system.algebra.N
    x0 = np.stack([state_of(system, seed) for seed in (1, 2)])
    prepared = co.prepare(system, method, 2.0**-5, watch=False)
    prepared.run(x0, (0, 0.125))  # the first run takes half steps too, to estimate its error
    counted.update(dict.fromkeys(counted, 0))
    sol = prepared.run(x0, (0, 1), save_every=32)
    whole = {name: count / n**3 / (REAL_PRODUCTS[name] if system.complex else 1) for name, count in counted.items()}
    each = system.matrix_shape[0] if system.independent_layers else 1
    skew = system.algebra.skew
    inverses = each * sol.stats.iterations * getattr(method, "stages", 1) if skew else 0
    found = whole["zgemm"] + whole["dgemm"] + leaves(n) * inverses
    assert sol.stats.matrix_products == pytest.approx(found, rel=1e-12)
    assert whole["sgemm"] * (1 - 1e-12) <= sol.stats.lower_products <= 1.1 * whole["sgemm"]


def test_products_of_stored_and_resumed_runs(tmp_path):
    system, path = SPHERE(N=12), tmp_path / "run.zarr"
    x0 = state_of(system)
    whole = co.integrate(system, x0, (3, 2), 2.0**-5, co.IsospectralGauss())
    wanted = whole.stats.matrix_products, whole.stats.lower_products
    assert min(wanted) > 0
    co.integrate(system, x0, (3, 2.5), 2.0**-5, co.IsospectralGauss(), archive=path)
    co.resume(path, 2.0)
    whole.to_xarray().to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    for again in (co.load(path), co.load(tmp_path / "run.nc")):
        assert (again.stats.matrix_products, again.stats.lower_products) == wanted


def test_products_that_counts_do_not_determine_are_none():
    system = SPHERE(N=12)
    x0, step, method = state_of(system), 2.0**-5, co.IsospectralGauss()
    event = co.Event(lambda W: W[0, 0].imag)
    runs = [
        co.integrate(system.with_forces(co.forces.Friction(0.1)), x0, (0, 1), step, method),
        co.integrate(system, x0, (0, 1), step, method, events=event),
        co.integrate(co.systems.rigid_body((1, 2, 3)), (1.0, 0.1, 0.2), (0, 1), step),
    ]
    for run in runs:
        assert run.stats.matrix_products is None
        assert run.stats.lower_products is None
    still = co.integrate(system, 0 * x0, (0, 1), step, method).stats
    assert still.lower_products == 0.0
