"""Keywords and attributes of other libraries, mapped to the names used here for error messages."""

from __future__ import annotations

import functools
import inspect
from abc import ABCMeta
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar, cast

from coadjoint.errors import nearest, unknown_name
from coadjoint.rounding import in_standard_mode
from coadjoint.short_repr import compact, short

Function = TypeVar("Function", bound=Callable[..., Any])
Kind = inspect.Parameter
Value = TypeVar("Value")

STEP = "step=, the size of a step, which is used as given"
ACCURACY = "accuracy=, the required error of the momentum at the end, from which a constant step is chosen"
KEYWORDS: Mapping[str, str] = {
    **dict.fromkeys(("dt", "h", "delta_t", "stepsize", "step_size", "first_step", "dt0"), STEP),
    **dict.fromkeys(("max_step", "min_step", "dtmax", "hmax"), STEP),
    **dict.fromkeys(("tol", "tolerance", "reltol", "abstol", "eps", "epsabs", "epsrel"), ACCURACY),
    **dict.fromkeys(("y0", "u0", "initial", "initial_state", "x_0", "state"), "x0=, the initial momentum"),
    **dict.fromkeys(("tspan", "time_span", "t_range", "interval", "times", "tlist", "t"), "t_span=, start and end"),
    **dict.fromkeys(("t_end", "tmax", "t_final", "T"), "t_span=(start, end)"),
    **dict.fromkeys(("n_steps", "nsteps", "num_steps", "steps"), "step= and t_span=, which set the number of steps"),
    **dict.fromkeys(("saveat", "save_at", "ts"), "t_eval=, the times at which states are saved, or save_every="),
    **dict.fromkeys(("save", "save_freq", "thin", "every", "stride"), "save_every=, the steps between saved states"),
    "dense_output": "it needs none: sol.at(t) has the states at any time",
    **dict.fromkeys(("n_jobs", "num_threads", "nthreads", "n_threads", "cores"), "threads="),
    **dict.fromkeys(("workers", "processes"), "threads=, or processes to co.integrate_ensemble(..., workers=)"),
    **dict.fromkeys(("solver", "scheme", "integrator", "alg", "stepper"), "method=, such as Splitting(order=4)"),
    **dict.fromkeys(("verbose", "disp", "show_progress", "progress_bar"), "progress=True"),
    **dict.fromkeys(("callback", "callbacks", "event"), "events=, or observe= for quantities along the run"),
    **dict.fromkeys(("args", "params", "parameters", "p"), "the parameters to the system, when you make it"),
    **dict.fromkeys(("fun", "f", "rhs", "func", "vector_field"), "system=, such as co.systems.rigid_body()"),
    **dict.fromkeys(("jac", "jacobian"), "it needs none: derivatives belong to the Hamiltonian"),
    **dict.fromkeys(("output", "filename", "file", "path"), "archive=, the folder that the run is written to"),
    **dict.fromkeys(("I", "J", "moments", "inertias", "moments_of_inertia"), "inertia=, the principal moments"),
    "order": "the order through the scheme, such as Splitting(order=4) or GaussLegendre(stages=2), of order 4",
}
"""Keyword of other libraries -> the corresponding argument here."""
ATTRIBUTES: Mapping[str, str] = {
    **dict.fromkeys(("y", "u", "states", "momentum", "z", "X"), "x"),
    **dict.fromkeys(("sol", "interpolate", "dense", "interp"), "at(t), the states at any times"),
    **dict.fromkeys(("ts", "times", "time"), "t"),
    **dict.fromkeys(("ys", "xs"), "x"),
    **dict.fromkeys(("H", "hamiltonian", "energies", "E"), "energy"),
    **dict.fromkeys(("t_events", "y_events", "crossings"), "events"),
    **dict.fromkeys(("success", "status", "message"), "failed, for each member; a single run raises instead"),
    **dict.fromkeys(("nfev", "njev", "nsteps", "statistics"), "stats"),
    **dict.fromkeys(("R", "g", "orientation"), "attitude, in a run with attitude=True"),
    **dict.fromkeys(("invariants",), "energy and casimirs"),
    **dict.fromkeys(
        ("save", "to_netcdf"),
        "to_xarray(), whose result can be written to a file",
    ),
    **dict.fromkeys(("to_csv", "to_dataframe", "to_frame", "dataframe"), "to_pandas(), a table"),
    **dict.fromkeys(("quaternion", "quaternions", "euler_angles"), "rotation, of SciPy, in a run with attitude=True"),
    **dict.fromkeys(("animate", "animation"), "movie(path)"),
    **dict.fromkeys(("error",), "error_estimate, of a run with accuracy="),
}
"""Solution attribute of other libraries -> the corresponding one here."""


PICTURES: Mapping[str, str] = {
    **dict.fromkeys(("energy", "hamiltonian", "h", "casimirs", "casimir", "invariants", "energy drift"), "drift"),
    **dict.fromkeys(("momentum", "momenta", "x", "state", "states", "time series", "trajectory"), "components"),
    **dict.fromkeys(("orbit", "orbits", "sphere", "phase space", "level surface", "surface"), "coadjoint orbit"),
    **dict.fromkeys(("attitude", "rotation", "axis", "top", "orientation"), "body axis"),
    **dict.fromkeys(("path", "position", "positions"), "path in space"),
    **dict.fromkeys(("portrait", "phase", "phase plane"), "phase portrait"),
    **dict.fromkeys(("poincare", "poincare section", "crossings", "events"), "section"),
    **dict.fromkeys(("eigenvalue", "spectrum"), "eigenvalues"),
    **dict.fromkeys(("spectra", "energy spectrum", "enstrophy"), "field spectra"),
    **dict.fromkeys(("observe", "observables"), "observed"),
    **dict.fromkeys(("lattice", "spin", "magnetization"), "spins"),
    **dict.fromkeys(("spacetime", "space time", "wave", "waves", "kymograph"), "space-time"),
    **dict.fromkeys(("stream", "streamfunction", "map"), "vorticity"),
    **dict.fromkeys(("exact", "closed form", "phase error"), "error"),
}
"""Usual name of a picture, in lower case -> the kind of picture here."""
FUNCTIONS: Mapping[str, str] = {
    **dict.fromkeys(("solve", "solve_ivp", "odeint", "run", "simulate", "propagate", "evolve"), "co.integrate"),
    **dict.fromkeys(("diffeqsolve", "ODEProblem", "solve_ode"), "co.integrate"),
    **dict.fromkeys(("movie", "animate", "animation"), "sol.movie, of a solution of co.integrate"),
    **dict.fromkeys(("plot", "figure", "show", "draw"), "sol.plot, of a solution of co.integrate"),
    **dict.fromkeys(("drift", "energy", "casimirs"), "an attribute of a solution of co.integrate, such as sol.drift()"),
    **dict.fromkeys(("RigidBody", "body", "HeavyTop", "top"), "in co.systems, such as co.systems.rigid_body"),
    **dict.fromkeys(("open", "read"), "co.load"),
    **dict.fromkeys(("from_matrices", "from_brackets", "closure"), "a constructor of co.LieAlgebra, of the same name"),
    **dict.fromkeys(("monte_carlo", "metropolis", "sample", "thermalize", "sampler"), "co.thermal_states"),
    **dict.fromkeys(("structure_factor", "dispersion", "intensities"), "co.spectra.structure_factor"),
    **dict.fromkeys(("autocorrelation", "acf", "integrated_time", "correlation_time"), "co.spectra.autocorrelation"),
}
"""Usual name of a function -> where it is here."""


CONSTRUCTORS: Mapping[str, str] = {
    **dict.fromkeys(
        (
            "from_tensor",
            "from_structure_constants",
            "from_constants",
            "from_array",
            "from_coefficients",
            "from_triples",
        ),
        "LieAlgebra(constants), for an array of shape (n, n, n) or a list of (i, j, k, c)",
    ),
    **dict.fromkeys(
        ("from_commutators", "from_commutator_table", "from_table", "from_dict", "from_relations", "from_string"),
        "LieAlgebra.from_brackets",
    ),
    **dict.fromkeys(
        ("from_basis", "from_matrix", "from_generators", "from_representation", "from_matrix_basis", "matrices"),
        "LieAlgebra.from_matrices",
    ),
    **dict.fromkeys(("generated_by", "lie_closure", "span", "generate", "from_span", "complete"), "LieAlgebra.closure"),
    **dict.fromkeys(("from_name", "by_name", "from_type", "cartan_type"), "co.algebras.get(name)"),
}
"""Usual name of a constructor of a Lie algebra -> the one here."""


def unknown_constructor(name: str, known: list[str]) -> AttributeError:
    """Return the AttributeError for an unknown attribute of the class of Lie algebras.

    >>> print(unknown_constructor("from_commutators", []))
    LieAlgebra has no attribute 'from_commutators'; here it is LieAlgebra.from_brackets
    """
    text = f"LieAlgebra has no attribute {name!r}"
    if name in CONSTRUCTORS:
        return AttributeError(f"{text}; here it is {CONSTRUCTORS[name]}")
    near = None if name.startswith("_") else nearest(name, known)
    return AttributeError(f"{text}; did you mean {near!r}?" if near else text)


def suggest_keywords(function: Function) -> Function:
    """Decorate a public function, method or class: it computes in the standard floating-point mode, and calls with
    wrong arguments raise a TypeError that says what to give.

    Unknown keywords are answered with the corresponding or nearest known one. A class is decorated in its constructor
    and in its class methods; a class method below ``@classmethod``.

    >>> @suggest_keywords
    ... def run(x0, step=None): ...
    >>> run((1, 2), dt=0.1)
    Traceback (most recent call last):
    TypeError: run has no dt; give step=, the size of a step, which is used as given
    >>> run((1, 2), stepp=0.1)
    Traceback (most recent call last):
    TypeError: run has no stepp; did you mean step=?
    >>> run((1, 2), x0=(1, 2))
    Traceback (most recent call last):
    TypeError: run was given x0 twice, by position and by name; its arguments are x0, step
    """
    if isinstance(function, type):
        _decorate_class(function)
        return cast(Function, function)
    signature, compute = inspect.signature(function), in_standard_mode(function)
    is_method = next(iter(signature.parameters), "") in ("self", "cls")

    @functools.wraps(function)
    def wrapped_function(*args: Any, **keywords: Any) -> Any:
        try:
            return compute(*args, **keywords)
        except TypeError:
            name = _called_name(function.__name__, args[0]) if is_method and args else function.__name__
            if (error := wrong_arguments(name, signature, args, keywords)) is not None:
                raise error from None
            raise

    return cast(Function, wrapped_function)


def _called_name(function: str, owner: Any) -> str:
    """Return the name of a method with that of its class, and of a constructor the class."""
    kind = owner.__name__ if isinstance(owner, type) else type(owner).__name__
    return kind if function == "__init__" else f"{kind}.{function}"


def _decorate_class(kind: type, constructor: bool = True) -> None:
    """Decorate the constructor and the public class methods that a class defines."""
    for name, value in list(vars(kind).items()):
        if name == "__init__" and constructor:
            kind.__init__ = suggest_keywords(value)  # type: ignore[misc]
        elif isinstance(value, classmethod) and not name.startswith("_"):
            setattr(kind, name, classmethod(suggest_keywords(value.__func__)))


class ExplainedCalls(ABCMeta):
    """Metaclass of schemes and forces, those of users too: wrong arguments of their constructors are explained, which
    compute in the standard floating-point mode.
    """

    if not TYPE_CHECKING:

        def __init__(cls, *args, **keywords):
            super().__init__(*args, **keywords)
            _decorate_class(cls, constructor=False)

        @in_standard_mode
        def __call__(cls, *args, **keywords):
            """Construct an instance."""
            try:
                return super().__call__(*args, **keywords)
            except TypeError as error:
                # Errors of deeper frames are those of the class itself.
                explained = error.__traceback__.tb_next is None and wrong_arguments(
                    cls.__name__, inspect.signature(cls.__init__), (cls, *args), keywords
                )
                if explained:
                    raise explained from None
                raise

        @property
        def __signature__(cls):
            """The signature of the constructor, which is not that of `__call__`."""
            own = next((f for f in (cls.__init__, cls.__new__) if inspect.isfunction(f)), None)
            parameters = () if own is None else list(inspect.signature(own).parameters.values())[1:]
            return inspect.Signature(parameters)


def wrong_arguments(
    function: str, signature: inspect.Signature, arguments: Sequence[Any], keywords: Mapping[str, Any]
) -> TypeError | None:
    """Return the TypeError for arguments that a function does not take, or None if it takes them.

    >>> print(wrong_arguments("fit", inspect.signature(lambda ready, x0, *, sigma: None), [1, 2], {}))
    fit needs sigma; its arguments are ready, x0, sigma
    """
    try:
        signature.bind(*arguments, **keywords)
    except TypeError:
        pass
    else:
        return None
    kinds = {name: parameter.kind for name, parameter in signature.parameters.items()}
    given = list(arguments)
    if next(iter(kinds), "") in ("self", "cls") and given:
        kinds.pop(next(iter(kinds)))
        given.pop(0)
    many = [name for name, kind in kinds.items() if kind in (Kind.VAR_POSITIONAL, Kind.VAR_KEYWORD)]
    known = [name for name in kinds if name not in many]
    positional = [name for name in known if kinds[name] is not Kind.KEYWORD_ONLY]
    for name in keywords:
        if name not in known and Kind.VAR_KEYWORD not in kinds.values():
            return unknown_keyword(function, name, known)
    listing = f"its arguments are {', '.join(known)}"
    twice = [name for name in positional[: len(given)] if name in keywords]
    if twice:
        return TypeError(f"{function} was given {twice[0]} twice, by position and by name; {listing}")
    if len(given) > len(positional) and Kind.VAR_POSITIONAL not in kinds.values():
        return too_many_arguments(function, given, positional, known)
    required = [name for name in known if signature.parameters[name].default is inspect.Parameter.empty]
    missing = [name for name in required if name not in keywords and name not in positional[: len(given)]]
    return TypeError(f"{function} needs {', '.join(missing)}; {listing}")


def unknown_keyword(function: str, name: str, known: Sequence[str]) -> TypeError:
    """Return the TypeError for an unknown keyword of a function.

    >>> print(unknown_keyword("GaussLegendre", "stage", ["stages"]))
    GaussLegendre has no stage; did you mean stages=?
    """
    meant = KEYWORDS.get(name)
    # Suggest the corresponding argument only if this function has it.
    if meant is not None and ("=" not in meant or meant.partition("=")[0] in known):
        return TypeError(f"{function} has no {name}; {'' if meant.startswith('it ') else 'give '}{meant}")
    near = nearest(name, known)
    return TypeError(
        f"{function} has no {name}; " + (f"did you mean {near}=?" if near else f"it takes {', '.join(known)}")
    )


def too_many_arguments(
    function: str, arguments: Sequence[Any], positional: Sequence[str], known: Sequence[str]
) -> TypeError:
    """Return the TypeError for too many positional arguments; `positional` and `known` are positional and all names.

    >>> print(too_many_arguments("rigid_body", (1, 2, 3), ["inertia"], ["inertia"]))
    rigid_body was given 3 arguments, and takes inertia; give several values as one, inertia=(1, 2, 3)
    """
    problem = f"{function} was given {len(arguments)} arguments, and takes {', '.join(known) or 'none'}"
    if len(positional) == 1 == len(known):
        return TypeError(f"{problem}; give several values as one, {known[0]}={short(tuple(arguments))}")
    return TypeError(problem + (f", those after {positional[-1]} by name" if 0 < len(positional) < len(known) else ""))


def unknown_solution_attribute(name: str, known: list[str]) -> AttributeError:
    """Return the AttributeError for an unknown attribute of a solution.

    >>> print(unknown_solution_attribute("y", ["x", "t"]), unknown_solution_attribute("enregy", ["energy"]), sep="; ")
    a Solution has no attribute 'y'; here it is x; a Solution has no attribute 'enregy'; did you mean 'energy'?
    """
    text = f"a Solution has no attribute {name!r}"
    if name in ATTRIBUTES:
        return AttributeError(f"{text}; here it is {ATTRIBUTES[name]}")
    near = None if name.startswith("_") else nearest(name, known)
    return AttributeError(f"{text}; did you mean {near!r}?" if near else text)


def unknown_picture(name: str, known: Iterable[str]) -> ValueError:
    """Return the ValueError for an unknown kind of picture, with the kind that is meant or the nearest one.

    >>> print(unknown_picture("energy", ["drift", "energy by scale"]))
    unknown kind of picture 'energy'; here it is 'drift'
    """
    names = list(known)
    meant = PICTURES.get(name.strip().casefold().replace("_", " ").replace("-", " "))
    if meant in names:
        return ValueError(f"unknown kind of picture {short(name)}; here it is {meant!r}")
    return unknown_name("kind of picture", name, names)


def unknown_function(name: str) -> AttributeError | None:
    """Return the AttributeError for a usual name of a function that has another one here, or None.

    >>> print(unknown_function("solve"))
    coadjoint has no attribute 'solve'; here it is co.integrate
    """
    meant = FUNCTIONS.get(name)
    if meant is None and name in CONSTRUCTORS and name.startswith(("from_", "lie_")):
        meant = f"co.{CONSTRUCTORS[name].removeprefix('co.')}"
    return None if meant is None else AttributeError(f"coadjoint has no attribute {name!r}; here it is {meant}")


class NamedValues(dict[str, Value]):
    """Dictionary of quantities of a run, whose KeyError has the name that is meant, or the nearest one.

    >>> NamedValues({"energy": 0.0, "|x|^2": 1.0})["Energy"]
    Traceback (most recent call last):
    KeyError: "there is no 'Energy'; did you mean 'energy'?"
    """

    def __repr__(self) -> str:
        return f"{{{', '.join(f'{name!r}: {compact(value)}' for name, value in self.items())}}}"

    def __missing__(self, name: Any) -> Value:
        """Raise the KeyError."""
        text = f"there is no {short(name)}"
        if not isinstance(name, str):
            raise KeyError(f"{text}; give a name: {', '.join(self)}")
        near = "energy" if ATTRIBUTES.get(name) == "energy" and "energy" in self else nearest(name, self)
        raise KeyError(f"{text}; did you mean {near!r}?" if near else f"{text}; there are: {', '.join(self)}")
