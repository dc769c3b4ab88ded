"""Runs, and the step of a free body, as differentiable functions of JAX (``co.jax``)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from coadjoint.errors import refuse_others, unknown_name
from coadjoint.keyword_hints import not_by_position
from coadjoint.optional_packages import require_packages
from coadjoint.runs.derivatives.differentiable_run import REVERSES
from coadjoint.runs.derivatives.parametrized_run import ParametrizedRun, prepared_of
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.systems.batch import Batch
from coadjoint.systems.forces.base import Force
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.hamiltonians.parametrized_functions import NAME, function_with_params
from coadjoint.systems.hamiltonians.user_hamiltonian import JaxFunction
from coadjoint.systems.learned_forces import LearnedDoubleBracket, LearnedTorque
from coadjoint.systems.system import System
from coadjoint.validation import read_choice

__all__ = ["PoissonMap", "double_bracket", "energy", "features", "free_body", "solution", "torque"]

TYPE_CHECKING = False
if TYPE_CHECKING:
    from coadjoint.jax.poisson_map import PoissonMap

BACKENDS = ("compiled", "xla")


def double_bracket(root: Callable[..., Any], params: Any) -> Force:
    """Return damping on the orbit with a metric of parameters, ``x' = J(x) P J(x) grad H`` with P = L L^T, as a force.

    Use it to learn a dissipation that keeps every Casimir: whatever the parameters are, the metric is positive
    semidefinite, so that the energy falls, and states stay on their coadjoint orbits to round-off. For a known metric
    use `coadjoint.forces.DoubleBracketDamping`; for a friction that leaves the orbit, `torque`.

    Parameters
    ----------
    root : callable
        ``root(x, params)``, or ``root(x, params, t)``, of a state (n,), returns the root L of the metric by operations
        of JAX: (n, k), or (n,) for a diagonal, or a number for a multiple of the unit matrix. Its square has the unit
        of 1/(unit of the energy) where the invariant form of the algebra is the sum of squares; a learned rate is in
        it.
    params : pytree of arrays of float64
        Parameters. If the energy or other forces have params too, all of them take the same ones: one pytree with all
        parameters of the run, of which each function uses its own.

    Returns
    -------
    Force
        For ``system.with_forces``. Runs by `solution` take and differentiate ``params=``; compiled loops call the
        function in Python, at the given parameters.

    Raises
    ------
    ImportError
        JAX is not installed; the extra is ``coadjoint[jax]``.
    TypeError
        As `energy`. On the system: JAX cannot trace the function, or the system has no structure constants.
    ValueError
        On the system: the root has another shape, or a part without derivative, as by ``stop_gradient``; or axes,
        directions or positions would be changed.

    Notes
    -----
    The flow is the midpoint rule on the orbit, by exponentials: of order 2, symmetric.

    References
    ----------
    A. Bloch, P. S. Krishnaprasad, J. E. Marsden, T. S. Ratiu, The Euler-Poincare equations and double bracket
    dissipation, Communications in Mathematical Physics 175 (1996).

    See Also
    --------
    torque : Forces that leave the orbit.
    coadjoint.forces.DoubleBracketDamping : Known metrics, in compiled loops.

    Examples
    --------
    The derivative of the final energy by the root, and the momentum, whose length stays:

    >>> import jax
    >>> import jax.numpy as jnp
    >>> import coadjoint as co
    >>> jax.config.update("jax_enable_x64", True)
    >>> damping = co.jax.double_bracket(lambda x, params: params["root"], {"root": 0.2 * jnp.eye(3)})
    >>> body = co.systems.rigid_body((1.0, 2.0, 3.0)).with_forces(damping)
    >>> run = co.jax.solution(body, (0, 10), method=co.Splitting(order=4), step=0.1)
    >>> x0 = jnp.array([1.0, 0.2, 0.5])
    >>> def energy_at_end(params):
    ...     return 0.5 * (run(x0, params=params)[-1] ** 2 / jnp.array([1.0, 2.0, 3.0])).sum()
    >>> slope = jax.grad(energy_at_end)({"root": 0.2 * jnp.eye(3)})
    >>> bool(jnp.trace(slope["root"]) < 0), bool(abs((run(x0)[-1] ** 2).sum() - 1.29) < 1e-13)
    (True, True)
    """
    require_packages("co.jax.double_bracket", "jax")
    from coadjoint.jax.library import RootFunction

    return LearnedDoubleBracket(RootFunction(root, params))


def energy(function: Callable[..., Any], params: Any) -> Hamiltonian:
    """Return an energy H(x, params) of JAX, such as a neural network, as a Hamiltonian at these parameters.

    Use it to learn an energy that is no polynomial: runs by `solution` take other ``params=`` and are differentiated by
    them; data and runs of several trajectories have the shape (times, members, n), times first.
    (`coadjoint.identify` finds polynomials by linear regression.) Whatever the parameters are, the motion has the
    Casimirs of the algebra. `GaussLegendre` takes every such energy, `Splitting` only one of commuting coordinates, as
    a piece of a `SplitHamiltonian`. If the energy is a sum of functions of one linear combination of coordinates each,
    take `features`, which `Splitting` integrates explicitly.

    Parameters
    ----------
    function : callable
        ``function(x, params)``, or ``function(x, params, t)``, of a state (n,), returns one number by operations of
        JAX that are differentiable twice.
    params : pytree of arrays of float64
        Weights, such as dictionaries and lists of arrays, of flax, or the first result of ``equinox.partition``.

    Returns
    -------
    Hamiltonian
        H(x) at these parameters, for a `LiePoissonSystem`, or a piece of a `SplitHamiltonian`, of commuting
        coordinates. It has all runs of functions of JAX; compiled loops call it in Python.

    Raises
    ------
    ImportError
        JAX is not installed; the extra is ``coadjoint[jax]``.
    TypeError
        The function takes other arguments; a parameter is no array, as a tensor of PyTorch or a function, or is not of
        float64, which JAX has with ``jax.config.update("jax_enable_x64", True)``.
    ValueError
        In a system: the energy has a part without derivative, as by ``stop_gradient``.

    See Also
    --------
    solution : Runs as functions of x0 and params.
    coadjoint.identify : Polynomials by linear regression.

    Examples
    --------
    The derivative of the end of a run by the weights:

    >>> import jax
    >>> import jax.numpy as jnp
    >>> import coadjoint as co
    >>> jax.config.update("jax_enable_x64", True)
    >>> def network(x, params):
    ...     return params["out"] @ jnp.tanh(params["in"] @ x)
    >>> params = {"in": jnp.eye(4, 3), "out": jnp.arange(4.0)}
    >>> system = co.LiePoissonSystem(co.algebras.so(3), co.jax.energy(network, params), sign=-1)
    >>> run = co.jax.solution(system, (0, 10), method=co.GaussLegendre(1), step=0.1)
    >>> x0 = jnp.array([1.0, 0.2, 0.5])
    >>> gradient = jax.grad(lambda params: run(x0, params=params)[-1, 0])(params)
    >>> gradient["in"].shape
    (4, 3)
    """
    require_packages("co.jax.energy", "jax")
    from coadjoint.jax.library import JaxEnergy

    return Hamiltonian(JaxEnergy(function, params))


def features(function: Callable[..., Any], directions: Any, params: Any) -> Hamiltonian:
    """Return the energy sum_k f(<a_k, x>, w_k) of directions a_k, as a Hamiltonian at these a and w.

    Use it to learn an energy by explicit steps: the flow of each feature is a coadjoint motion in closed form, on every
    algebra, so that `Splitting` of every order is a Poisson map with all Casimirs, for every a and w. The directions
    are learned too. Sums of such features approximate every energy.

    Parameters
    ----------
    function : callable
        ``function(y, params)`` of a number y and the parameters of one feature; returns a number by operations of JAX.
    directions : (features, n)
        The directions a, of float64.
    params : pytree of arrays of float64
        The parameters w, each with a first axis of features.

    Returns
    -------
    Hamiltonian
        Its runs by `solution` take and differentiate ``params=(directions, params)``.

    Raises
    ------
    ImportError
        JAX is not installed; the extra is ``coadjoint[jax]``.
    TypeError
        As `energy`.
    ValueError
        Wrong shapes.

    Notes
    -----
    Since <a, x> is constant along the flow of f(<a, x>), it is x(t) = exp(t f'(<a, x>) D) x with D x = sign J(x) a. The
    exponential is a series; where the norm of the matrix exceeds 4 in one flow, the states are NaN. Compiled loops have
    no such flows: `integrate` takes `GaussLegendre` with this energy.

    See Also
    --------
    energy : Energies of any form.
    PoissonMap : Flows of features as the layers of a map.

    Examples
    --------
    >>> import jax
    >>> import jax.numpy as jnp
    >>> import coadjoint as co
    >>> jax.config.update("jax_enable_x64", True)
    >>> H = co.jax.features(lambda y, w: w * jnp.cosh(y), jnp.eye(5, 6), jnp.arange(1.0, 6.0))
    >>> system = co.LiePoissonSystem(co.algebras.e(3), H, sign=-1)
    >>> run = co.jax.solution(system, (0, 1), method=co.Splitting(order=4), step=0.1)
    >>> x = run(jnp.array([0.1, 0.2, 0.3, 0.6, 0.0, 0.8]))
    >>> bool(abs((x[:, 3:] ** 2).sum(axis=1) - 1.0).max() < 1e-14)
    True
    """
    require_packages("co.jax.features", "jax")
    from coadjoint.jax.library import FeatureEnergy

    return Hamiltonian(FeatureEnergy(function, (directions, params)))


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
    ready: PreparedRun | System | Batch,
    t_span: tuple[float, float],
    save_every: int = 1,
    *,
    method: Any = None,
    step: float | None = None,
    t_eval: Any = None,
    backend: str | None = None,
    reverse: str = "exact",
) -> Callable[..., Any]:
    """Return a run as a function of JAX, of the initial state and parameters of the system.

    Use it to fit parameters or initial states inside of a program of JAX. ``grad``, ``value_and_grad``, ``jvp``,
    ``linearize``, ``vmap``, ``jit``, ``jacfwd`` and ``jacrev`` apply to it. The runs and their derivatives are those of
    `PreparedRun.run`, `PreparedRun.jvp` and `PreparedRun.vjp`, by default in compiled loops on the processor.

    Parameters
    ----------
    ready : PreparedRun, System or Batch
        The prepared run, with a step, of a scheme with derivatives; or a system or batch, with `step` and `method` as
        in `prepare`.
    t_span, save_every, t_eval
        As in `PreparedRun.run`.
    method, step
        Scheme and step of a system; of a prepared run they are its own.
    backend : {"compiled", "xla"}, optional
        Where runs are computed. None is ``"xla"`` for systems with params, else ``"compiled"``.
        ``"compiled"``: by a callback into the compiled loops. ``"xla"``: by operations of JAX, on all devices, from the
        table of a splitting, by flows of features, or with at most 50 iterations in each step of `GaussLegendre`; with
        forces, batches, inputs of the energy, and attitudes by splittings; for fluids of matrices by
        `IsospectralGauss` and its compositions, with viscosity and friction; not for other schemes and compensated
        sums.
        The numbers agree to rounding, those of noise too. See docs/derivatives.md.
    reverse : {"exact", "reversible"}
        How reverse mode finds the states before a step, as in `PreparedRun.vjp`. ``"exact"``: they are stored, or
        repeated from stored ones; memory grows as the root of the number of steps. ``"reversible"``: steps are undone
        from the next saved state, in memory that is constant in the number of steps between saved states; for runs
        without forces by splittings, and with ``backend="xla"`` by `GaussLegendre`, of vectors. See Notes.

    Returns
    -------
    callable
        A function ``f(x0, *, attitude0=None, **parameters)``. It returns the states, (times, n) for x0 of shape (n,)
        and (times, members, n) for (members, n), as the solutions of `integrate`, where matrices have the axes (N, N)
        in place of n; for a run prepared with an attitude the pair of states and attitudes. The parameters are those of
        ``ready.parameters``, in their shapes, and default to these values; with inputs they are the inputs; of
        `energy`, `features`, `torque` and `double_bracket` they are ``params``, one pytree for all. A system with other
        parameters is prepared in each call, and the last one is cached; other inputs and params need no preparation.

    Raises
    ------
    ImportError
        JAX is not installed; the extra is ``coadjoint[jax]``.
    TypeError
        The run has no derivatives or is not supported by the backend; a function of a force or Hamiltonian has other
        values where JAX traces it than compiled; or numbers are not of float64, which JAX has with
        ``jax.config.update("jax_enable_x64", True)``. A step or scheme for a prepared run, or none for a system. The
        callable is given parameters by position.
    ValueError
        For unknown names, wrong shapes, and initial states and attitudes that `PreparedRun.run` refuses.
    IntegrationError
        As in `integrate`; inside of ``jit`` the error of JAX contains its message. With ``backend="xla"`` states are
        NaN in place of an error, with a `LargeStepWarning` outside of ``jit`` and ``vmap``; inside test the last one.

    Notes
    -----
    The first run warns of a step that is too large, as `integrate` does: of the members and steps of a compiled run, of
    which with ``backend="xla"`` the first 64 and, of matrices and of functions called in Python such as those of
    `energy`, the first 100 steps (and 8 members) are taken. With ``backend="xla"`` this is the first run outside of
    ``jit`` and ``vmap``, without noise, and at the params of the system: other params, and flows of `features`, are
    checked for NaN only. Give a system of the learned params to `integrate` to check their step.

    ``vmap`` over initial states makes one ensemble, the members of which are integrated side by side. Over parameters
    the runs follow one after the other. Second derivatives are not available. With ``backend="xla"`` they are, and
    `vmap` makes one ensemble in all cases.

    Undone steps return to the states of the run with the rounding of both ways: 1e-13 of their size in 1e4 steps of a
    regular motion. It grows with the distance of neighboring motions, as exp(lambda t) of chaotic ones between two
    saved states. With ``backend="xla"`` the state that is reached is compared with each saved one, where undoing starts
    again; gradients are NaN if they differ by more than 1e-8 of the size of the group of coordinates. Save states more
    often then, or take ``reverse="exact"``. Forward mode needs ``"exact"``.

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
    if backend not in (None, *BACKENDS):
        raise unknown_name("backend", backend, BACKENDS)
    undoes = read_choice(reverse, "reverse", REVERSES) == "reversible"
    require_packages("co.jax.solution", "jax")
    from coadjoint.jax.library import LIBRARY
    from coadjoint.jax.primitives import solve
    from coadjoint.jax.xla_run import XlaRun

    ready = prepared_of(ready, method, step, "co.jax.solution")
    learned = type(ready) is PreparedRun and function_with_params(ready.system, JaxFunction, LIBRARY) is not None
    compute: Callable[..., Any]
    on_xla = learned if backend is None else backend == "xla"
    if on_xla:
        compute = XlaRun(ready, t_span, save_every, t_eval, undoes)
    else:
        compute = partial(solve, ParametrizedRun(ready, t_span, save_every, t_eval, "co.jax.solution", reverse=reverse))

    def solution_of(x0: Any, *others: Any, attitude0: Any = None, **parameters: Any) -> Any:
        """Return the states of the run, and the attitudes if it was prepared with one; see `co.jax.solution`."""
        if others:
            known = ready.parameters if ready.inputs is None else ready.inputs.indices
            raise not_by_position("the function of co.jax.solution", others, [NAME] if learned else known)
        if learned and NAME in parameters and not on_xla:
            raise ValueError('params are taken by backend="xla" only; compiled loops have those of the system')
        if NAME in parameters and not learned:
            raise ValueError(
                f"{ready.system.name} has no params of JAX; give co.jax.energy(function, params) as its Hamiltonian, "
                "or co.jax.torque(function, params) as a force"
            )
        return compute(x0, attitude0, parameters)

    return solution_of


def torque(function: Callable[..., Any], params: Any) -> Force:
    """Return a torque of parameters, ``x' = N(x, params)``, such as a neural network, as a force.

    Use it to learn a friction, a drag or a drive beside a known or learned energy. For a law without parameters to
    learn, or with named numbers, use `coadjoint.forces.Torque`, which is compiled; for a dissipation that keeps the
    Casimirs, `double_bracket`.

    Parameters
    ----------
    function : callable
        ``function(x, params)``, or ``function(x, params, t)``, of a state (n,), returns the contribution to x', (n,),
        by operations of JAX. For bodies, such as `coadjoint.systems.body`, it may return the torque in the frame of the
        body, (3,), or of k bodies, (k, 3).
    params : pytree of arrays of float64
        Parameters. If the energy or other forces have params too, all of them take the same ones: one pytree with all
        parameters of the run, of which each function uses its own.

    Returns
    -------
    Force
        For ``system.with_forces``. Runs by `solution` take and differentiate ``params=``; compiled loops call the
        function in Python, at the given parameters.

    Raises
    ------
    ImportError
        JAX is not installed; the extra is ``coadjoint[jax]``.
    TypeError
        As `energy`. On the system: JAX cannot trace the function, or the system has no structure constants.
    ValueError
        On the system: the values have another shape, or a part without derivative, as by ``stop_gradient``; or axes,
        directions or positions would be changed.

    Notes
    -----
    The flow is that of `coadjoint.forces.Torque`: a step of the Runge-Kutta method of order 4, in schemes of higher
    order an extrapolated midpoint rule.

    See Also
    --------
    energy : Energies with params.
    double_bracket : Dissipation on the orbit.

    Examples
    --------
    The derivative of a motion by the coefficients of a drag:

    >>> import jax
    >>> import jax.numpy as jnp
    >>> import coadjoint as co
    >>> jax.config.update("jax_enable_x64", True)
    >>> def drag(x, params):
    ...     return -(params["linear"] + params["quadratic"] * jnp.linalg.norm(x)) * x
    >>> params = {"linear": jnp.array(0.1), "quadratic": jnp.array(0.2)}
    >>> body = co.systems.rigid_body((1.0, 2.0, 3.0)).with_forces(co.jax.torque(drag, params))
    >>> run = co.jax.solution(body, (0, 10), method=co.Splitting(order=4), step=0.1)
    >>> slope = jax.grad(lambda params: (run(jnp.ones(3), params=params)[-1] ** 2).sum())(params)
    >>> bool(slope["linear"] < 0), bool(slope["quadratic"] < 0)
    (True, True)
    """
    require_packages("co.jax.torque", "jax")
    from coadjoint.jax.library import TorqueFunction

    return LearnedTorque(TorqueFunction(function, params))


if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    _refuse, __dir__ = refuse_others("co.jax", __all__)

    def __getattr__(name: str) -> Any:
        """Import the class, which needs JAX."""
        if name != "PoissonMap":
            return _refuse(name)
        require_packages("co.jax.PoissonMap", "jax")
        from coadjoint.jax.poisson_map import PoissonMap

        return PoissonMap
