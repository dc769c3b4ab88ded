"""The functions `integrate`, and `prepare` for a run that is prepared once for many short calls."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation, read_progress
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import read_method
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution, set_elapsed, with_choice
from coadjoint.runs.start import combined
from coadjoint.shortcuts import shortcut
from coadjoint.systems.batch import Batch
from coadjoint.systems.system import System


@suggest_keywords
@long_operation("integrate")
def integrate(
    system: System | Batch,
    x0: Any,
    t_span: tuple[float, float],
    step: float | None = None,
    method: Method | str | Mapping[str, Any] | None = None,
    *,
    accuracy: float | None = None,
    save_every: int = 1,
    t_eval: Any = None,
    attitude: Any = False,
    watch: bool = True,
    observe: Mapping[str, Any] | None = None,
    threads: int | None = None,
    progress: bool = False,
    events: Any = None,
    archive: str | Path | None = None,
) -> Solution:
    """Integrate a system at a constant step, given or chosen for a required accuracy.

    For many short runs of one system use `prepare`.

    The loop over the steps is compiled. Results are bitwise reproducible: they do not depend on `save_every`, `watch`
    or `threads`, nor on whether a member runs alone or in an ensemble.

    Parameters
    ----------
    system : System or Batch
        The system; a `batch` has one for each member.
    x0 : array_like, shape (n,) or (members, n)
        Initial momentum, or one for each member of an ensemble; (n,) is shared by all members of a batch, and every
        state by all systems of a `batch` with named axes. For a `MatrixSystem` a matrix (N, N), or (members, N, N). An
        array of xarray is used by its dimensions ``component`` (``row`` and ``column`` of matrices) and ``member``, in
        any order, and by its labels, the names of the coordinates; so is a table of pandas by its columns.
    t_span : (float, float)
        Start and end. The run goes backward in time if the end is the smaller one. The span must be a whole number of
        steps, up to the rounding of an end that was computed as a sum of the steps, such as ``np.cumsum([0.1] * 300)``:
        8 units in the last place of the largest time for each step, and at most a hundredth of a step. The run ends
        after its last step.
    step : float, optional
        Size of a step, positive. It is used as given and never adjusted. Give either this or `accuracy`.
    method : Method, str or mapping, optional
        The scheme; or its name, such as ``"Splitting"``; or name and parameters, such as ``{"name": "Splitting",
        "order": 4}``. The default is `Splitting()` of order 2 if H is a sum of functions of commuting coordinates,
        otherwise `GaussLegendre(stages=3)`, for matrices the one of `suggested_scheme`, and with `accuracy` the one
        that `choose` selects; ``sol.method`` names it.
    accuracy : float, optional
        Wanted error of the momentum at the end, relative to the largest momentum during the run. `choose` then selects
        the step, and without `method` also the scheme. There is no `rtol`: a step that is chosen by an estimate of the
        error would lose what the schemes keep over long times, except those of `Taylor(tolerance=...)` and
        `ReversibleSteps(Splitting(...))`.
    save_every : int
        Save every k-th step, and always the start and the end. Memory is needed for the saved points only.
    t_eval : array_like, shape (k,), optional
        Save the states at these times instead: any times within `t_span`, sorted in its direction. A state between two
        steps is reached by a part of a step of the same scheme, so it is as accurate as the states at the steps. The
        steps themselves have the same bits as without `t_eval`. A time beyond an end by rounding, as described for
        `t_span` and for each step or time of `t_eval`, has the state at that end.
    attitude : bool, "coadjoint", or array_like
        Whether to compute the group element as well. True: in the representation of the system, from the unit matrix.
        An array of shape (d, d): the same, from this initial element (for so(n) a rotation); of bodies and tops it may
        be a SciPy Rotation or a unit quaternion (x, y, z, w) as well (``Rotation.from_quat(q, scalar_first=True)`` for
        another order). "coadjoint": as the coadjoint matrix K, with K x constant.
    watch : bool
        Compute the energy and every Casimir after every step; otherwise only at the saved points. For matrices it is
        always the saved points.
    observe : mapping, optional
        Name -> `Polynomial`, `Quadratic` or function of x: further quantities, computed at the saved points. If states
        are matrices, functions of a matrix.
    threads : int, optional
        Number of threads, first for the members of an ensemble, then inside of members of 1024 coordinates or more,
        such as lattices of spins or matrices. The default is one for each core, which for matrices of more than 128
        rows share one member after the other.
    progress : bool
        Show a progress bar.
    events : Event or sequence of Event, optional
        Functions of the state whose zeros are found; ``sol.events`` has them. A terminal event ends the run. With a
        single member, the last point of the solution is then the event. Of `t_eval`, the times before it are saved.
    archive : str or Path, optional
        A new folder, such as ``run.zarr``, to which the run is written while it runs, in the format Zarr. The memory
        does not grow with the length of the run. The folder can be read at any time, and `resume` continues the run
        after any interruption. The solution reads from the folder lazily. It has no `t_eval`.

    Returns
    -------
    Solution
        Saved states with energies, Casimirs, attitude and drifts.

    Raises
    ------
    ValueError, TypeError
        For wrong input, before the first step.
    IntegrationError
        If an iteration does not converge or a number overflows, with step, time, residual and the solution so far.
    KeyboardInterrupt
        After Ctrl-C. Its ``.partial`` is the solution so far, or the archive.
    ArchiveError, ArchiveUnwritten
        If the archive exists or cannot be made; or if it could not be written during the run, which can then be
        resumed.

    Examples
    --------
    >>> import coadjoint as co
    >>> top = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> method = co.GaussLegendre(stages=3)
    >>> sol = co.integrate(top, (0.0, 1.0, 0.01), t_span=(0, 50), step=0.05, method=method, save_every=100)
    >>> sol.t
    array([ 0.,  5., 10., 15., 20., 25., 30., 35., 40., 45., 50.])
    >>> sol.drift()["energy"] < 1e-14
    True

    With a required accuracy instead of a step:

    >>> sol = co.integrate(top, (0.0, 1.0, 0.01), t_span=(0, 50), accuracy=1e-8)
    >>> import numpy as np
    >>> exact = top.exact((0.0, 1.0, 0.01), 50.0)
    >>> bool(np.linalg.norm(sol.x[-1] - exact) < 1e-8)
    True
    """
    began = time.perf_counter()
    method = None if method is None else read_method(method)
    system, x0 = combined(system, x0)
    if (step is None) == (accuracy is None):
        supplied = "neither" if step is None else "both"
        raise TypeError(
            f"integrate was given {supplied} of step and accuracy; give step=, or accuracy= to have the step chosen"
        )
    progress = read_progress(progress)
    choice = None
    if accuracy is not None:
        choice = chosen_for(accuracy, system, x0, t_span, attitude, method)
        method, step = choice.method, choice.step
    assert step is not None
    prepared = PreparedRun(system, method, step, attitude=attitude, watch=watch, observe=observe, threads=threads)
    if archive is None:
        sol = prepared.run(x0, t_span, save_every, t_eval=t_eval, progress=progress, events=events)
    else:
        sol = shortcut("archive_run")(
            prepared, x0, t_span, save_every, archive, t_eval=t_eval, progress=progress, events=events
        )
    if choice is None:
        from coadjoint.runs.error_estimates import warn_of_large_step

        warn_of_large_step(sol, prepared)
    if archive is None:
        set_elapsed(sol, time.perf_counter() - began)
    return with_choice(sol, choice)


def chosen_for(
    accuracy: float, system: Any, x0: Any, t_span: tuple[float, float], attitude: Any, method: Method | None
) -> Any:
    """Return the `Choice` of `choose` for the arguments of `integrate`."""
    return shortcut("choose")(system, x0, t_span, accuracy, attitude=attitude, methods=method)


@suggest_keywords
@long_operation("prepare")
def prepare(
    system: System | Batch,
    method: Method | str | Mapping[str, Any] | None = None,
    step: float | None = None,
    *,
    accuracy: float | None = None,
    x0: Any = None,
    t_span: tuple[float, float] | None = None,
    attitude: Any = False,
    watch: bool = True,
    observe: Mapping[str, Any] | None = None,
    threads: int | None = None,
    inputs: Any = None,
) -> PreparedRun:
    """Prepare a run once for many short calls: control loops, shooting methods, maps.

    `integrate` does the same preparation in each call. The parameters are those of `integrate`, except the initial
    state and the times, which are given to each run.

    Parameters
    ----------
    system : System or Batch
        The system.
    method : Method or None
        The scheme. The default is that of `integrate`.
    step : float, optional
        Size of a step, positive. Give either this or `accuracy`. Loops for backward runs are built at the first such
        run.
    accuracy : float, optional
        Wanted error, as in `integrate`. The step, and without `method` the scheme, are chosen once for a sample of
        states. Each run is checked by its first step, which is compared with two steps of half the size. The difference
        may be at most twice as large as along the motions from the sample. If it is larger, scheme and step are chosen
        again for this run alone, which takes some ms. A motion that is slow at its start, and later faster than all
        motions from the sample, is not detected.
    x0 : array_like, shape (n,) or (members, n), optional
        With `accuracy`: the sample, representative initial states.
    t_span : (float, float), optional
        With `accuracy`: the longest run, and its direction.
    attitude : bool, "coadjoint", or array_like
        Whether to compute the group element, as in `integrate`. An array is the initial element of every run that is
        not given another one.
    watch : bool
        Compute the energy and every Casimir after every step; otherwise only at the saved points.
    observe : mapping, optional
        Name -> `Polynomial` or function of x: further quantities, computed at the saved points.
    threads : int, optional
        Number of threads, first for the members of an ensemble, then inside of members of 1024 coordinates or more,
        such as lattices of spins. The default is one for each core.
    inputs : True, sequence of int, or mapping, optional
        Quantities that may change from run to run: coefficients of the linear term of H (such as a field, the weight
        of a top, the momenta of rotors), and constant torques. Give the coordinates whose coefficients change, or True
        for all; ``run(..., linear=)`` then takes the values. Or give a mapping from a name for each input to
        coordinates, or to the label of a `Torque` in ``system.labels``. In a batch, a value of a call is that of all
        members, or has a leading axis of members, and defaults to that of each member's system. See docs/control.md.

    Returns
    -------
    PreparedRun
        Its method ``run(x0, t_span, save_every=1)`` returns a `Solution`. Threads may share it. The first run warns of
        a step that is too large, as `integrate` does; for later ones ask `Solution.step_error`.

    Raises
    ------
    ValueError, TypeError
        For wrong input.

    Examples
    --------
    >>> import coadjoint as co
    >>> prepared = co.prepare(co.systems.rigid_body(inertia=(1, 2, 3)), co.Splitting(order=4), step=0.05)
    >>> sol = prepared.run((0.1, 1.0, 0.1), t_span=(0, 5), save_every=50)
    >>> sol.t
    array([0. , 2.5, 5. ])
    >>> back = prepared.run(sol.x[-1], t_span=(5, 0), save_every=100)
    >>> bool(abs(back.x[-1] - sol.x[0]).max() < 1e-13)
    True

    Rotor momenta as inputs of each run:

    >>> steered = co.prepare(co.systems.rigid_body(inertia=(1, 2, 3)), None, step=0.05, inputs={"rotors": (0, 1, 2)})
    >>> x = (0.1, 1.0, 0.1)
    >>> for k in range(3):
    ...     x = steered.run(x, t_span=(0.5 * k, 0.5 * k + 0.5), rotors=(0.0, -0.1 * k, 0.0)).x[-1]

    Scheme and step chosen once for a sample of states:

    >>> body = co.systems.rigid_body(inertia=(1, 2, 3))
    >>> prepared = co.prepare(body, accuracy=1e-9, x0=[(0.1, 1.0, 0.1), (1.0, 0.2, 0.3)], t_span=(0, 20))
    >>> x0 = (0.4, 0.7, 0.5)
    >>> bool(abs(prepared.end(x0, (0.0, 20.0)) - body.exact(x0, 20.0)).max() < 1e-9)
    True

    A thruster torque as an input of each run:

    >>> body = co.systems.rigid_body(inertia=(1, 2, 3)).with_forces(co.forces.Torque((0, 0, 0)))
    >>> pushed = co.prepare(body, None, step=0.125, inputs={"thrusters": "Torque"})
    >>> pushed.run((0.0, 0.0, 1.0), t_span=(0, 2), thrusters=(0.0, 0.0, -0.5)).x[-1]
    array([0., 0., 0.])
    """
    if (step is None) == (accuracy is None):
        supplied = "neither" if step is None else "both"
        raise TypeError(
            f"prepare was given {supplied} of step and accuracy; give step=, or accuracy= with x0= and t_span="
        )
    if step is None:
        if x0 is None or t_span is None or not (inputs is None or inputs is False):
            raise TypeError(
                "accuracy= needs x0=, a sample of states, and t_span=, the longest run, and takes no inputs"
            )
        method = None if method is None else read_method(method)

        chosen = shortcut("run_to_accuracy")(
            system, x0, t_span, cast(float, accuracy), method, attitude, watch, observe, threads
        )
        chosen.loops(chosen.signed_step).build_all()
        return chosen
    if x0 is not None or t_span is not None:
        raise TypeError("prepare takes x0= and t_span= with accuracy=; a given step needs neither")
    prepared = PreparedRun(
        system, method, step, attitude=attitude, watch=watch, observe=observe, threads=threads, inputs=inputs
    )
    prepared.loops(prepared.step).build_all()
    prepared.cache.checks_step = True
    return prepared
