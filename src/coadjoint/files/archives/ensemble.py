"""Ensembles computed in blocks: `integrate_ensemble`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from coadjoint.files.archives.run_in_blocks import read_worker_pool, run_in_blocks
from coadjoint.files.datasets.variables import ExtraMetadata, Variables
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.methods.protocol.method import Method
from coadjoint.optional_packages import require_packages
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.run import read_progress
from coadjoint.runs.start import combined
from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.system_checks import System
from coadjoint.validation import read_integer, read_numbers

if TYPE_CHECKING:
    from distributed import Client

    from coadjoint.runs.results.solution import Solution


@suggest_keywords
def integrate_ensemble(
    system: System | ForcedSystem | Batch,
    x0: Any,
    t_span: tuple[float, float],
    step: float,
    method: Method | str | Mapping[str, Any] | None = None,
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
) -> Solution:
    """Integrate many members in blocks, on the workers of a cluster or here, into one archive.

    Use it for ensembles that take hours, or exceed the memory of the machine. (`integrate` holds all members in memory,
    where they are lost if the process is killed.) Each block of members is a task that writes its own files of the
    archive. Results never pass through the client. If workers, the scheduler or the client are lost, a second call with
    the same archive computes what is missing. Each member is bitwise equal to its run alone.

    Parameters
    ----------
    system, x0, t_span, step, method, save_every, attitude, watch, observe
        As for `integrate`; x0 is (members, n), or of a `batch` also (n,), and a batch with named axes is combined
        with every state.
    archive : str or Path, optional
        The folder of the archive, new or one of the same ensemble; all workers must see it by the same name. It is
        required with a client. Otherwise the default is a temporary folder that exists as long as the solution.
    client : distributed.Client, optional
        Client of the cluster.
    workers : int, optional
        Number of processes on this machine, instead of a client. They take some seconds to start, so that threads are
        faster on one machine, unless functions of the user run in Python. A script must guard such a call by ``if
        __name__ == "__main__":``, since each process imports it. With neither, this process runs all blocks.
    members_per_block : int, optional
        Number of members of a block. By default there are about four blocks for each worker, or more if members have
        many numbers. For an existing archive, the number is that of the archive.
    threads : int, optional
        Number of threads for the members of a block. The default is one on workers, and otherwise one for each core.
    progress : bool
        Show a progress bar over the members.
    coordinates : mapping, optional
        Name -> numbers, one for each member, such as parameters that differ: coordinates of the dataset.

    Returns
    -------
    Solution
        The solution, as from `open_archive`; arrays are read lazily. `status` has the progress of the members.

    Raises
    ------
    ValueError, TypeError
        For wrong input, before the first step.
    ArchiveError
        The archive is of another ensemble, written by another process, or cannot be created.
    ArchiveUnwritten
        The archive could not be written during the run, or the cluster is lost. Call again to compute what is missing.
    IntegrationError
        Members failed. The others are computed to their ends first; ``.partial`` is the ensemble.

    Examples
    --------
    >>> import coadjoint as co
    >>> import numpy as np
    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> states = np.random.default_rng(1).standard_normal((100, 3))
    >>> many = co.integrate_ensemble(body, states, (0, 10), 0.1, members_per_block=32)
    >>> many.x.shape, many.finished
    ((101, 100, 3), True)
    >>> bool((many.x[:, 7] == co.integrate(body, states[7], (0, 10), 0.1).x).all())
    True
    """
    require_packages("an ensemble in an archive", "xarray", "zarr")
    system, x0 = combined(system, x0)
    progress, pool = read_progress(progress), read_worker_pool(client, workers, threads)
    if archive is None and client is not None:
        raise TypeError(
            "ensemble was given a client and no archive; give archive=, a folder that all workers can reach, since "
            "results do not pass through the client"
        )
    size = None if members_per_block is None else read_integer(members_per_block, "members_per_block", floats=True)
    prepared = PreparedRun(system, method, step, attitude=attitude, watch=watch, observe=observe, threads=pool.threads)
    members = len(prepared.start(x0).momenta)
    metadata = ExtraMetadata(_along_members({} if coordinates is None else coordinates, members), {})
    return run_in_blocks(prepared, x0, t_span, save_every, archive, pool, size=size, progress=progress, about=metadata)


def _along_members(coordinates: Mapping[str, Any], members: int) -> Variables:
    """Validate coordinates and return them as variables of an archive."""
    if not isinstance(coordinates, Mapping):
        raise TypeError(
            f"coordinates is {short(coordinates)}; give a mapping from names to numbers, one for each member"
        )
    variables: Variables = {}
    for name, values in coordinates.items():
        if not isinstance(name, str) or not name.isidentifier():
            raise ValueError(f"coordinates has the name {short(name)}; give one of letters, digits and underscores")
        numbers = read_numbers(values, f"coordinates[{short(name)}]")
        if numbers.shape != (members,):
            raise ValueError(f"coordinates has {short(numbers)} for {name!r}; give numbers of shape ({members},)")
        variables[name] = (("member",), numbers, {})
    return variables
