"""Ensembles on Dask workers: the bits of one machine, also after losses, and access control."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
import warnings
from concurrent.futures import CancelledError
from pathlib import Path
from threading import Thread, Timer
from types import SimpleNamespace
from urllib.parse import urlsplit

import killed_workers
import numpy as np
import psutil
import pytest
from distributed import Client, LocalCluster
from distributed.comm import CommClosedError

import coadjoint as co
from coadjoint.files.archives import dask_blocks as on_workers
from coadjoint.files.archives.blocks import read_head
from coadjoint.files.archives.dask_blocks import local_cluster
from coadjoint.files.archives.folder import ArchiveFolder
from coadjoint.files.archives.reading import ArchiveError
from coadjoint.files.archives.run_in_blocks import read_worker_pool
from coadjoint.files.archives.store import ArchiveUnwritten
from coadjoint.files.output.atomic_output import open_locked
from long import long_between, long_beyond

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X = np.random.default_rng(3).standard_normal((11, 3))


@pytest.fixture(scope="module")
def client():
    with local_cluster(2) as found:
        yield found


def assert_same(found, expected):
    actual = found.to_xarray().load()
    for name, values in expected.to_xarray().variables.items():
        np.testing.assert_array_equal(actual[name].values, values.values, err_msg=name)


def derive(*args, **kwargs):
    raise AssertionError("tables are derived on a worker")


def forbid():
    """Make every derivation of tables on this worker fail."""
    from coadjoint.methods.protocol.method import Method

    Method.original_loop, Method.loop = Method.loop, derive


def allow():
    from coadjoint.methods.protocol.method import Method

    Method.loop = Method.original_loop


TOP, FLUID = co.systems.heavy_top(), co.systems.sphere_euler(4)
MOVED = {
    "one system": (BODY, X, co.Splitting(), True),
    "batch": (co.batch([co.systems.rigid_body((1, 2, 2 + 0.0625 * k)) for k in range(11)]), X, co.Splitting(), True),
    "noise": (BODY.with_forces(co.forces.HeatBath(0.3, temperature=0.5, seed=4)), X, None, False),
    "stages": (TOP, np.hstack([X, X]), co.GaussLegendre(2), "coadjoint"),
    "series": (TOP, np.hstack([X, X]), co.Taylor(order=6), False),
    "series in steps of their own": (BODY, X, co.Taylor(order=8, tolerance=1e-9), False),
    "exponentials": (BODY, X, co.CommutatorFree(order=3), "coadjoint"),
    "matrices": (FLUID, np.stack([FLUID.random(seed) for seed in range(11)]), co.IsospectralGauss(2), False),
    "free body": (BODY, X, co.Splitting(order=4, parts="free_body"), False),
}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", long_between(2, MOVED))
def test_clusters_have_the_bits_of_one_machine(tmp_path, client, name):
    """No worker derives tables, except for loops around others."""
    (system, x0, method, attitude), archive = MOVED[name], tmp_path / "many.zarr"
    run = (0, 2), 0.125, method
    if name != "noise":
        client.run(forbid)
    try:
        found = co.ensemble(system, x0, *run, archive=archive, client=client, members_per_block=4, attitude=attitude)
    finally:
        if name != "noise":
            client.run(allow)
    assert_same(found, co.integrate(system, x0, *run, attitude=attitude))


@pytest.mark.long
def test_results_bypass_the_client(tmp_path, client):
    """Of 20 MB in the archive, workers send some thousand bytes, heartbeats included."""

    def sent(dask_worker):
        return dask_worker.transfer_outgoing_bytes_total

    def moved():
        return sum(client.run(sent).values())

    before = moved()
    assert client.submit(bytes, 10**6).result() and moved() - before >= 10**6
    before = moved()
    many = np.random.default_rng(1).standard_normal((256, 3))
    found = co.ensemble(BODY, many, (0, 500), 0.125, archive=tmp_path / "many.zarr", client=client)
    assert found.x.nbytes > 2e7
    assert moved() - before < 1e5


def test_client_requires_an_archive(client):
    with pytest.raises(TypeError, match="client and no archive"):
        co.ensemble(BODY, X, (0, 2), 0.125, client=client)


def test_workers_without_the_folder_are_refused(tmp_path, client, monkeypatch):
    from coadjoint.files.archives import dask_blocks as on_workers

    real = on_workers.run_block
    monkeypatch.setattr(on_workers, "run_block", lambda archive, *args: real(f"{archive}-elsewhere", *args))
    with pytest.raises(ArchiveError, match=r"there is no archive of a run on the machine .*every worker must reach"):
        co.ensemble(BODY, X, (0, 2), 0.125, archive=tmp_path / "many.zarr", client=client, members_per_block=4)


@pytest.mark.long
def test_block_of_an_earlier_call_is_awaited(tmp_path, client, monkeypatch):
    archive = tmp_path / "many.zarr"
    with pytest.raises(ArchiveUnwritten):
        with monkeypatch.context() as lost:
            lost.setattr("coadjoint.files.archives.run_in_blocks.run_block", lambda *args: {"busy": True})
            co.ensemble(BODY, X, (0, 2), 0.125, archive=archive, members_per_block=4)
    lock = open_locked(archive / ".coadjoint" / "block-000001.lock", os.O_CREAT)
    began = time.monotonic()
    Timer(1.0, os.close, [lock]).start()
    found = co.ensemble(BODY, X, (0, 2), 0.125, archive=archive, client=client)
    assert time.monotonic() - began >= 1.0
    assert_same(found, co.integrate(BODY, X, (0, 2), 0.125))


SLOW = """
import sys
import numpy as np
import coadjoint as co
import coadjoint.files.archives.block_run as block_run

X = np.random.default_rng(3).standard_normal((11, 3))
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
SPAN = (0, {span})


if __name__ == "__main__":
    co.ensemble(BODY, X, SPAN, 0.125, archive={archive!r}, save_every=2000, members_per_block=1, {how})
"""
SPAN = 250_000


def reference_run():
    return co.integrate(BODY, X, (0, SPAN), 0.125, save_every=2000)


def script(tmp_path, archive, how):
    path = tmp_path / "script.py"
    path.write_text(SLOW.format(span=SPAN, archive=str(archive), how=how))
    return [sys.executable, str(path)]


def until(condition, seconds=300.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "timeout"
        time.sleep(0.02)


def done(archive):
    """Return the numbers of the finished blocks."""
    with ArchiveFolder(archive) as folder:
        return {k for k in range(11) if (read_head(folder, k) or {}).get("archive_finished")}


def written(archive):
    """Return the time at which each block was finished."""
    return {k: (archive / ".coadjoint" / f"block-{k:06d}").stat().st_mtime_ns for k in done(archive)}


@pytest.mark.long
@pytest.mark.parametrize("count", long_beyond(1, [1, 2]))
def test_killed_workers_are_replaced(tmp_path, client, count):
    """One worker, or all that have the tables, which are then sent again."""
    archive, killed = tmp_path / "many.zarr", []

    def kill():
        until(lambda: archive.exists() and done(archive))
        for pid in list(client.run(os.getpid, nanny=False).values())[:count]:
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)

    thread = Thread(target=kill)
    thread.start()
    found = co.ensemble(BODY, X, (0, SPAN), 0.125, archive=archive, client=client, save_every=2000, members_per_block=1)
    thread.join()
    assert len(killed) == count
    assert_same(found, reference_run())


@pytest.mark.parametrize("there", [True, False])
def test_lost_result_is_computed_again(monkeypatch, there):
    class Task:
        status = "finished"

        def result(self):
            raise CancelledError("already forgotten")

    monkeypatch.setattr(on_workers, "_scheduler_responds", lambda client: there)
    if there:
        ended, reason = on_workers._task_result(None, Task())
        assert ended is None and isinstance(reason, CancelledError), "the block is computed again"
    else:
        with pytest.raises(CancelledError):
            on_workers._task_result(None, Task())


@pytest.mark.long
def test_workers_killed_in_the_middle_of_blocks(tmp_path):
    """`make soak` repeats this with more seeds."""
    kills, from_the_middle = killed_workers.killed(1, tmp_path)
    assert kills and from_the_middle


@pytest.mark.long
def test_killed_client_is_called_again(tmp_path):
    archive = tmp_path / "many.zarr"
    process = subprocess.Popen(script(tmp_path, archive, "workers=1"), stderr=subprocess.DEVNULL)
    until(lambda: archive.exists() and len(done(archive)) >= 2)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = written(archive)
    assert 2 <= len(before) < 11
    found = []

    def finished():
        """Return whether all is written: the worker may go on with its block until it misses its client."""
        try:
            found.append(co.ensemble(BODY, X, (0, SPAN), 0.125, archive=archive, save_every=2000))
        except OSError:
            return False
        return True

    until(finished)
    after = written(archive)
    assert {k: after[k] for k in before} == before, "finished blocks are not computed again"
    assert_same(found[0], reference_run())


@pytest.mark.long
def test_killed_scheduler_is_replaced(tmp_path):
    archive = tmp_path / "many.zarr"

    def start_cluster():
        file = tmp_path / "scheduler.json"
        file.unlink(missing_ok=True)
        dask = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
        worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard"]
        here = ["--scheduler-file", str(file)]
        quiet = {"stderr": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "cwd": tmp_path}
        scheduler = subprocess.Popen([*dask, *here, "--host", "127.0.0.1", "--port", "0", "--no-dashboard"], **quiet)
        until(file.exists)
        return scheduler, subprocess.Popen([*worker, *here, "--death-timeout", "5", "--no-nanny"], **quiet), file

    def run(file):
        with Client(scheduler_file=str(file), timeout=30) as client:
            client.wait_for_workers(1, timeout=60)
            return co.ensemble(
                BODY, X, (0, SPAN), 0.125, archive=archive, client=client, save_every=2000, members_per_block=1
            )

    scheduler, worker, file = start_cluster()
    try:

        def kill():
            until(lambda: archive.exists() and len(done(archive)) >= 2)
            scheduler.send_signal(signal.SIGKILL)

        Thread(target=kill).start()
        with pytest.raises(ArchiveUnwritten, match="next call"):
            run(file)
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()
    before = written(archive)
    assert len(before) >= 2
    scheduler, worker, file = start_cluster()
    try:
        found = run(file)
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()
    after = written(archive)
    assert {k: after[k] for k in before} == before
    assert_same(found, reference_run())


@pytest.mark.long
def test_script_without_main_guard_is_refused(tmp_path):
    path = Path(script(tmp_path, tmp_path / "many.zarr", "workers=1")[1])
    path.write_text(path.read_text().replace('if __name__ == "__main__":', "if True:"))
    found = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, timeout=120)
    assert found.returncode != 0 and 'if __name__ == "__main__":' in found.stderr


SWEEP = """
[system]
name = "rigid_body"
parameters = { inertia = [1.0, 2.0, 2.5] }
[initial]
x = [1.0, 0.1, 0.5]
[sweep.over]
"system.parameters.inertia[2]" = { linear = [2.25, 3.0], count = 4 }
"initial.x[1]" = [0.25, -0.5]
[run]
t_span = [0.0, 1.0]
step = 0.125
workers = 2
[output]
archive = "many.zarr"
"""


@pytest.mark.long
def test_command_runs_a_sweep_on_workers(tmp_path, monkeypatch, capsys):
    from coadjoint import cli
    from coadjoint.files.configuration.loading import load

    monkeypatch.chdir(tmp_path)
    Path("run.toml").write_text(SWEEP)
    assert cli.main(["run", "run.toml"]) == 0
    assert "written: many.zarr" in capsys.readouterr().out
    found = co.open_archive("many.zarr")
    Path("alone.toml").write_text(SWEEP.replace("workers = 2", ""))
    alone = load("alone.toml")
    assert_same(found, alone.integrate())
    stored = found.to_xarray()
    np.testing.assert_array_equal(stored["swept_inertia_2"], alone.swept["system.parameters.inertia[2]"])
    assert "swept_x_1" in stored.coords and stored.attrs["configuration"] == SWEEP
    (tmp_path / "many.zarr" / "x" / "c.0.1.0").unlink()
    assert cli.main(["resume", "many.zarr", "--workers", "1", "--quiet"]) == 0
    assert_same(co.open_archive("many.zarr"), alone.integrate())


def processes():
    return [psutil.Process(), *psutil.Process().children(recursive=True)]


def listening():
    """Return address and port of each listening socket of this process and its children."""
    found = []
    for process in processes():
        with contextlib.suppress(psutil.NoSuchProcess, FileNotFoundError):  # it ends at this moment
            found += process.net_connections("inet")
    return {(socket.laddr.ip, socket.laddr.port) for socket in found if socket.status == psutil.CONN_LISTEN}


def reached(ports, seconds):
    """Return what another user reaches through these ports."""
    attack = [sys.executable, str(Path(__file__).with_name("unauthorized_client.py")), *map(str, (seconds, *ports))]
    done = subprocess.run(attack, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.long
def test_unauthorized_access_without_credentials():
    plain = {"n_workers": 1, "processes": False, "protocol": "tcp://", "dashboard_address": None}
    with LocalCluster(**plain, silence_logs=50) as cluster:
        (found,) = reached([urlsplit(cluster.scheduler_address).port], 30).values()
    assert found == {"client": os.getpid(), "message": "Scheduler", "bytes": 8}


def test_no_unauthorized_access_to_workers(tmp_path, monkeypatch):
    """Ports of the scheduler, a worker and its nanny, before and after a worker is killed."""
    on_client, tried = on_workers.on_client, []

    def attacked(client, *args):
        key = next(line for line in client.security.tls_client_key.splitlines()[1:] if line)
        for kill in (True, False):
            # A restarted worker listens some time after its process has begun.
            until(lambda: len(listening() - before) == 3)
            ports = listening() - before
            assert len(ports) == 3 and {host for host, _ in ports} == {"127.0.0.1"}
            assert not any(reached([port for _, port in ports], 2).values())
            for process in processes():
                assert key not in " ".join([*process.cmdline(), *process.environ().values()])
            folder = Path(client.run_on_scheduler(lambda dask_scheduler: dask_scheduler.local_directory)).parents[1]
            assert folder.stat().st_mode & 0o777 == 0o700
            assert not any(key in file.read_text() for file in folder.rglob("*") if file.is_file())
            for paths in client.run(lambda: sys.path).values():
                scratch = {path.partition("/dask-scratch-space")[0] for path in paths if "scratch" in path}
                assert str(folder) in scratch, "code is found there"
                assert all(Path(path).stat().st_mode & 0o777 == 0o700 for path in scratch)
            tried.append(ports)
            if kill:
                (pid,) = client.run(os.getpid, nanny=False).values()
                os.kill(pid, signal.SIGKILL)
                until(lambda killed=pid: killed not in client.run(os.getpid, on_error="ignore").values())
                client.wait_for_workers(1, timeout=60)
        on_client(client, *args)

    monkeypatch.setattr(on_workers, "on_client", attacked)
    before = listening()
    found = co.ensemble(BODY, X, (0, 2), 0.125, archive=tmp_path / "many.zarr", workers=1)
    assert len(tried) == 2 and tried[0] != tried[1]
    assert_same(found, co.integrate(BODY, X, (0, 2), 0.125))


@pytest.mark.parametrize(
    ("address", "warned"),
    [
        ("tcp://192.0.2.7:8786", True),
        ("tcp://[2001:db8::7]:8786", True),
        ("ucx://192.0.2.7:8786", True),
        ("tcp://somewhere:8786", True),
        ("tcp://localhost.somewhere:8786", True),
        ("tcp://127.0.0.1.somewhere:8786", True),
        ("tls://192.0.2.7:8786", False),
        ("tcp://127.0.0.1:8786", False),
        ("tcp://127.1.2.3:8786", False),
        ("tcp://[::1]:8786", False),
        ("tcp://localhost:8786", False),
        ("inproc://192.0.2.7/1/1", False),
    ],
)
def test_unencrypted_remote_client_warns(address, warned):
    client = object.__new__(Client)
    client.scheduler, client.status = SimpleNamespace(address=address), "closed"
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("default")
        for _ in range(3):
            assert read_worker_pool(client, None, None).client is client
    assert [warning.category for warning in found] == [RuntimeWarning] * warned
    assert all(address in str(warning.message) for warning in found)


def test_tables_are_sent_again_to_lost_workers(tmp_path, client, monkeypatch):
    """The tables are sent again; a lost scheduler is reported."""
    archive, scatter, tries = tmp_path / "many.zarr", client.scatter, []

    def failing(*args, **kwargs):
        tries.append(args)
        if len(tries) < on_workers.RETRIES:
            raise CommClosedError("a worker has ended")
        return scatter(*args, **kwargs)

    monkeypatch.setattr(client, "scatter", failing)
    monkeypatch.setattr(on_workers, "_scheduler_responds", lambda client: len(tries) != 1)
    with pytest.raises(ArchiveUnwritten, match="the scheduler of the cluster is lost"):
        co.ensemble(BODY, X, (0, 2), 0.125, archive=archive, client=client)
    found = co.ensemble(BODY, X, (0, 2), 0.125, archive=archive, client=client)
    assert_same(found, co.integrate(BODY, X, (0, 2), 0.125))
    assert len(tries) == on_workers.RETRIES
