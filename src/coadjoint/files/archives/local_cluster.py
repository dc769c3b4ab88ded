"""A Dask cluster on this machine, accessible only to the process that starts it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from distributed import Client, Nanny, Scheduler, SpecCluster, Worker
from distributed.security import Security

from coadjoint.private_folders import private_folder

LOOPBACK = "127.0.0.1"


class QuietScheduler(Scheduler):
    """A scheduler without an HTTP server."""

    def start_http_server(self, *given: Any, **more: Any) -> None:
        """Do not start it: it has no authentication, and runs even without a dashboard."""


class QuietWorker(Worker):
    """A worker without an HTTP server."""

    def start_http_server(self, *given: Any, **more: Any) -> None:
        """Do not start it, as in `QuietScheduler`."""


@contextmanager
def local_cluster(workers: int) -> Iterator[Client]:
    """Start single-threaded worker processes, which end with the context, and connect to them.

    Connections use TLS with temporary credentials, passed to the workers through pipes. RuntimeError: the workers did
    not start, or there is no private folder for temporary files.
    """
    security = Security.temporary()  # type: ignore[no-untyped-call]
    with private_folder() as folder:
        # Dask imports code from its temporary folder, whose default name all users share.
        protected = {"host": LOOPBACK, "protocol": "tls://", "security": security, "dashboard": False}
        protected["local_directory"] = str(folder)
        worker = {
            "cls": Nanny,
            "options": {
                **protected,
                "worker_class": QuietWorker,
                "nthreads": 1,
                "memory_limit": None,
                # The call raises failures; a worker that dies within a block is replaced.
                "silence_logs": logging.CRITICAL,
            },
        }
        try:
            cluster = SpecCluster(  # type: ignore[no-untyped-call]
                workers=dict.fromkeys(range(workers), worker),
                scheduler={"cls": QuietScheduler, "options": protected},
                security=security,
                silence_logs=logging.CRITICAL,
            )
        except RuntimeError as reason:
            raise RuntimeError(
                "the workers of ensemble(workers=) did not start; each of them imports the script, so that the call "
                'must be guarded by if __name__ == "__main__":'
            ) from reason
        with cluster, Client(cluster) as client:  # type: ignore[no-untyped-call]
            yield client
