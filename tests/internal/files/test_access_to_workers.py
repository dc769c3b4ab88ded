"""Other users of a machine reach neither the scheduler nor the workers of a run on its processes."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import psutil
import pytest
from distributed import LocalCluster

import coadjoint as co
from coadjoint.files.archives import dask_blocks as on_workers

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X = np.random.default_rng(3).standard_normal((11, 3))


def until(condition, seconds=300.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "timeout"
        time.sleep(0.02)


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
    # Workers in threads of this process, of other tests, leave their folders in its path.
    on_client, tried, own = on_workers.on_client, [], set(sys.path)

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
                scratch = {path.partition("/dask-scratch-space")[0] for path in set(paths) - own if "scratch" in path}
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
    found = co.integrate_ensemble(BODY, X, (0, 2), 0.125, archive=tmp_path / "many.zarr", workers=1)
    assert len(tried) == 2 and tried[0] != tried[1]
    np.testing.assert_array_equal(found.x, co.integrate(BODY, X, (0, 2), 0.125).x)
