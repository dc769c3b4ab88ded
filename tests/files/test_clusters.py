"""Ensembles on workers of Dask: the bits of one machine, whatever is lost on the way."""

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
from coadjoint.files.archives.folder import ArchiveFolder
from coadjoint.files.archives.local_cluster import local_cluster
from coadjoint.files.archives.run_in_blocks import read_worker_pool
from coadjoint.files.archives.store import ArchiveError, ArchiveUnwritten
from coadjoint.files.output.atomic_output import open_locked
from long import long_between, long_beyond

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X = np.random.default_rng(3).standard_normal((11, 3))


@pytest.fixture(scope="module")
def client():
    with local_cluster(2) as found:
        yield found


def assert_same(found, expected):
    mine, theirs = found.to_xarray().load(), expected.to_xarray()
    for name in theirs.variables:
        np.testing.assert_array_equal(mine[name].values, theirs[name].values, err_msg=name)


def derive(*given, **more):
    raise AssertionError("tables are derived on a worker")


def forbid():
    """Let every derivation of tables on this worker fail."""
    from coadjoint.methods.protocol.method import Method

    Method.kept_loop, Method.loop = Method.loop, derive


def allow():
    from coadjoint.methods.protocol.method import Method

    Method.loop = Method.kept_loop


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
def test_the_bits_of_one_machine(tmp_path, client, name):
    """By tables that no worker derives, but for the loops around others, which are laid out where they run."""
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


def test_results_never_move_through_the_client(tmp_path, client):
    """Of 20 MB in the archive workers send some thousand bytes, those of their states of health included."""

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


def test_a_client_needs_an_archive(client):
    with pytest.raises(TypeError, match="was given a client and no archive"):
        co.ensemble(BODY, X, (0, 2), 0.125, client=client)


def test_a_folder_that_workers_do_not_see(tmp_path, client, monkeypatch):
    from coadjoint.files.archives import dask_blocks as on_workers

    real = on_workers.run_block
    monkeypatch.setattr(on_workers, "run_block", lambda archive, *given: real(f"{archive}-elsewhere", *given))
    with pytest.raises(ArchiveError, match=r"there is no archive of a run on the machine .*every worker must see"):
        co.ensemble(BODY, X, (0, 2), 0.125, archive=tmp_path / "many.zarr", client=client, members_per_block=4)


@pytest.mark.long
def test_a_block_that_an_earlier_call_still_runs_is_waited_for(tmp_path, client, monkeypatch):
    archive = tmp_path / "many.zarr"
    with pytest.raises(ArchiveUnwritten):
        with monkeypatch.context() as lost:
            lost.setattr("coadjoint.files.archives.run_in_blocks.run_block", lambda *given: {"busy": True})
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


def whole():
    return co.integrate(BODY, X, (0, SPAN), 0.125, save_every=2000)


def script(tmp_path, archive, how):
    path = tmp_path / "script.py"
    path.write_text(SLOW.format(span=SPAN, archive=str(archive), how=how))
    return [sys.executable, str(path)]


def until(condition, seconds=300.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing happens"
        time.sleep(0.02)


def done(archive):
    """Return the numbers of the blocks that are done."""
    with ArchiveFolder(archive) as folder:
        return {k for k in range(11) if (read_head(folder, k) or {}).get("archive_finished")}


def written(archive):
    """Return what tells when each block was done."""
    return {k: (archive / ".coadjoint" / f"block-{k:06d}").stat().st_mtime_ns for k in done(archive)}


@pytest.mark.long
@pytest.mark.parametrize("count", long_beyond(1, [1, 2]))
def test_workers_are_killed(tmp_path, client, count):
    """One of them, or all that have the tables: these are sent once more."""
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
    assert_same(found, whole())


@pytest.mark.parametrize("there", [True, False])
def test_a_worker_is_lost_before_its_result_is_asked_for(monkeypatch, there):
    class Task:
        status = "finished"

        def result(self):
            raise CancelledError("already forgotten")

    monkeypatch.setattr(on_workers, "_scheduler_responds", lambda client: there)
    if there:
        ended, reason = on_workers._task_result(None, Task())
        assert ended is None and isinstance(reason, CancelledError), "the block is to be computed again"
    else:
        with pytest.raises(CancelledError):
            on_workers._task_result(None, Task())


@pytest.mark.long
def test_workers_are_killed_in_the_middle_of_their_blocks(tmp_path):
    """`make soak` does the same many times more."""
    kills, from_the_middle = killed_workers.killed(1, tmp_path)
    assert kills and from_the_middle


@pytest.mark.long
def test_the_client_is_killed_and_called_again(tmp_path):
    archive = tmp_path / "many.zarr"
    process = subprocess.Popen(script(tmp_path, archive, "workers=1"), stderr=subprocess.DEVNULL)
    until(lambda: archive.exists() and len(done(archive)) >= 2)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before = written(archive)
    assert 2 <= len(before) < 11
    found = co.ensemble(BODY, X, (0, SPAN), 0.125, archive=archive, save_every=2000)
    after = written(archive)
    assert {k: after[k] for k in before} == before, "what was done is not computed again"
    assert_same(found, whole())


@pytest.mark.long
def test_the_scheduler_is_killed_and_another_one_started(tmp_path):
    archive = tmp_path / "many.zarr"

    def begun():
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

    scheduler, worker, file = begun()
    try:

        def kill():
            until(lambda: archive.exists() and len(done(archive)) >= 2)
            scheduler.send_signal(signal.SIGKILL)

        Thread(target=kill).start()
        with pytest.raises(ArchiveUnwritten, match="the next call with this archive continues"):
            run(file)
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()
    before = written(archive)
    assert len(before) >= 2
    scheduler, worker, file = begun()
    try:
        found = run(file)
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()
    after = written(archive)
    assert {k: after[k] for k in before} == before
    assert_same(found, whole())


@pytest.mark.long
def test_a_script_without_a_guard_is_told(tmp_path):
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
def test_a_sweep_by_the_command(tmp_path, monkeypatch, capsys):
    from coadjoint import cli
    from coadjoint.files.configuration.configuration import load

    monkeypatch.chdir(tmp_path)
    Path("run.toml").write_text(SWEEP)
    assert cli.main(["run", "run.toml"]) == 0
    assert "written: many.zarr" in capsys.readouterr().out
    found = co.open_archive("many.zarr")
    Path("alone.toml").write_text(SWEEP.replace("workers = 2", ""))
    alone = load("alone.toml")
    assert_same(found, alone.integrate())
    kept = found.to_xarray()
    np.testing.assert_array_equal(kept["swept_inertia_2"], alone.swept["system.parameters.inertia[2]"])
    assert "swept_x_1" in kept.coords and kept.attrs["configuration"] == SWEEP
    (tmp_path / "many.zarr" / "x" / "c.0.1.0").unlink()
    assert cli.main(["resume", "many.zarr", "--workers", "1", "--quiet"]) == 0
    assert_same(co.open_archive("many.zarr"), alone.integrate())


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("[sweep.over]", "[sweep]"), "run.toml: sweep"),
        (("workers = 2", "workers = 0"), "run.toml: run.workers: must be 1 or more, not 0"),
        (
            ("workers = 2", "workers = 2\nt_eval = [0.5]"),
            "run.toml: run.t_eval: an archive keeps every save_every-th step",
        ),
    ],
)
def test_wrong_workers_of_a_file(tmp_path, monkeypatch, capsys, change, said):
    from coadjoint import cli

    monkeypatch.chdir(tmp_path)
    Path("run.toml").write_text(SWEEP.replace(*change))
    assert cli.main(["run", "run.toml"]) == 2
    assert capsys.readouterr().err.startswith(said)


def test_workers_need_an_ensemble(tmp_path, monkeypatch, capsys):
    from coadjoint import cli

    monkeypatch.chdir(tmp_path)
    text = SWEEP.replace("[sweep.over]", "").replace('"initial.x[1]" = [0.25, -0.5]', "")
    Path("run.toml").write_text("\n".join(line for line in text.splitlines() if "linear" not in line))
    assert cli.main(["run", "run.toml"]) == 2
    assert (
        "run.workers: workers are for the members of an ensemble, and the file has one state" in capsys.readouterr().err
    )


def processes():
    return [psutil.Process(), *psutil.Process().children(recursive=True)]


def listening():
    """Return the address and the port of each socket on which this process and its children listen."""
    found = [connection for process in processes() for connection in process.net_connections("inet")]
    return {(socket.laddr.ip, socket.laddr.port) for socket in found if socket.status == psutil.CONN_LISTEN}


def reached(ports, seconds):
    """Return what another user reaches by these ports."""
    attack = [sys.executable, str(Path(__file__).with_name("stranger.py")), *map(str, (seconds, *ports))]
    done = subprocess.run(attack, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.long
def test_a_stranger_reaches_a_cluster_without_credentials():
    """Otherwise the next test would show nothing."""
    plain = {"n_workers": 1, "processes": False, "protocol": "tcp://", "dashboard_address": None}
    with LocalCluster(**plain, silence_logs=50) as cluster:
        (found,) = reached([urlsplit(cluster.scheduler_address).port], 30).values()
    assert found == {"client": os.getpid(), "message": "Scheduler", "bytes": 8}


def test_a_stranger_reaches_nothing_while_workers_run(tmp_path, monkeypatch):
    """On no port of the scheduler, of a worker, or of its nanny, before and after a worker is killed."""
    on_client, tried = on_workers.on_client, []

    def attacked(client, *given):
        key = next(line for line in client.security.tls_client_key.splitlines()[1:] if line)
        for kill in (True, False):
            # A worker that is started again listens some time after its process has begun.
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
        on_client(client, *given)

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
def test_a_client_without_credentials_on_another_machine(address, warned):
    client = object.__new__(Client)
    client.scheduler, client.status = SimpleNamespace(address=address), "closed"
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("default")
        for _ in range(3):
            assert read_worker_pool(client, None, None).client is client
    assert [warning.category for warning in found] == [RuntimeWarning] * warned
    assert all(address in str(warning.message) for warning in found)


def test_workers_that_end_while_they_receive_tables(tmp_path, client, monkeypatch):
    """The tables are sent again; a scheduler that is gone is reported."""
    archive, scatter, tries = tmp_path / "many.zarr", client.scatter, []

    def failing(*given, **more):
        tries.append(given)
        if len(tries) < on_workers.RETRIES:
            raise CommClosedError("a worker has ended")
        return scatter(*given, **more)

    monkeypatch.setattr(client, "scatter", failing)
    monkeypatch.setattr(on_workers, "_scheduler_responds", lambda client: len(tries) != 1)
    with pytest.raises(ArchiveUnwritten, match="the scheduler of the cluster is lost"):
        co.ensemble(BODY, X, (0, 2), 0.125, archive=archive, client=client)
    found = co.ensemble(BODY, X, (0, 2), 0.125, archive=archive, client=client)
    assert_same(found, co.integrate(BODY, X, (0, 2), 0.125))
    assert len(tries) == on_workers.RETRIES
