"""Runs, and the step of a free body, as differentiable functions of JAX (``co.jax``)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from coadjoint.errors import refuse_others, unknown_name
from coadjoint.optional_packages import require_packages
from coadjoint.runs.derivatives.parametrized_run import ParametrizedRun
from coadjoint.runs.prepared_run import PreparedRun

__all__ = ["free_body", "solution"]

TYPE_CHECKING = False

BACKENDS = ("compiled", "xla")


def free_body(x: Any, A: Any, inertia: Any, h: Any) -> Any:
    """Return the exact step of a free rigid body, of any length, as a function of JAX.

    Use it in simulators and models in JAX in place of an integrator for rotations. It has no error except rounding, for
    every body and step, keeps the length of the momentum, the energy and the momentum in space to rounding, and makes
    the attitude orthonormal. ``jit``, ``vmap``, and derivatives of any order in forward and reverse mode apply to it;
    they are finite also at rest, at equal moments, and for rotations about principal axes.

    Parameters
    ----------
    x : (3,)
        Angular momentum in the frame of the body.
    A : (3, 3), or None
        Attitude, the rotation from the body to space.
    inertia : (3,) or (3, 3)
        Moments of inertia along the axes of the frame, or the inertia tensor, of which the symmetric part counts. A
        moment of zero, as of a rod, excludes rotation about its axis; a tensor must be invertible.
    h : scalar
        Time of the step, of either sign.

    Returns
    -------
    x, A : array, (3,) and (3, 3)
        Momentum and attitude after the step; without an attitude the momentum alone.

    Raises
    ------
    ImportError
        JAX is not installed; the extra is ``coadjoint[jax]``.
    ValueError
        Wrong shapes.
    TypeError
        Numbers of another type than float32 and float64, or arrays of float64 without ``jax_enable_x64``.

    Notes
    -----
    Results have the precision of the arguments, float32 also without ``jax_enable_x64``. The motion is x' = x cross w
    and A' = A hat(w), with w = inertia^-1 x. A step is computed in pieces: the largest difference of inverse moments,
    times the length of x and the time, over 0.15 (float32: 0.4). If that is more than 64, these are pieces of one
    period of the momentum and of the rest; of a thin body on other than principal axes up to 65536 pieces. Beyond 2^30
    radians (float32: 2^20) of the motion of the momentum, and for numbers that are not finite, the results are NaN. An
    attitude whose rows have lengths from 0.8 to 1.2 is made orthonormal. Derivatives are computed forward; those at
    rest are exact up to the second.

    See Also
    --------
    solution : Runs of all systems.

    Examples
    --------
    A thousand bodies, and the derivative of the attitude of one by its moments:

    >>> import jax
    >>> import jax.numpy as jnp
    >>> import coadjoint as co
    >>> x, inertia = jnp.array([0.3, 1.0, 0.2]), jnp.array([1.0, 1.5, 2.5])
    >>> x1, A1 = co.jax.free_body(x, jnp.eye(3), inertia, 10.0)
    >>> bool(abs(A1 @ x1 - x).max() < 1e-5)  # in float32
    True
    >>> many = jax.vmap(co.jax.free_body, (0, 0, None, None))
    >>> many(jnp.tile(x, (1000, 1)), jnp.tile(jnp.eye(3), (1000, 1, 1)), inertia, 0.1)[1].shape
    (1000, 3, 3)
    >>> jax.jacrev(co.jax.free_body, 2)(x, jnp.eye(3), inertia, 0.1)[1].shape
    (3, 3, 3)
    """
    require_packages("co.jax.free_body", "jax")
    from coadjoint.jax.body_motion import checked_step

    return checked_step(x, A, inertia, h)


def solution(
    ready: PreparedRun,
    t_span: tuple[float, float],
    save_every: int = 1,
    *,
    t_eval: Any = None,
    backend: str = "compiled",
) -> Callable[..., Any]:
    """Return a run as a function of JAX, of the initial state and parameters of the system.

    Use it to fit parameters or initial states inside of a program of JAX. ``grad``, ``value_and_grad``, ``jvp``,
    ``linearize``, ``vmap``, ``jit``, ``jacfwd`` and ``jacrev`` apply to it. The runs and their derivatives are those of
    `PreparedRun.run`, `PreparedRun.jvp` and `PreparedRun.vjp`, by default in compiled loops on the processor.

    Parameters
    ----------
    ready : PreparedRun
        The prepared run, with a step, of a scheme with derivatives.
    t_span, save_every, t_eval
        As in `PreparedRun.run`.
    backend : {"compiled", "xla"}
        Where runs are computed. ``"compiled"``: by a callback into the compiled loops. ``"xla"``: by operations of JAX,
        on all devices, from the table of a splitting, or with 20 iterations in each step of `GaussLegendre`; with
        forces, batches, inputs of the energy, and attitudes by splittings; for fluids of matrices by `IsospectralGauss`
        and its compositions, with viscosity and friction; not for other schemes and compensated sums.
        The numbers agree to rounding, those of noise too. See docs/derivatives.md.

    Returns
    -------
    callable
        A function ``f(x0, *, attitude0=None, **parameters)``. It returns the states, (k, n) for x0 of shape (n,) and
        (k, members, n) for (members, n), where matrices have the axes (N, N) in place of n; for a run prepared with an
        attitude the pair of states and attitudes. The parameters are those of ``ready.parameters``, in their shapes,
        and default to these values; with inputs they are the inputs. A system with other values is prepared in each
        call, and the last one is cached.

    Raises
    ------
    ImportError
        JAX is not installed; the extra is ``coadjoint[jax]``.
    TypeError
        The run has no derivatives or is not supported by the backend; a function of a force or Hamiltonian has other
        values where JAX traces it than compiled; or numbers are not of float64, which JAX has with
        ``jax.config.update("jax_enable_x64", True)``.
    ValueError
        For unknown names, wrong shapes, and initial states and attitudes that `PreparedRun.run` refuses.
    IntegrationError
        As in `integrate`; inside of ``jit`` the error of JAX contains its message. With ``backend="xla"`` states are
        NaN in place of an error.

    Notes
    -----
    ``vmap`` over initial states makes one ensemble, the members of which are integrated side by side. Over parameters
    the runs follow one after the other. Second derivatives are not available. With ``backend="xla"`` they are, and
    `vmap` makes one ensemble in all cases.

    See Also
    --------
    coadjoint.PreparedRun.vjp : Gradients without JAX.

    Examples
    --------
    The inertia of a body from its motion, by one step of steepest descent:

    >>> import jax
    >>> import coadjoint as co
    >>> jax.config.update("jax_enable_x64", True)
    >>> body = co.prepare(co.systems.rigid_body(inertia=(1, 2, 2.5)), co.Splitting(order=4), step=0.05)
    >>> f = co.jax.solution(body, (0, 10), save_every=50)
    >>> x0 = jax.numpy.array([1.0, 0.2, 0.5])
    >>> wanted = f(x0)
    >>> def loss(inertia):
    ...     return ((f(x0, inertia=inertia) - wanted) ** 2).sum()
    >>> inertia = jax.numpy.array([1.1, 2.0, 2.4])
    >>> before, gradient = jax.jit(jax.value_and_grad(loss))(inertia)
    >>> bool(loss(inertia - 1e-3 * gradient) < before)
    True
    """
    if backend not in BACKENDS:
        raise unknown_name("backend", backend, BACKENDS)
    require_packages("co.jax.solution", "jax")
    from coadjoint.jax.primitives import solve
    from coadjoint.jax.xla_run import XlaRun

    compute: Callable[..., Any]
    if backend == "xla":
        compute = XlaRun(ready, t_span, save_every, t_eval)
    else:
        compute = partial(solve, ParametrizedRun(ready, t_span, save_every, t_eval, "co.jax.solution"))

    def solution_of(x0: Any, *, attitude0: Any = None, **parameters: Any) -> Any:
        """Return the states of the run, and the attitudes if it was prepared with one; see `co.jax.solution`."""
        return compute(x0, attitude0, parameters)

    return solution_of


if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = refuse_others("co.jax", __all__)
