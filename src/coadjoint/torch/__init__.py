"""Energies, forces, and runs as differentiable functions, of PyTorch (``co.torch``)."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from coadjoint.errors import refuse_others
from coadjoint.keyword_hints import not_by_position
from coadjoint.optional_packages import require_packages
from coadjoint.runs.derivatives.parametrized_run import ParametrizedRun, prepared_of
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.systems.batch import Batch
from coadjoint.systems.forces.base import Force
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.hamiltonians.parametrized_functions import NAME, function_with_params
from coadjoint.systems.learned_forces import LearnedDoubleBracket, LearnedTorque
from coadjoint.systems.system import System

__all__ = ["double_bracket", "energy", "features", "solution", "torque"]

TYPE_CHECKING = False


def double_bracket(root: Callable[..., Any], params: Any = None) -> Force:
    """Return damping on the orbit with a metric of parameters, ``x' = J(x) P J(x) grad H`` with P = L L^T, as a force.

    Use it to learn a dissipation that keeps every Casimir, as `coadjoint.jax.double_bracket`: the energy falls for all
    parameters, and states stay on their coadjoint orbits to round-off. For a known metric use
    `coadjoint.forces.DoubleBracketDamping`; for a friction that leaves the orbit, `torque`.

    Parameters
    ----------
    root : torch.nn.Module or callable
        The root L of a state (n,), as the function of `energy`: a number, a diagonal (n,), or (n, k), by operations of
        PyTorch.
    params : tree of tensors of float64, optional
        As of `energy`. If the energy or other forces have params too, all of them take the same ones.

    Returns
    -------
    Force
        For ``system.with_forces``. Runs by `solution` take and differentiate ``params=``; compiled loops call the
        function in Python, at the given parameters.

    Raises
    ------
    ImportError
        PyTorch is not installed; the extra is ``coadjoint[torch]``.
    TypeError
        As `energy`. On the system: the function fails, or the system has no structure constants.
    ValueError
        On the system: the root has another shape, is random, or has a part without derivative, as by ``detach``.

    Notes
    -----
    The flow is the midpoint rule of `coadjoint.forces.DoubleBracketDamping`.

    See Also
    --------
    coadjoint.jax.double_bracket : The same in JAX.
    torque : Forces that leave the orbit.

    Examples
    --------
    ::

        import torch
        import coadjoint as co

        params = {"form": torch.tensor([1.0, 0.5, 0.4]).double(), "root": 0.3 * torch.eye(3, dtype=torch.float64)}
        H = co.torch.energy(lambda x, p: p["form"] @ x**2 / 2, params)
        damping = co.torch.double_bracket(lambda x, p: p["root"], params)
        system = co.LiePoissonSystem(co.algebras.so(3), H, sign=-1).with_forces(damping)
        run = co.torch.solution(system, (0, 5), method=co.GaussLegendre(1), step=0.1)
        torch.func.grad(lambda params: run((1.0, 0.2, 0.5), params=params)[-1, 0])(params)["root"]
    """
    require_packages("co.torch.double_bracket", "torch")
    from coadjoint.torch.library import TorchRoot

    return LearnedDoubleBracket(TorchRoot(root, params))


def energy(function: Callable[..., Any], params: Any = None) -> Hamiltonian:
    """Return an energy H(x, params) of PyTorch, such as a module, as a Hamiltonian at these parameters.

    Use it to learn an energy in PyTorch: runs by `solution` take other ``params=`` and are differentiated by them.
    Whatever the parameters are, the motion has the quadratic Casimirs of the algebra, to rounding. `GaussLegendre`
    takes every such energy; for explicit steps take `features`.

    Parameters
    ----------
    function : torch.nn.Module or callable
        A module of one state (n,), or of (x, t), in float64, in the mode that it has now, as by ``eval()``; or
        ``function(x, params)``, or ``function(x, params, t)``.
        It returns one number by operations of PyTorch that are differentiable twice, without buffers that change.
    params : tree of tensors of float64, optional
        Weights, in dictionaries and lists. Required for a function; of a module they are its parameters by name. The
        Hamiltonian has a copy of them.

    Returns
    -------
    Hamiltonian
        H(x) at these parameters, for a `LiePoissonSystem`, or a piece of a `SplitHamiltonian`. Compiled loops call it
        in Python.

    Raises
    ------
    ImportError
        PyTorch is not installed; the extra is ``coadjoint[torch]``.
    TypeError
        The function takes other arguments or returns no number of float64, or a parameter is not of float64, which
        modules have by ``module.double()``.
    ValueError
        In a system: the energy is not that of a state of its dimension, is random, such as a module with active
        dropout, or has a part without derivative, as by ``detach``.

    See Also
    --------
    solution : Runs as functions of x0 and params.
    coadjoint.jax.energy : The same in JAX, which compiles all steps of a run.
    coadjoint.identify : Polynomials by linear regression.

    Examples
    --------
    ::

        import torch
        import coadjoint as co

        network = torch.nn.Sequential(torch.nn.Linear(3, 32), torch.nn.Tanh(), torch.nn.Linear(32, 1)).double()
        system = co.LiePoissonSystem(co.algebras.so(3), co.torch.energy(network), sign=-1)
        run = co.torch.solution(system, (0, 1), method=co.GaussLegendre(1), step=0.1)
        x = run((1.0, 0.2, 0.5), params=dict(network.named_parameters()))
        x[-1, 0].backward()
        network[0].weight.grad
    """
    require_packages("co.torch.energy", "torch")
    from coadjoint.torch.library import TorchEnergy, TorchFunction

    made = TorchEnergy(function, params)
    return Hamiltonian(*(TorchFunction(made, order) for order in range(3)))


def features(function: Callable[..., Any], directions: Any, params: Any) -> Hamiltonian:
    """Return the energy sum_k f(<a_k, x>, w_k) of directions a_k, as a Hamiltonian at these a and w.

    Use it to learn an energy by explicit steps: the flow of each feature is a coadjoint motion, on every algebra, so
    that `Splitting` of every order is a Poisson map with all Casimirs, for every a and w. The directions are learned
    too. Sums of such features approximate every energy.

    Parameters
    ----------
    function : callable
        ``function(y, params)`` of a number y and the parameters of one feature; returns a number by operations of
        PyTorch.
    directions : (features, n)
        The directions a, of float64.
    params : tree of tensors of float64
        The parameters w, each with a first axis of features.

    Returns
    -------
    Hamiltonian
        Its runs by `solution` take and differentiate ``params=(directions, params)``.

    Raises
    ------
    ImportError
        PyTorch is not installed; the extra is ``coadjoint[torch]``.
    TypeError
        As `energy`.
    ValueError
        Wrong shapes.

    Notes
    -----
    Since <a, x> is constant along the flow of f(<a, x>), it is x(t) = exp(t f'(<a, x>) D) x with D x = sign J(x) a: in
    closed form where all D have one nonzero square, elsewhere by ``torch.linalg.matrix_exp``. Each flow is a few
    operations of PyTorch, so that JAX takes less time for long runs. Compiled loops have no such flows: `integrate`
    takes `GaussLegendre` with this energy.

    See Also
    --------
    energy : Energies of any form.
    coadjoint.jax.features : The same in JAX, which compiles all steps of a run.

    Examples
    --------
    ::

        import torch
        import coadjoint as co

        directions, sizes = torch.eye(5, 6, dtype=torch.float64), torch.arange(1.0, 6.0, dtype=torch.float64)
        H = co.torch.features(lambda y, w: w * torch.cosh(y), directions, sizes)
        system = co.LiePoissonSystem(co.algebras.e(3), H, sign=-1)
        run = co.torch.solution(system, (0, 1), method=co.Splitting(order=4), step=0.1)
        x = run((0.1, 0.2, 0.3, 0.6, 0.0, 0.8), params=(directions, sizes.requires_grad_()))
        x[-1, 0].backward()
        sizes.grad
    """
    require_packages("co.torch.features", "torch")
    from coadjoint.torch.library import TorchFeatures, TorchFunction

    made = TorchFeatures(function, (directions, params))
    return Hamiltonian(*(TorchFunction(made, order) for order in range(3)))


def solution(
    ready: PreparedRun | System | Batch,
    t_span: tuple[float, float],
    save_every: int = 1,
    *,
    method: Any = None,
    step: float | None = None,
    t_eval: Any = None,
) -> Callable[..., Any]:
    """Return a run as a function of PyTorch, of the initial state and parameters of the system.

    Use it to fit parameters or initial states, alone or together with a network, or the network that is the energy.
    ``backward``, ``torch.autograd.grad``, ``torch.func.grad``, ``torch.func.jvp`` and ``torch.func.vmap`` apply to it.

    Parameters
    ----------
    ready : PreparedRun, System or Batch
        The prepared run, with a step, of a scheme with derivatives; or a system or batch, with `step` and `method` as
        in `prepare`.
    t_span, save_every, t_eval
        As in `PreparedRun.run`.
    method, step
        Scheme and step of a system; of a prepared run they are its own.

    Returns
    -------
    callable
        A function ``g(x0, *, attitude0=None, **parameters)`` of tensors of float64 on the processor, or numbers. It
        returns the states, (k, n) for x0 of shape (n,) and (k, members, n) for (members, n); for a run prepared with an
        attitude the pair of states and attitudes. The parameters are those of ``ready.parameters``, in their shapes,
        and default to these values; of `energy`, `features`, `torque` and `double_bracket` they are ``params``, one
        tree for all, without derivatives by those that are not given. A system with other parameters is prepared in
        each call, and the last one is cached; other params need no preparation.

    Raises
    ------
    ImportError
        PyTorch is not installed; the extra is ``coadjoint[torch]``.
    TypeError
        The run has no derivatives; a tensor is not of float64, or on another device; a step or scheme for a prepared
        run, or none for a system; with params: another scheme than `GaussLegendre`, and `Splitting` for `features`,
        batches, inputs, attitudes, or forces with functions of NumPy; or the callable is given parameters by position.
    ValueError
        For unknown names and wrong shapes; an initial state where an energy of `energy` has no derivatives.
    IntegrationError
        As in `integrate`. With params states are NaN in place of an error, with a `LargeStepWarning` outside of
        transformations.

    Notes
    -----
    Runs are those of the compiled loops, with first derivatives; ``vmap`` over initial states makes one ensemble, over
    parameters and derivatives one run follows the other. With params the steps are operations of PyTorch, between half
    flows of forces with the noise of the compiled runs: stages are iterated to rounding, at most 50 times, and
    differentiated as the solution of their equations, to every order. The stages of all steps are stored for reverse
    mode.

    The first run warns of a step that is too large, as `integrate` does. With params this is the first run outside of
    transformations, without noise, at the params of the system, by a compiled run of the first 8 members and 100 steps:
    other params, and flows of `features`, are checked for NaN only.

    See Also
    --------
    coadjoint.PreparedRun.vjp : Gradients without PyTorch.
    coadjoint.jax.solution : Runs as functions of JAX, which compiles them, and long runs.

    Examples
    --------
    ::

        import torch
        import coadjoint as co

        body = co.prepare(co.systems.rigid_body(inertia=(1, 2, 2.5)), co.Splitting(order=4), step=0.05)
        g = co.torch.solution(body, (0, 10), save_every=50)
        inertia = torch.tensor([1.1, 2.0, 2.4], dtype=torch.float64, requires_grad=True)
        g((1.0, 0.2, 0.5), inertia=inertia)[-1, 0].backward()
        inertia.grad
    """
    require_packages("co.torch.solution", "torch")
    from coadjoint.torch.compiled_runs import solve
    from coadjoint.torch.library import LIBRARY, TorchFunction, check_outside_of_derivatives
    from coadjoint.torch.stage_runs import StageRun

    check_outside_of_derivatives()
    ready = prepared_of(ready, method, step, "co.torch.solution")
    learned = type(ready) is PreparedRun and function_with_params(ready.system, TorchFunction, LIBRARY) is not None
    compute: Callable[..., Any]
    if learned:
        compute = StageRun(ready, t_span, save_every, t_eval)
    else:
        compute = partial(solve, ParametrizedRun(ready, t_span, save_every, t_eval, "co.torch.solution"))

    def solution_of(x0: Any, *others: Any, attitude0: Any = None, **parameters: Any) -> Any:
        """Return the states of the run, and the attitudes if it was prepared with one; see `co.torch.solution`."""
        if others:
            known = ready.parameters if ready.inputs is None else ready.inputs.indices
            raise not_by_position("the function of co.torch.solution", others, [NAME] if learned else known)
        if NAME in parameters and not learned:
            raise ValueError(
                f"{ready.system.name} has no params of PyTorch; give co.torch.energy(function, params) as its "
                "Hamiltonian, or co.torch.torque(function, params) as a force"
            )
        return compute(x0, attitude0, parameters)

    return solution_of


def torque(function: Callable[..., Any], params: Any = None) -> Force:
    """Return a torque of parameters, ``x' = N(x, params)``, such as a module, as a force.

    Use it to learn a friction, a drag or a drive beside a known or learned energy, as `coadjoint.jax.torque`. For a law
    without parameters to learn, or with named numbers, use `coadjoint.forces.Torque`, which is compiled; for a
    dissipation that keeps the Casimirs, `double_bracket`.

    Parameters
    ----------
    function : torch.nn.Module or callable
        The contribution to x' of a state, (n,), as the function of `energy`. For bodies, such as
        `coadjoint.systems.body`, it may return the torque in the frame of the body, (3,), or of k bodies, (k, 3).
    params : tree of tensors of float64, optional
        As of `energy`. If the energy or other forces have params too, all of them take the same ones: one tree with
        all parameters of the run, of which each function uses its own.

    Returns
    -------
    Force
        For ``system.with_forces``. Runs by `solution` take and differentiate ``params=``; compiled loops call the
        function in Python, at the given parameters.

    Raises
    ------
    ImportError
        PyTorch is not installed; the extra is ``coadjoint[torch]``.
    TypeError
        As `energy`. On the system: the function fails, or the system has no structure constants.
    ValueError
        On the system: the values have another shape, are random, or have a part without derivative, as by ``detach``;
        or axes, directions or positions would be changed.

    Notes
    -----
    The flow is that of `coadjoint.forces.Torque`: a step of the Runge-Kutta method of order 4, in schemes of higher
    order an extrapolated midpoint rule.

    See Also
    --------
    coadjoint.jax.torque : The same in JAX.
    double_bracket : Dissipation on the orbit.

    Examples
    --------
    ::

        import torch
        import coadjoint as co

        rate = torch.tensor(0.1, dtype=torch.float64, requires_grad=True)
        drag = co.torch.torque(lambda x, rate: -rate * torch.linalg.norm(x) * x, rate)
        body = co.systems.rigid_body((1.0, 2.0, 3.0)).with_forces(drag)
        run = co.torch.solution(body, (0, 10), method=co.GaussLegendre(2), step=0.1)
        run((1.0, 0.2, 0.5), params=rate)[-1, 0].backward()
        rate.grad
    """
    require_packages("co.torch.torque", "torch")
    from coadjoint.torch.library import TorchTorque

    return LearnedTorque(TorchTorque(function, params))


if not TYPE_CHECKING:  # type checkers know the names above and must report any other
    __getattr__, __dir__ = refuse_others("co.torch", __all__)
