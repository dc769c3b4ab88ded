"""Ensembles on Dask workers: the bits of one machine, also where workers, clients and schedulers are lost."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from threading import Thread

import dask
import killed_workers
import numpy as np
import pytest
from distributed import Client, LocalCluster

import coadjoint as co
from long import long_between, long_beyond
from refusals import refused
from same_runs import check_same

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X = np.random.default_rng(3).standard_normal((11, 3))


@pytest.fixture(scope="module")
def client():
    plain = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": ":0", "silence_logs": 50}
    with LocalCluster(**plain) as cluster, Client(cluster) as found:
        yield found


TOP, FLUID = co.systems.heavy_top(), co.systems.sphere_euler(4)
MOVED = {
    "batch": (co.batch([co.systems.rigid_body((1, 2, 2 + 0.0625 * k)) for k in range(11)]), X, co.Splitting(), True),
    "one system": (BODY, X, co.Splitting(), True),
    "noise": (BODY.with_forces(co.forces.HeatBath(0.3, temperature=0.5, seed=4)), X, None, False),
    "stages": (TOP, np.hstack([X, X]), co.GaussLegendre(2), "coadjoint"),
    "series": (TOP, np.hstack([X, X]), co.Taylor(order=6), False),
    "series in steps of their own": (BODY, X, co.Taylor(order=8, tolerance=1e-9), False),
    "exponentials": (BODY, X, co.CommutatorFree(order=3), "coadjoint"),
    "matrices": (FLUID, np.stack([FLUID.random(seed) for seed in range(11)]), co.IsospectralGauss(2), False),
    "free body": (BODY, X, co.Splitting(order=4, parts="free_body"), False),
}


@pytest.mark.parametrize("name", long_between(4, MOVED))
def test_clusters_have_the_bits_of_one_machine(tmp_path, client, name):
    (system, x0, method, attitude), given = MOVED[name], {"archive": tmp_path / "many.zarr", "client": client}
    found = co.integrate_ensemble(
        system, x0, (2, 0) if name == "stages" else (0, 2), 0.125, method, members_per_block=4, attitude=attitude,
        **given,
    )  # fmt: skip
    check_same(found, co.integrate(system, x0, found.t_span, 0.125, method, attitude=attitude))


def test_client_requires_an_archive(client):
    with refused(TypeError, "client", "archive"):
        co.integrate_ensemble(BODY, X, (0, 2), 0.125, client=client)


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
    found = co.integrate_ensemble(BODY, many, (0, 500), 0.125, archive=tmp_path / "many.zarr", client=client)
    assert found.x.nbytes > 2e7
    assert moved() - before < 1e5


SPAN = 250_000
LONG = (BODY, X, (0, SPAN), 0.125)
SLOW = """
import numpy as np
import coadjoint as co

X = np.random.default_rng(3).standard_normal((11, 3))
BODY = co.systems.rigid_body(inertia=(1, 2, 3))

if __name__ == "__main__":
    co.integrate_ensemble(
        BODY, X, (0, {span}), 0.125, archive={archive!r}, save_every=2000, members_per_block=1, workers=1
    )
"""


def script(tmp_path, archive):
    path = tmp_path / "script.py"
    path.write_text(SLOW.format(span=SPAN, archive=str(archive)))
    return [sys.executable, str(path)]


def until(condition, seconds=300.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "timeout"
        time.sleep(0.02)


def written(archive):
    """Return the time at which each finished block was."""
    found = {}
    for path in (archive / ".coadjoint").glob("block-??????"):
        head = json.loads(path.read_bytes().split(b"\n")[0].partition(b" ")[2])
        if head["about"]["archive_finished"]:
            found[int(path.name[-6:])] = path.stat().st_mtime_ns
    return found


@pytest.mark.long
@pytest.mark.parametrize("count", long_beyond(1, [1, 2]))
def test_killed_workers_are_replaced(tmp_path, client, count):
    """One worker, or all that have the tables, which are then sent again."""
    archive, killed = tmp_path / "many.zarr", []

    def kill():
        until(lambda: written(archive))
        for pid in list(client.run(os.getpid, nanny=False).values())[:count]:
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)

    thread = Thread(target=kill)
    thread.start()
    found = co.integrate_ensemble(*LONG, archive=archive, client=client, save_every=2000, members_per_block=1)
    thread.join()
    assert len(killed) == count
    check_same(found, co.integrate(*LONG, save_every=2000))


@pytest.mark.long
def test_workers_killed_in_the_middle_of_blocks(tmp_path):
    """`make soak` repeats this with more seeds."""
    assert killed_workers.killed(1, tmp_path)


@pytest.mark.long
def test_killed_client_is_called_again(tmp_path):
    archive = tmp_path / "many.zarr"
    process = subprocess.Popen(script(tmp_path, archive), stderr=subprocess.DEVNULL)
    until(lambda: len(written(archive)) >= 2)
    process.send_signal(signal.SIGKILL)
    process.wait()
    before, found = written(archive), []
    assert 2 <= len(before) < 11

    def finished():
        """Return whether all is written: the worker may go on with its block until it misses its client."""
        try:
            found.append(co.integrate_ensemble(*LONG, archive=archive, save_every=2000))
        except OSError:
            return False
        return True

    until(finished)
    after = written(archive)
    assert {k: after[k] for k in before} == before, "finished blocks are not computed again"
    check_same(found[0], co.integrate(*LONG, save_every=2000))


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

    def run(meanwhile=None):
        scheduler, worker, file = start_cluster()
        try:
            if meanwhile:
                Thread(target=meanwhile, args=(scheduler,)).start()
            with Client(scheduler_file=str(file), timeout=30) as client:
                client.wait_for_workers(1, timeout=60)
                return co.integrate_ensemble(
                    *LONG, archive=archive, client=client, save_every=2000, members_per_block=1
                )
        finally:
            for process in (scheduler, worker):
                process.kill()
                process.wait()

    def kill(scheduler):
        until(lambda: len(written(archive)) >= 2)
        scheduler.send_signal(signal.SIGKILL)

    with refused(OSError, "next call"):
        run(kill)
    before = written(archive)
    assert len(before) >= 2
    found, after = run(), written(archive)
    assert {k: after[k] for k in before} == before
    check_same(found, co.integrate(*LONG, save_every=2000))


@pytest.mark.long
def test_blocks_of_a_stopped_worker_go_to_another(tmp_path, monkeypatch):
    """Dask finds that it is silent; if it wakes up when the ensemble is finished, it changes nothing."""
    archive, stopped = tmp_path / "many.zarr", []
    monkeypatch.setenv("COADJOINT_TIMEOUT", "5")
    monkeypatch.setitem(dask.config.config["distributed"]["scheduler"], "worker-ttl", "5s")
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50) as cluster:
        with Client(cluster) as client:

            def stop():
                until(lambda: written(archive))
                stopped.append(next(iter(client.run(os.getpid, nanny=False).values())))
                os.kill(stopped[0], signal.SIGSTOP)

            thread = Thread(target=stop)
            thread.start()
            found = co.integrate_ensemble(*LONG, archive=archive, client=client, save_every=2000, members_per_block=1)
            thread.join()
            with suppress(ProcessLookupError):
                os.kill(stopped[0], signal.SIGCONT)
            client.run(os.getpid)
    check_same(found, co.integrate(*LONG, save_every=2000))
    check_same(co.open_archive(archive), found)


@pytest.mark.long
def test_script_without_main_guard_is_refused(tmp_path):
    path = Path(script(tmp_path, tmp_path / "many.zarr")[1])
    path.write_text(path.read_text().replace('if __name__ == "__main__":', "if True:"))
    found = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, timeout=120)
    assert found.returncode != 0 and 'if __name__ == "__main__":' in found.stderr
