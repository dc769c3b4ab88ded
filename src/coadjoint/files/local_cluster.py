"""A Dask cluster on this machine that only the process that starts it can use."""

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
        """Start nothing: these servers know no credentials, and run even where there is no dashboard."""


class QuietWorker(Worker):
    """A worker without an HTTP server."""

    def start_http_server(self, *given: Any, **more: Any) -> None:
        """Start nothing, as in `QuietScheduler`."""


@contextmanager
def local_cluster(workers: int) -> Iterator[Client]:
    """Start worker processes of one thread each, which end with the context, and connect to them.

    All connections use TLS with credentials that are made here and given to the workers through pipes.

    Raises
    ------
    RuntimeError
        The workers have not started, or there is no safe place for temporary files.
    """
    security = Security.temporary()  # type: ignore[no-untyped-call]
    with private_folder() as folder:
        # Dask imports from the folder of its temporary files, which by default has the same name for all users.
        protected = {"host": LOOPBACK, "protocol": "tls://", "security": security, "dashboard": False}
        protected["local_directory"] = str(folder)
        worker = {
            "cls": Nanny,
            "options": {
                **protected,
                "worker_class": QuietWorker,
                "nthreads": 1,
                "memory_limit": None,
                # Failures are raised by the call; a worker that ends within a block is replaced.
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
                'must stand below if __name__ == "__main__":'
            ) from reason
        with cluster, Client(cluster) as client:  # type: ignore[no-untyped-call]
            yield client
