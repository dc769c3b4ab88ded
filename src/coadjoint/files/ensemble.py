"""`ensemble`: many members on many machines, each block of them written into its own region of one archive."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.errors import IntegrationError
from coadjoint.extras import need
from coadjoint.files.archive_store import ArchiveStore, ArchiveUnwritten, path_of
from coadjoint.files.archived_ensemble import ArchivedEnsemble
from coadjoint.files.block_run import BUSY, run_block
from coadjoint.files.ensemble_archive import Ensemble, begun, check_same, finish, left_of
from coadjoint.files.given_functions import asked_again
from coadjoint.given import read_whole
from coadjoint.methods.base import Method
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.run import progress_bar, read_progress
from coadjoint.systems.batch import Batch
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.kinds import System
from coadjoint.wording import short

if TYPE_CHECKING:
    from distributed import Client

    from coadjoint.files.blocks import Block


def ensemble(
    system: System | ForcedSystem | Batch,
    x0: Any,
    t_span: tuple[float, float],
    step: float,
    method: Method | None = None,
    *,
    save_every: int = 1,
    attitude: Any = False,
    watch: bool = True,
    observe: Mapping[str, Any] | None = None,
    archive: str | Path | None = None,
    client: Client | None = None,
    workers: int | None = None,
    members_per_block: int | None = None,
    threads: int | None = None,
    progress: bool = False,
    coordinates: Mapping[str, Any] | None = None,
) -> ArchivedEnsemble:
    """Integrate many members in blocks, on the workers of a cluster or here, into one archive.

    Choose it for ensembles that take hours, or more memory than there is: `integrate` holds all members at once and
    leaves nothing behind where it is killed. Each block of members is a task of its own, which writes its own files of
    the archive; results never move through the client. A second call with the same archive computes what is missing,
    whether workers, the scheduler or the client were lost. Each member has the bits that it has alone.

    Parameters
    ----------
    system, x0, t_span, step, method, save_every, attitude, watch, observe
        As for `integrate`; x0 is (members, n), or of a `batch` also (n,).
    archive : str or Path, optional
        The folder of the archive, new or one of the same ensemble; all workers must see it by the same name. With a
        client it must be given. Otherwise a temporary one lives as long as the solution.
    client : distributed.Client, optional
        Of the cluster that works.
    workers : int, optional
        So many processes of this machine, in place of a client. A script that asks for them must do so below
        ``if __name__ == "__main__":``, since each of them imports it. Neither: this process works.
    members_per_block : int, optional
        How many members are a task. By default there are four blocks for each worker, or more where members have many
        numbers. That of an archive that is there stays.
    threads : int, optional
        For the members of a block: one on workers by default, and otherwise all cores.
    progress : bool
        Show a progress bar, over members.
    coordinates : mapping, optional
        Name -> numbers, one for each member, such as parameters that differ: coordinates of the dataset.

    Returns
    -------
    ArchivedEnsemble
        The `Solution` that `open_archive` returns: arrays are read when they are asked for. `status` says which members
        are done.

    Raises
    ------
    ValueError, TypeError
        For wrong input, before the first step.
    ArchiveError
        The archive is of another ensemble, somebody else is writing to it, or it cannot be made.
    ArchiveUnwritten
        It could not be written while members ran, or the cluster is lost. What was done is kept: call again.
    IntegrationError
        Members fail. The others are computed to their ends first; ``.partial`` is the ensemble.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> states = np.random.default_rng(1).standard_normal((100, 3))
    >>> many = co.ensemble(body, states, (0, 10), 0.1, members_per_block=32)
    >>> many.x.shape, many.finished
    ((101, 100, 3), True)
    >>> bool((many.x[:, 7] == co.integrate(body, states[7], (0, 10), 0.1).x).all())
    True
    """
    need("an ensemble in an archive", "xarray", "zarr")
    progress = read_progress(progress)
    crew = _crew_of(client, workers)
    if archive is None and client is not None:
        raise TypeError(
            "ensemble was given a client and no archive; give archive=, a folder that all workers see: results never "
            "move through the client"
        )
    size = None if members_per_block is None else read_whole(members_per_block, "members_per_block", floats=True)
    own = None if threads is None else read_whole(threads, "threads", floats=True)
    ready = PreparedRun(system, method, step, attitude=attitude, watch=watch, observe=observe, threads=own)
    times, start = ready.times_of(t_span, save_every)[0], ready.start(x0)
    if start.single:
        raise ValueError(f"x0 has the shape {np.shape(x0)}; an ensemble needs (members, ...), and integrate takes one")
    whole = Ensemble(ready, times, start)
    beside = _along_members({} if coordinates is None else coordinates, len(start.momenta))
    folder = tempfile.mkdtemp(prefix="coadjoint-") if archive is None else None
    try:
        return _run(whole, folder, archive, size, crew, beside, client, workers, own, progress)
    except BaseException as stopped:
        if folder is not None and getattr(stopped, "partial", None) is None:
            shutil.rmtree(folder, ignore_errors=True)
        raise


def _run(
    whole: Ensemble,
    folder: str | None,
    archive: Any,
    size: int | None,
    crew: int,
    beside: Any,
    client: Any,
    workers: int | None,
    threads: int | None,
    progress: bool,
) -> ArchivedEnsemble:
    """Begin the archive or go on with it, and run what is left of it."""
    ready, path = whole.ready, Path(folder, "ensemble.zarr") if folder is not None else path_of(archive).absolute()
    if path.exists():
        store = ArchiveStore.opened(path)
        try:
            check_same(whole, store)
        except BaseException:
            store.close()
            raise
    else:
        store = begun(whole, path, size, crew, beside)
    try:
        left = left_of(store)
        if client is None and workers is None:
            _here(store, left, ready, progress)
        else:
            from coadjoint.files.on_workers import on_client, on_processes

            if client is not None:
                on_client(client, store, left, ready, threads, progress)
            else:
                on_processes(crew, store, left, ready, threads, progress)
        said = finish(store)
    finally:
        store.close()
    found = ArchivedEnsemble(path, ready.system)
    if folder is not None:
        weakref.finalize(found, shutil.rmtree, folder, ignore_errors=True)
    if said.get("run_failed"):
        raise IntegrationError(
            said["failed_reason"],
            step=int(said["failed_step"]),
            time=float(said["failed_time"]),
            residual=float(said["failed_residual"]),
            partial=found,
        )
    return found


def resume_ensemble(
    found: ArchivedEnsemble, system: Any, observe: Mapping[str, Any] | None, threads: int | None, progress: bool
) -> ArchivedEnsemble:
    """Compute in this process what is missing of an ensemble, as `coadjoint.resume` does."""
    given = asked_again(found.path, found, system, observe, None)
    inputs = found.inputs()
    return ensemble(
        **{
            name: inputs[name]
            for name in ("system", "x0", "t_span", "step", "method", "save_every", "attitude", "watch")
        },
        observe=given.observe,
        archive=found.path,
        threads=threads,
        progress=progress,
    )


def _crew_of(client: Any, workers: Any) -> int:
    """Return how many work."""
    if client is not None and workers is not None:
        raise TypeError("ensemble was given a client and workers; give one of them: workers are of this machine")
    if client is not None:
        need("ensemble(client=)", "distributed")
        from distributed import Client

        if not isinstance(client, Client):
            raise TypeError(f"client is {short(client)}; it must be a distributed.Client")
        return max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
    if workers is None:
        return 1
    need("ensemble(workers=)", "distributed")
    return read_whole(workers, "workers", floats=True)


def _along_members(given: Mapping[str, Any], members: int) -> dict[str, Any]:
    """Return coordinates as an archive has them."""
    found = {}
    for name, values in given.items():
        array, about = (values[0], {"long_name": values[1]}) if isinstance(values, tuple) else (values, {})
        array = np.asarray(array)
        if not name.isidentifier() or array.shape != (members,) or array.dtype.kind not in "biufU":
            raise ValueError(
                f"coordinates has {short(array)} for {name!r}; give numbers or names of shape ({members},), and a name "
                "of letters, digits and underscores"
            )
        found[name] = (("member",), array.astype(np.float64) if array.dtype.kind == "f" else array, about)
    return found


def _here(store: ArchiveStore, left: list[Block], ready: PreparedRun, progress: bool) -> None:
    """Run blocks in this process, one after the other."""
    with progress_bar(sum(block.last - block.first for block in left), progress, "member") as bar:
        for block in left:
            if run_block(str(store.path), block, ready, True, None) == BUSY:
                raise ArchiveUnwritten(f"{store.path}: another process is still running some members; try again later")
            bar(block.last - block.first)
