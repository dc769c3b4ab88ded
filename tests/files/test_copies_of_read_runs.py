"""Copies of runs read from files preserve the given system, whose functions are not stored."""

import copy
import pickle

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.archives.resume import archive_run
from coadjoint.files.output.output_files import write_dataset
from coadjoint.kernels.functions import matrix_functions
from coadjoint.optional_packages import MissingPackageError
from coadjoint.runs.prepared_run import PreparedRun

SPAN, STEP, EVERY = (0.5, 2.5), 0.125, 3
SIZES = [1.0, 0.5, -0.25]
METHODS = {"matrices": co.IsospectralGauss(2), "vectors": co.GaussLegendre(2)}
pytestmark = pytest.mark.filterwarnings("ignore:the stream .* is called in Python:RuntimeWarning")


class Weighted:
    """Entries times weights, picklable."""

    def __init__(self, weights):
        self.weights = weights


class Stream(Weighted):
    def __call__(self, W):
        return self.weights * W


class Energy(Weighted):
    def __call__(self, W):
        return 0.5 * float(np.sum(self.weights * np.abs(W) ** 2))


class Driven(Energy):
    def __call__(self, x, t):
        return super().__call__(x) + t * x[0]


class Slope(Weighted):
    def __call__(self, x, t):
        slope = self.weights * x
        slope[0] += t
        return slope


def of_matrices(kind, size, seed):
    """Return a system of Python functions, and an initial state."""
    rng = np.random.default_rng(seed)
    algebra, weights = co.MatrixAlgebra(kind, size), rng.uniform(0.5, 1.5, (size, size))
    weights = weights + weights.T
    np.fill_diagonal(weights, 1.0)  # traces stay zero
    W = algebra.projected(0.5 * rng.standard_normal((size, size)) + (0.5j * np.eye(size, k=1) if kind == "su" else 0))
    return co.MatrixSystem(algebra, Stream(weights), energy=Energy(weights)), W


MATRICES = {"so(4)": ("so", 4, 1), "su(3)": ("su", 3, 2)}


def method_of(system):
    return METHODS["matrices" if isinstance(system, co.MatrixSystem) else "vectors"]


def full_run(system, x0, path):
    return co.integrate(system, x0, SPAN, STEP, method_of(system), save_every=EVERY, archive=path)


def interrupted_run(system, x0, path):
    return archive_run(PreparedRun(system, method_of(system), STEP), x0, SPAN, EVERY, path, until=7)


def members(system, x0, path):
    states = np.multiply.outer(SIZES, x0)
    return co.integrate(system, states, SPAN, STEP, method_of(system), save_every=EVERY, archive=path)


def blocks(system, x0, path):
    states = np.multiply.outer(SIZES, x0)
    return co.ensemble(
        system, states, SPAN, STEP, method_of(system), save_every=EVERY, archive=path, members_per_block=2
    )


def dataset(system, x0, path):
    write_dataset(co.integrate(system, x0, SPAN, STEP, method_of(system), save_every=EVERY).to_xarray(), path)


WRITERS = {
    "archive": full_run,
    "archive of a part": interrupted_run,
    "members": members,
    "blocks": blocks,
    "dataset": dataset,
}
COPIES = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda found: pickle.loads(pickle.dumps(found)),
    "copy of a copy": lambda found: copy.copy(pickle.loads(pickle.dumps(found))),
}


@pytest.fixture(autouse=True)
def without_compiler(monkeypatch, no_fsync):
    def missing(*_):
        raise MissingPackageError("a compiled stream", "numba")

    monkeypatch.setattr(matrix_functions, "require_packages", missing)


@pytest.mark.thinned(5)
@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("name", MATRICES)
def test_copies_preserve_given_functions(tmp_path, writer, name):
    """States between the saved ones use them; without functions these are refused."""
    system, x0 = of_matrices(*MATRICES[name])
    path = tmp_path / "run.zarr"
    WRITERS[writer](system, x0, path)
    found = co.load(path, system=system)
    between = 0.5 * (found.t[0] + found.t[-1]) + 0.03
    wanted = found.at(between).x
    for how, copied in COPIES.items():
        again = copied(co.load(path, system=system))
        assert type(again) is type(found) and again.path == path, how
        np.testing.assert_array_equal(again.system.vector_field(x0), system.vector_field(x0), err_msg=how)
        assert again.system.energy(x0) == system.energy(x0)
        np.testing.assert_array_equal(again.at(between).x, wanted, err_msg=how)
        for part in ("t", "x", "energy", "x0"):
            np.testing.assert_array_equal(getattr(again, part), getattr(found, part), err_msg=f"{how}: {part}")
        assert again.stats == found.stats and again.drift() == found.drift()
        with pytest.raises(ValueError, match="functions are not stored"):
            _ = copied(co.load(path)).system


def test_copies_of_runs_with_an_accuracy_have_their_error():
    """Whether it was computed before the copy was made or not, and for each member."""
    body, x0 = co.systems.rigid_body((1, 2, 3)), np.array([1.0, 0.2, 0.5])
    for states in (x0, np.multiply.outer(SIZES, x0)):
        sol = co.integrate(body, states, (0, 2), accuracy=1e-6)
        before = {how: copied(sol) for how, copied in COPIES.items()}
        error = sol.error_estimate()
        assert np.shape(error) == states.shape[:-1] and np.all(np.asarray(error) <= 1e-6)
        for how, copied in COPIES.items():
            for again in (before[how], copied(sol), copied(before[how])):
                np.testing.assert_array_equal(again.error_estimate(), error, err_msg=how)
                assert again.choice == sol.choice and again.drift() == sol.drift()
    given = co.integrate(body, x0, (0, 2), STEP)
    assert copy.copy(given).error_estimate() == given.error_estimate()


@pytest.mark.thinned(2)
@pytest.mark.parametrize("writer", WRITERS)
def test_copies_prefer_the_given_system(tmp_path, writer):
    """The stored system is rebuilt only if none is given."""
    stored = co.systems.heavy_top()
    x0 = np.array([0.1, 0.3, 2.0, 0.6, 0.0, 0.8])
    path = tmp_path / "run.zarr"
    WRITERS[writer](stored, x0, path)
    weights = np.arange(1.0, 7.0)
    other = co.LiePoissonSystem(stored.algebra, co.Hamiltonian(Driven(weights), Slope(weights)))
    for copied in COPIES.values():
        given, rebuilt = copied(co.load(path, system=other)), copied(co.load(path))
        np.testing.assert_array_equal(given.system.vector_field(x0, 0.7), other.vector_field(x0, 0.7))
        np.testing.assert_array_equal(rebuilt.system.vector_field(x0), stored.vector_field(x0))
