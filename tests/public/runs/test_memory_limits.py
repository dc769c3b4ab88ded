"""Requests beyond the available memory are refused early, with an estimate."""

import re
import resource
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from interrupting import interrupt_after

import coadjoint as co
from guards import bounded_work
from refusals import refused

BODY = co.systems.rigid_body()
X = (0.1, 1.0, 0.2)


def limited(monkeypatch, free):
    """Let the limit of this process leave some memory (bytes) free."""
    taken = Path("/proc/self/statm")
    if not taken.exists():
        pytest.skip("this system does not tell how much memory is taken")

    def limits(which):
        return int(taken.read_text().split()[0]) * resource.getpagesize() + free, -1

    monkeypatch.setattr(resource, "getrlimit", limits)


@pytest.fixture
def small_memory(monkeypatch):
    """300 MB of available memory."""
    limited(monkeypatch, 300 * 10**6)


def view(*shape):
    """Return an array of any shape that takes the memory of one number."""
    return np.broadcast_to(1.0, shape)


TOO_LARGE = {
    "LieAlgebra": lambda: co.LieAlgebra([(0, 1, 1, 1.0)], dim=10**9),
    "brackets": lambda: co.LieAlgebra.from_brackets(10**9, ["[e1, e2] = e2"]),
    "dense constants": lambda: co.LieAlgebra(view(10**5, 10**5, 10**5)),
    "so": lambda: co.algebras.so(400),
    "so, by name": lambda: co.algebras.get("so(1000000000000000000000000000000)"),
    "so, beyond all floats": lambda: co.algebras.so(10**400),
    "gl": lambda: co.algebras.gl(500),
    "su": lambda: co.algebras.su(500),
    "heisenberg": lambda: co.algebras.heisenberg(10**9),
    "copies": lambda: co.algebras.copies(co.algebras.so(3), 10**9),
    "variable": lambda: co.Polynomial.variable(0, 10**9),
    "power": lambda: co.Polynomial({(1,): 2}) ** 10**9,
    "exponent": lambda: co.Polynomial({(4_000_000_000, 0): 1}),
    "dense M": lambda: co.Quadratic(view(10**6, 10**6)),
    "coadjoint matrix": lambda: co.algebras.heisenberg(10_000).coadjoint(np.zeros(20_001)),
    "Poisson system": lambda: co.PoissonSystem(lambda x: x, co.Quadratic(1.0), dim=10**6),
    "states": lambda: co.integrate(BODY, view(10**10, 3), (0, 1), 0.5),
    "group elements": lambda: co.integrate(
        co.LiePoissonSystem(co.algebras.heisenberg(5000), co.Quadratic(1.0)), np.ones(10_001), (0, 1), 0.5,
        attitude="coadjoint",
    ),
    "tables": lambda: co.integrate(
        co.LiePoissonSystem(co.algebras.so(120), co.Quadratic(1.0)), np.ones(7140), (0, 1), 0.5
    ),
    "saved points": lambda: co.integrate(BODY, X, (0, 1e11), 0.1),
    "lattice": lambda: co.systems.spin_lattice("cubic", (1000, 1000, 1000)),
    "directions": lambda: co.prepare(BODY, co.Splitting(), 0.5).jvp(X, (0, 100), {"inertia": np.ones((3, 50_000))}),
}  # fmt: skip


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", TOO_LARGE)
def test_requests_beyond_memory_are_refused_early(name, small_memory):
    with bounded_work(), pytest.raises(ValueError) as refusal:
        TOO_LARGE[name]()
    message = str(refusal.value)
    assert len(message) < 1000
    if name not in ("power", "exponent"):  # refused by degree
        assert "needs about" in message or "need about" in message
        assert "this machine has 300 MB free" in message


def test_refusal_has_the_estimate(monkeypatch):
    limited(monkeypatch, 2_100_000_000)
    with refused(ValueError, "so(400)", "79800", "needs about 4.2 GB", "2.1 GB free"):
        co.algebras.so(400)


def estimate_of(monkeypatch, make):
    """Return the memory (bytes) that a refusal says is needed."""
    with monkeypatch.context() as patched:
        limited(patched, 0)
        with refused(ValueError, "needs about") as refusal:
            make()
    number, unit = re.search(r"needs about (\S+) (MB|GB)", str(refusal.value)).groups()
    return float(number) * {"MB": 1e6, "GB": 1e9}[unit]


@pytest.mark.thinned(4)
@pytest.mark.parametrize(
    "make",
    [
        lambda: co.algebras.so(130),
        lambda: co.algebras.e(120),
        lambda: co.algebras.su(100),
        lambda: co.algebras.heisenberg(500_000),
        lambda: co.LieAlgebra([], dim=500_000),
    ],
)
def test_algebras_need_at_most_the_estimate(make, monkeypatch):
    """Some tens of MB are added for temporary parts, Casimirs and matrices."""
    estimate = estimate_of(monkeypatch, make)
    tracemalloc.start()
    try:
        kept, peak = make(), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert kept.dim and 0.2 * estimate < peak < 1.3 * estimate + 60e6


@pytest.mark.long
def test_large_algebras_are_created_in_seconds():
    with bounded_work():  # minutes if identities were checked
        so, sl = co.algebras.so(150), co.algebras.sl(100)
    assert (so.dim, sl.dim) == (11175, 9999)


@pytest.mark.parametrize(("members", "end"), [(1, 300_000), (7, 100_000), (40_000, 100)])
def test_suggested_save_every_fits(members, end, monkeypatch):
    """The suggestion is accepted, and half of it is refused."""
    limited(monkeypatch, 80 * 10**6)
    ready, x0 = co.prepare(BODY, co.Splitting(), 0.1), np.tile(X, (members, 1))
    with refused(ValueError, "saved points", "save_every=") as refusal:
        ready.run(x0, (0, end))
    every = int(str(refusal.value).split("save_every=")[1].split(" ")[0])
    with refused(ValueError, "saved points"):
        ready.run(x0, (0, end), max(1, every // 2))
    try:
        with interrupt_after(0.02):
            ready.run(x0, (0, end), every)
    except KeyboardInterrupt:
        pass


def test_too_many_members_are_refused(monkeypatch):
    limited(monkeypatch, 100 * 10**6)
    with refused(ValueError, "fewer members"):
        co.integrate(BODY, np.ones((300_000, 3)), (0, 1), 0.5, save_every=2)


def test_small_requests_are_not_checked(monkeypatch):
    limited(monkeypatch, 0)
    assert co.integrate(BODY, X, (0, 10), 0.1).x.shape == (101, 3) and co.algebras.so(20).dim == 190


def test_large_matrices(monkeypatch):
    large, W = co.systems.matrix_body(np.linspace(1.0, 2.0, 400)), np.zeros((400, 400))
    limited(monkeypatch, 10**8)
    with refused(ValueError, "101 saved points", "save_every="):
        co.integrate(large, W, (0.0, 1.0), 0.01)
    limited(monkeypatch, 10**7)
    with refused(ValueError, "structure matrix"):
        large.structure_matrix(W)
