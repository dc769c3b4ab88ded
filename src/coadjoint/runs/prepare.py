"""`prepare`: a run that is prepared once for many short calls."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.long_operations import long_operation
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import read_method
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.shortcuts import shortcut
from coadjoint.systems.batch import Batch
from coadjoint.systems.system import System


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
        coordinates, or to the label of a `Torque` in ``system.labels``. See docs/control.md.

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
