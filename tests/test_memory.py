"""Memory checks: requests beyond the available memory are refused early, with an estimate."""

import ctypes
import re
import sys
import tracemalloc
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint import memory
from coadjoint.algebra.constants import BYTES_PER_CONSTANT, BYTES_PER_DIMENSION
from coadjoint.methods.protocol.attitude import coadjoint_matrices
from guards import bounded_work

BODY = co.systems.rigid_body()
X = (0.1, 1.0, 0.2)


@pytest.fixture
def small_memory(monkeypatch):
    """A machine with 300 MB of available memory."""
    monkeypatch.setattr("coadjoint.memory.available", lambda: 300 * 10**6)


def view(*shape):
    """Return an array of any shape that takes the memory of one number."""
    return np.broadcast_to(1.0, shape)


TOO_LARGE = {
    "LieAlgebra": lambda: co.LieAlgebra([(0, 1, 1, 1.0)], dim=10**9),
    "from_brackets": lambda: co.LieAlgebra.from_brackets(10**12, {}),
    "dense constants": lambda: co.LieAlgebra(view(10**4, 10**4, 10**4)),
    "so": lambda: co.algebras.so(400),
    "so, much larger": lambda: co.algebras.so(100_000),
    "so(p, q)": lambda: co.algebras.so(200, 200),
    "so, by name": lambda: co.algebras.get("so(1000000000000000000000000000000)"),
    "so, beyond all floats": lambda: co.algebras.so(10**400),
    "e": lambda: co.algebras.e(400),
    "se": lambda: co.algebras.se(400),
    "gl": lambda: co.algebras.gl(500),
    "sl": lambda: co.algebras.sl(500),
    "sp": lambda: co.algebras.sp(500),
    "su": lambda: co.algebras.su(500),
    "u": lambda: co.algebras.u(500),
    "heisenberg": lambda: co.algebras.heisenberg(10**9),
    "copies": lambda: co.algebras.copies(co.algebras.so(3), 10**9),
    "direct_sum": lambda: co.algebras.direct_sum(*[co.algebras.copies(co.algebras.so(3), 10**5)] * 20),
    "variable": lambda: co.Polynomial.variable(0, 10**9),
    "power": lambda: co.Polynomial({(1,): 2}) ** 10**9,
    "exponent": lambda: co.Polynomial({(4_000_000_000, 0): 1}),
    "coefficient": lambda: co.Polynomial({(0,): 2**1000}) ** 1000,
    "hessian": lambda: co.Polynomial({(0,) * 20_000: 1}).hessian(np.zeros(20_000)),
    "dense M": lambda: co.Quadratic(view(10**6, 10**6)),
    "diagonal M": lambda: co.Quadratic(view(10**9)),
    "scalar M": lambda: co.Quadratic(1.0).bind(10**9),
    "M, dense again": lambda: co.Quadratic(np.ones(20_000)).hessian(np.zeros(20_000)),
    "structure matrix": lambda: co.algebras.heisenberg(10_000).structure_matrix(np.zeros(20_001)),
    "coadjoint matrix": lambda: co.algebras.heisenberg(10_000).coadjoint(np.zeros(20_001)),
    "coadjoint matrices": lambda: coadjoint_matrices(
        co.LiePoissonSystem(co.algebras.so(50), co.Quadratic(1.0))
    ),
    "Poisson system": lambda: co.PoissonSystem(lambda x: x, co.Quadratic(1.0), dim=10**6),
    "function": lambda: co.Hamiltonian(lambda x: 0.0, lambda x: x).bind(10**9),
    "states": lambda: co.integrate(BODY, view(10**10, 3), (0, 1), 0.5),
    "group elements": lambda: co.integrate(
        co.LiePoissonSystem(co.algebras.heisenberg(5000), co.Quadratic(1.0)), np.ones(10_001), (0, 1), 0.5,
        attitude="coadjoint",
    ),
    "tables": lambda: co.integrate(
        co.LiePoissonSystem(co.algebras.so(120), co.Quadratic(1.0)), np.ones(7140), (0, 1), 0.5
    ),
    "saved points": lambda: co.integrate(BODY, X, (0, 1e9), 0.1),
    "basis": lambda: co.LieAlgebra([], dim=2, basis=view(10**12)),
    "directions": lambda: co.prepare(BODY, co.Splitting(), 0.5).jvp(X, (0, 100), {"inertia": np.ones((3, 50_000))}),
    "tangent of a step": lambda: co.stepper(co.systems.spin_lattice(shape=1100), co.Splitting(), 0.1).tangent(
        np.ones(3300)
    ),
    "fit": lambda: co.fit(
        co.prepare(BODY, co.Splitting(), 0.125), X, (0, 5e4), {"x": np.zeros((400_001, 3))},
        {"x0": True, "inertia": True}, sigma={"x": 1.0},
    ),
    "matrix of a viscosity": lambda: co.prepare(
        co.systems.sphere_euler(60).with_forces(co.forces.Viscosity(0.1)), None, 0.1
    ).jvp(np.zeros((60, 60)), (0, 0.1), {"x0": np.zeros((60, 60))}),
}  # fmt: skip


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", TOO_LARGE)
def test_requests_beyond_memory_are_refused_early(name, small_memory):
    with bounded_work(), pytest.raises(ValueError) as refusal:
        TOO_LARGE[name]()
    message = str(refusal.value)
    assert len(message) < 1000
    if name not in ("power", "exponent", "coefficient"):  # refused by degree
        assert "needs about" in message or "need about" in message
        assert "this machine has 300 MB free" in message


def test_refusal_has_the_estimate():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("coadjoint.memory.available", lambda: 2_100_000_000)
        with pytest.raises(ValueError) as refusal:
            co.algebras.so(400)
    assert re.search(r"^so\(400\), .*79800, needs about 2\.9 GB; .*2\.1 GB free; ", str(refusal.value))


@pytest.mark.thinned(3)
@pytest.mark.parametrize(
    "make",
    [
        lambda: co.algebras.so(130),
        lambda: co.algebras.e(110),
        lambda: co.algebras.sl(100),
        lambda: co.algebras.su(60),
        lambda: co.algebras.gl(90),
        lambda: co.algebras.copies(co.algebras.so(3), 100_000),
        lambda: co.algebras.heisenberg(100_000),
        lambda: co.LieAlgebra([], dim=200_000),
    ],
)
def test_algebras_need_at_most_the_estimate(make):
    """Some tens of MB are added for temporary parts, Casimirs and matrices."""
    tracemalloc.start()
    try:
        g = make()
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    named = 0 if g.name == "100000 so(3)" else g.dim  # the names of copies are made when they are read
    estimate = BYTES_PER_DIMENSION * named + BYTES_PER_CONSTANT * g.triples.c.size
    assert peak < 1.3 * estimate + 400e6
    assert peak > 0.2 * estimate


@pytest.mark.long
def test_large_algebras_are_created_in_seconds():
    with bounded_work():  # minutes if identities were checked
        so, sl = co.algebras.so(150), co.algebras.sl(100)
    assert (so.dim, so.triples.c.size, sl.dim) == (11175, 150 * 149 * 148 // 2, 9999)


@pytest.mark.parametrize(("members", "end"), [(1, 1_000_000), (7, 1_000_000), (100_000, 100), (150_000, 100)])
def test_suggested_save_every_fits(members, end, small_memory):
    x0 = np.tile(X, (members, 1))
    with pytest.raises(ValueError, match="saved points") as refusal:
        co.integrate(BODY, x0, (0, end), 0.1, save_every=1)
    every = int(str(refusal.value).split("save_every=")[1].split(" ")[0])
    ready = co.prepare(BODY, co.Splitting(), 0.1)

    def check_memory(save_every):
        from coadjoint.runs.memory_estimate import check_run_memory
        from coadjoint.runs.times import times_of

        times = times_of((0, end), 0.1, save_every)
        layout = ready.loops(0.1).plan(members, times.points, 0, 1).layout
        check_run_memory(layout, times, members)

    check_memory(every)
    with pytest.raises(ValueError, match="saved points"):
        check_memory(every - 1)


def test_too_many_members_are_refused(monkeypatch):
    monkeypatch.setattr("coadjoint.memory.available", lambda: 100 * 10**6)
    with pytest.raises(ValueError, match="run fewer members at a time"):
        co.integrate(BODY, np.ones((300_000, 3)), (0, 1), 0.5, save_every=2)


def test_small_requests_are_not_checked(monkeypatch):
    def called():
        raise AssertionError

    monkeypatch.setattr("coadjoint.memory.available", called)
    co.integrate(BODY, X, (0, 10), 0.1)
    co.algebras.so(20)


def test_cgroup_limits(tmp_path):
    """A batch job has the remainder of its parent group; cached files do not count as used."""
    own, root = tmp_path / "cgroup", tmp_path / "fs"
    job = root / "slurm" / "job"
    job.mkdir(parents=True)
    own.write_text("0::/slurm/job\n")
    (root / "slurm" / "memory.max").write_text("5000\n")
    (root / "slurm" / "memory.current").write_text("3000\n")
    (root / "slurm" / "memory.stat").write_text("anon 2000\nfile 1000\n")
    (job / "memory.max").write_text("max\n")
    (job / "memory.current").write_text("3000\n")
    assert memory._available_in_cgroups(str(root), str(own)) == 3000
    own.write_text("5:cpu,memory:/job\n")
    old = root / "memory" / "job"
    old.mkdir(parents=True)
    (old / "memory.limit_in_bytes").write_text("700\n")
    (old / "memory.usage_in_bytes").write_text("300\n")
    (old / "memory.stat").write_text("total_cache 100\n")
    assert memory._available_in_cgroups(str(root), str(own)) == 500
    assert memory._available_in_cgroups(str(root), str(tmp_path / "absent")) == memory.NO_LIMIT


def test_available_memory_of_this_machine():
    assert 2**20 < memory.available() <= memory.NO_LIMIT


MEMINFO = "MemTotal:       16000000 kB\nMemFree:         1000000 kB\nMemAvailable:    3000000 kB\nSwapFree: 9 kB\n"


@pytest.fixture
def files(monkeypatch):
    """Contents of the files in which the system reports memory; others do not exist."""
    found = {}

    def read(self, **kwargs):
        if str(self) not in found:
            raise FileNotFoundError(str(self))
        return found[str(self)]

    monkeypatch.setattr(Path, "read_text", read)
    return found


def test_sources_of_available_memory(files, monkeypatch):
    """Memory without swapping, in bytes; the total if that is not reported; a limit of the shell."""
    sizes = {"SC_PHYS_PAGES": 1000, "SC_PAGE_SIZE": 4096}
    monkeypatch.setattr("os.sysconf", sizes.__getitem__)
    assert memory.available() == 4096 * 1000
    files["/proc/meminfo"] = "MemAvailable: unknown kB\n"
    assert memory.available() == 4096 * 1000
    files["/proc/meminfo"] = MEMINFO
    assert memory.available() == 1024 * 3000000
    monkeypatch.setattr("resource.getrlimit", lambda which: (2**30, 2**40))
    monkeypatch.setattr("resource.getpagesize", lambda: 4096)
    assert memory.available() == 1024 * 3000000, "the memory taken is not known"
    files["/proc/self/statm"] = "1000 90 80 70 60 50 40\n"
    assert memory.available() == 2**30 - 1000 * 4096
    files["/proc/self/statm"] = f"{2**20} 90 80 70 60 50 40\n"
    assert memory.available() == 0, "never negative"
    monkeypatch.setattr("resource.getrlimit", lambda which: (-1, -1))
    assert memory.available() == 1024 * 3000000


@pytest.mark.parametrize(("success", "free"), [(1, 3 * 2**30), (0, memory.NO_LIMIT)])
def test_available_memory_on_windows(files, monkeypatch, success, free):
    """The physical memory that is free, from a structure as Windows lays it out."""

    def report(status):
        found = status._obj
        assert ctypes.sizeof(found) == 64 and bytes(found)[:4] == (64).to_bytes(4, sys.byteorder)
        sizes = (2**34, 3 * 2**30, 2**35, 2**33, 2**47, 2**46, 0)
        ctypes.memmove(ctypes.addressof(found) + 8, (ctypes.c_uint64 * 7)(*sizes), 56)
        return success

    functions = SimpleNamespace(GlobalMemoryStatusEx=report)
    monkeypatch.setattr(ctypes, "windll", SimpleNamespace(kernel32=functions), raising=False)
    monkeypatch.setattr(sys, "platform", "win32")
    assert memory._free() == free


def test_smallest_cgroup_limit_counts(files, monkeypatch):
    """Groups of both versions at every depth, parents included; groups without a limit are ignored."""
    groups = {
        "/sys/fs/cgroup": (9000, 1000, 0),
        "/sys/fs/cgroup/user": (5000, 4000, 500),
        "/sys/fs/cgroup/user/job": (9000, 100, 0),
        "/sys/fs/cgroup/memory": (8000, 0, 0),
        "/sys/fs/cgroup/memory/own": (8000, 6000, 1000),
    }
    names = {False: ("memory.max", "memory.current", "file"), True: ("memory.limit_in_bytes", "memory.usage_in_bytes")}

    def put(group, most, used, cached):
        old = group.startswith("/sys/fs/cgroup/memory")
        files[f"{group}/{names[old][0]}"], files[f"{group}/{names[old][1]}"] = f"{most}\n", f"{used}\n"
        files[f"{group}/memory.stat"] = f"anon 1\n{'total_cache' if old else 'file'} {cached}\ncache 7\n"

    for group, numbers in groups.items():
        put(group, *numbers)
    files["/proc/meminfo"] = MEMINFO
    files["/proc/self/cgroup"] = "5:cpu,memory:/own\n4:cpuset:/none\n0::/user/job\n"
    left = {group: most - used + cached for group, (most, used, cached) in groups.items()}
    assert memory.available() == min(left.values()) == 1500
    for group in groups:
        for other, numbers in groups.items():
            put(other, *(numbers if other != group else (1200, 300, 20)))
        assert memory.available() == 920, group
    for group, numbers in groups.items():
        put(group, *numbers)
    files["/sys/fs/cgroup/user/memory.max"] = "max\n"
    assert memory.available() == 3000
    put("/sys/fs/cgroup/user/job", 1200, 300, 20)
    files["/proc/self/cgroup"] = "0::/../user/job\n"
    assert memory.available() == 920, "paths of other namespaces lie above the root"


def test_requests_up_to_the_limit_are_accepted(monkeypatch):
    """The limit itself fits; small requests are not checked."""
    monkeypatch.setattr("coadjoint.memory.available", lambda: 10**9)
    for count in (0, memory.UNCHECKED_BYTES, 10**9):
        memory.check_available_memory(count, "it")
    with pytest.raises(ValueError, match=r"^it needs about 1\.0 GB; this machine has 1\.0 GB free; take less$"):
        memory.check_available_memory(10**9 + 1, "it", "take less")
    monkeypatch.setattr("coadjoint.memory.available", lambda: 0)
    memory.check_available_memory(memory.UNCHECKED_BYTES, "it")
    with pytest.raises(ValueError, match=r"^it needs about 67 MB; this machine has 0 MB free$"):
        memory.check_available_memory(memory.UNCHECKED_BYTES + 1, "it")
